"""Verdicts in print: a badge for the status, and the findings behind it."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from jbw.report.text import NOTHING, number
from jbw.report.words import in_symbols

STATUS_WORDS = {
    "ok": "The main posterior can be used.",
    "not assessed": "Some checks could not be made: hold the main posterior as provisional.",
    "failed": "The main posterior must not be used as it is.",
}
KINDS = {"ok": "good", "failed": "bad"}


class Badge(NamedTuple):
    """A status as a word and a kind: good, doubt or bad."""

    word: str
    kind: str


def badge(verdict: Any) -> Badge:
    """Return the badge of a verdict, a status or nothing."""
    word = str(verdict.get("status", "") if isinstance(verdict, Mapping) else verdict or "")
    return Badge(word or "not judged", KINDS.get(word, "doubt"))


def findings(verdict: Any) -> list[dict[str, Any]]:
    """Return a verdict's findings, the bad ones first; those that ask for the same together."""
    found = verdict.get("findings", []) if isinstance(verdict, Mapping) else []
    groups: dict[tuple[str, ...], dict[str, Any]] = {}
    for each in found:
        status, action = (str(each.get(name) or "") for name in ("status", "action"))
        # Without an action there is nothing to say once for all of them.
        key = (status, action) if action else (str(len(groups)),)
        group = groups.setdefault(
            key, {"badge": badge(status), "reasons": [], "action": in_symbols(action)}
        )
        group["reasons"].append(_reason(each))
    return sorted(
        groups.values(), key=lambda each: ("bad", "doubt", "good").index(each["badge"].kind)
    )


def _reason(finding: Mapping[str, Any]) -> str:
    """Return the reason of a finding, with its number where the sentence has none."""
    reason = str(finding.get("reason") or finding.get("code") or "")
    value = number(finding.get("number"))
    told = value == NOTHING or any(letter.isdigit() for letter in reason)
    return in_symbols(reason if told else f"{reason} ({value})")
