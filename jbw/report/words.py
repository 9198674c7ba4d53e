"""The sentences that a user reads first: verdicts, findings and determined parameters."""

import re
import unicodedata
from collections.abc import Sequence
from typing import Any, NamedTuple

from jbw.inference.thresholds import KNOWN, LEARNT, ROUGHLY
from jbw.quantities import RESIDUAL_TERMS, STUCK, split
from jbw.report.messages import opening
from jbw.report.text import NOTHING, Names, number, percent, quantity, raised, symbol
from jbw.results.run import RunSummary, StoredParameter, StoredVerdict

KINDS = {"ok": "good", "failed": "bad"}
# spelling of those names in sentences that are not names of parameters
SPELLED = {
    **{f"lambda_{n}": f"λ{digit}" for n, digit in enumerate("₀₁₂₃")},
    **{"ess_bulk": "bulk ESS", "ess_tail": "tail ESS", "r_hat": "R-hat"},
}
UNCOUNTED = "noise_std"
TRUNCATED = "at_bound"  # finding on a parameter whose interval ends at a prior bound
LINEAR_NAMES = frozenset(quantity.name for quantity in (*STUCK, *RESIDUAL_TERMS))
# laws whose displayed name differs from their own name
LAWS = {"bouc_wen": "Bouc-Wen oscillator", "cubic": "cubic spring", "jenkins": "Jenkins array"}


class Badge(NamedTuple):
    """A status as a word and a kind: good, doubt or bad."""

    word: str
    kind: str


def badge(status: str) -> Badge:
    """Return the badge of a status; an empty status means that nothing was judged."""
    return Badge(status or "not judged", KINDS.get(status, "doubt"))


def findings(verdict: StoredVerdict, quantities: Names) -> list[dict[str, Any]]:
    """Return the texts of a verdict's findings, worst first, grouped by equal remedies."""
    groups: dict[tuple[str, ...], dict[str, Any]] = {}
    for finding in verdict.findings:
        status, action = finding.status, finding.action
        reason = finding.reason or finding.code
        value = number(finding.number)
        # The number of a finding is added to a reason that contains no number.
        if value != NOTHING and not any(letter.isdigit() for letter in reason):
            reason = f"{reason} ({value})"
        # Findings without a remedy are not grouped.
        key = (status, action) if action else (str(len(groups)),)
        group = groups.setdefault(
            key, {"badge": badge(status), "reasons": [], "action": in_symbols(action, quantities)}
        )
        group["reasons"].append(in_symbols(reason, quantities))
    return sorted(
        groups.values(), key=lambda finding: ("bad", "doubt", "good").index(finding["badge"].kind)
    )


def in_symbols(text: str, quantities: Names) -> str:
    """Return a sentence with symbols of parameters, dots for products, and superscript exponents.

    Text in backticks is meant to be typed and stays unchanged.
    """
    if "`" in text:
        parts = text.split("`")
        shown = [part if i % 2 else in_symbols(part, quantities) for i, part in enumerate(parts)]
        return "`".join(shown)
    # Some names always mean the quantity, such as alpha; others, such as `share` and `cubic`, are
    # also words.
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
    # Exclude paths and names in backticks. Replace a name after a slash only if a symbol precedes
    # the slash.
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


def unseen_hysteresis(verdict: StoredVerdict) -> str | None:
    """Return the reason why a run does not show hysteresis, or None if it does."""
    reasons = (finding.reason for finding in verdict.against if finding.code == "no_hysteresis")
    return next(reasons, None)


def grades(summary: RunSummary) -> dict[str, int]:
    """Return the grade of each parameter of the main posterior, as index of `opening.GRADES`.

    If no hysteresis is seen, its parameters have at best the grade "poorly", whatever their
    intervals are. So does a parameter whose interval ends at a bound, and one determined only by a
    product with it.
    """
    is_empty = unseen_hysteresis(summary.verdict) is not None
    ended = {finding.of for finding in summary.verdict.against if finding.code == TRUNCATED}
    rows = summary.parameters
    ended |= {name for name in rows if any(f"{other}_{name}" in rows for other in ended)}
    graded = {}
    for name, row in rows.items():
        if name.startswith(UNCOUNTED) or row.cv is None:
            continue
        grade = 0 if row.variation <= KNOWN else 1 if row.variation <= ROUGHLY else 2
        if name in ended or (is_empty and name not in LINEAR_NAMES):
            grade = 2
        graded[name] = 3 if is_of_prior(row) else grade
    return graded


def is_of_prior(row: StoredParameter) -> bool:
    """Return whether only the prior determines a parameter: the data add almost nothing."""
    return row.kl is not None and row.kl < LEARNT


def identified_words(summary: RunSummary, quantities: Names) -> list[str]:
    """Return sentences on parameters by grade: known (5 %), roughly (30 %), only by the prior."""
    groups: dict[int, list[str]] = {}
    for name, grade in grades(summary).items():
        size = summary.parameters[name].variation
        meaning = quantity(name, quantities).meaning.partition(",")[
            0
        ]  # The meaning of a product is shown without its formula.
        share = percent(size, digits=2).replace(" ", "\N{NO-BREAK SPACE}")
        facts_text = ", ".join(filter(None, (share, meaning)))
        groups.setdefault(grade, []).append(f"{symbol(name, quantities)} ({facts_text})")
    return [f"{opening.GRADES[grade]}: {'; '.join(groups[grade])}." for grade in sorted(groups)]


def _law_words(law: str) -> str:
    """Return the displayed name of one law with its joints; omit the number of a family."""
    plain, joints = split(law)
    called = LAWS.get(plain) or LAWS.get(plain.rstrip("0123456789_")) or plain.replace("_", " ")
    return f"{called} at {', '.join(joints)}" if joints else called


def law_words(laws: Sequence[str]) -> str:
    """Return the displayed name of all laws of a joint; without laws it is linear."""
    called = [_law_words(law) for law in laws]
    return " and ".join(called) or "a linear structure"
