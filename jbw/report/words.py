"""The sentences that a person reads first: verdicts, findings and known parameters."""

import re
import unicodedata
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from jbw.inference.thresholds import KNOWN, LEARNT, ROUGHLY
from jbw.quantities import RESIDUAL_TERMS, STUCK, split
from jbw.report.messages import opening
from jbw.report.text import NOTHING, Names, number, percent, quantity, raised, symbol

KINDS = {"ok": "good", "failed": "bad"}
# Names in sentences that are no parameter's.
SPELLED = {
    **{f"lambda_{n}": f"λ{digit}" for n, digit in enumerate("₀₁₂₃")},
    **{"ess_bulk": "bulk ESS", "ess_tail": "tail ESS", "r_hat": "R-hat"},
}
UNCOUNTED = "noise_std"
TRUNCATED = "at_bound"  # finding of a parameter whose interval ends at a bound
LINEAR_NAMES = frozenset(quantity.name for quantity in (*STUCK, *RESIDUAL_TERMS))
# Laws that are called by people's names or by more than their own.
LAWS = {"bouc_wen": "Bouc-Wen oscillator", "cubic": "cubic spring", "jenkins": "Jenkins array"}


class Badge(NamedTuple):
    """A status as a word and a kind: good, doubt or bad."""

    word: str
    kind: str


def badge(verdict: Any) -> Badge:
    """Return the badge of a verdict, a status or nothing."""
    word = str(verdict.get("status", "") if isinstance(verdict, Mapping) else verdict or "")
    return Badge(word or "not judged", KINDS.get(word, "doubt"))


def findings(verdict: Any, quantities: Names) -> list[dict[str, Any]]:
    """Return a verdict's findings, the bad ones first; those that ask for the same together."""
    groups: dict[tuple[str, ...], dict[str, Any]] = {}
    for finding in verdict.get("findings", []) if isinstance(verdict, Mapping) else []:
        status, action = (str(finding.get(name) or "") for name in ("status", "action"))
        reason = str(finding.get("reason") or finding.get("code") or "")
        value = number(finding.get("number"))
        # The reason gets its number where the sentence has none.
        if value != NOTHING and not any(letter.isdigit() for letter in reason):
            reason = f"{reason} ({value})"
        # Without an action there is nothing to say once for all of them.
        key = (status, action) if action else (str(len(groups)),)
        group = groups.setdefault(
            key, {"badge": badge(status), "reasons": [], "action": in_symbols(action, quantities)}
        )
        group["reasons"].append(in_symbols(reason, quantities))
    return sorted(
        groups.values(), key=lambda finding: ("bad", "doubt", "good").index(finding["badge"].kind)
    )


def in_symbols(text: str, quantities: Names) -> str:
    """Return a sentence with parameters as symbols, products as dots and exponents raised.

    What stands in backticks is to be typed, and stays as it is.
    """
    if "`" in text:
        parts = text.split("`")
        shown = [part if i % 2 else in_symbols(part, quantities) for i, part in enumerate(parts)]
        return "`".join(shown)
    # A name means the quantity alone, as alpha does, or is a word too, as `share` and `cubic`.
    spelled = {
        name: quantity.symbol
        for name, quantity in quantities.items()
        if "_" in quantity.name
        or unicodedata.name(quantity.symbol[0], "").endswith(f" {quantity.name.upper()}")
    }
    spelled |= {name.capitalize(): letter for name, letter in spelled.items()} | SPELLED
    names = "|".join(map(re.escape, sorted(spelled, key=len, reverse=True)))
    letters = "".join({letter[-1] for letter in spelled.values() if not letter.isascii()})
    firsts = "".join({letter[0] for letter in spelled.values() if not letter[0].isascii()})
    # Not within a path or a name in backticks; after a stroke only where a symbol stands before it.
    replaced = re.sub(rf"(?<![\w./`])({names})(?![\w`])", lambda match: spelled[match[1]], text)
    if letters:
        replaced = re.sub(
            rf"(?<=[{letters}])/({names})(?![\w`])", lambda match: f"/{spelled[match[1]]}", replaced
        )
        replaced = re.sub(rf"(?<=[{letters}])\*(?=[{firsts}])", "·", replaced)
    replaced = re.sub(r"(?<=\d)e([+-]\d\d)\b", lambda m: f"×10^{int(m[1])}", replaced)
    return raised(replaced)


def combination(text: str, quantities: Names) -> str:
    """Return a combination of parameters in symbols: alpha*delta^-1 as α·δ^−1."""
    names = "".join(
        rf"{re.escape(name)}(?!\w)|" for name in sorted(quantities, key=len, reverse=True)
    )
    signs = {"*": "·", "-": "−"}
    return re.sub(
        rf"(?<!\w)(?:{names}[A-Za-z]\w*)|[*-]",
        lambda match: signs.get(match[0]) or symbol(match[0], quantities),
        text,
    )


def unseen_hysteresis(summary: Mapping[str, Any]) -> str | None:
    """Return why a run shows no hysteresis; None where it does, or was not asked to."""
    against = (summary.get("verdict") or {}).get("findings") or ()
    reasons = (row["reason"] for row in against
               if row["code"] == "no_hysteresis" and row["status"] != "ok")  # fmt: skip
    return next(reasons, None)


def grades(summary: Mapping[str, Any]) -> dict[str, int]:
    """Return the grade of each parameter of the main posterior, as index of `opening.GRADES`.

    Where no hysteresis is seen, its parameters are poorly known at best, whatever their intervals,
    and so is a parameter whose interval ends at a bound, with what only its products tell.
    """
    main = (summary.get("steps") or {}).get(summary.get("main")) or {}
    is_empty = unseen_hysteresis(summary) is not None
    findings = (summary.get("verdict") or {}).get("findings") or ()
    ended = {f.get("of") for f in findings if f["code"] == TRUNCATED and f["status"] != "ok"}
    rows = main.get("parameters") or {}
    ended |= {name for name in rows if any(f"{other}_{name}" in rows for other in ended)}
    graded = {}
    for name, facts in rows.items():
        cv, kl = facts.get("cv"), facts.get("kl")
        if name.startswith(UNCOUNTED) or cv is None:
            continue
        size = abs(cv)
        grade = 0 if size <= KNOWN else 1 if size <= ROUGHLY else 2
        if name in ended or (is_empty and name not in LINEAR_NAMES):
            grade = 2
        graded[name] = 3 if kl is not None and kl < LEARNT else grade
    return graded


def identified_words(summary: Mapping[str, Any], quantities: Names) -> list[str]:
    """Return sentences on parameters by grade: known (5 %), roughly (30 %), or prior only."""
    groups: dict[int, list[str]] = {}
    for name, grade in grades(summary).items():
        size = abs(summary["steps"][summary["main"]]["parameters"][name]["cv"])
        meaning = quantity(name, quantities).meaning.partition(",")[
            0
        ]  # of a product without formula
        share = percent(size, digits=2).replace(" ", "\N{NO-BREAK SPACE}")
        facts_text = ", ".join(filter(None, (share, meaning)))
        groups.setdefault(grade, []).append(f"{symbol(name, quantities)} ({facts_text})")
    return [f"{opening.GRADES[grade]}: {'; '.join(groups[grade])}." for grade in sorted(groups)]


def _law_words(law: str) -> str:
    """Return the name of one law, a family without its number, with its joints."""
    plain, joints = split(law)
    called = LAWS.get(plain) or LAWS.get(plain.rstrip("0123456789_")) or plain.replace("_", " ")
    return f"{called} at {', '.join(joints)}" if joints else called


def law_words(laws: Sequence[str]) -> str:
    """Return the combined name of a joint's laws; a structure without any is linear."""
    called = [_law_words(law) for law in laws]
    return " and ".join(called) or "a linear structure"
