"""What a person reads first: which parameters are known, in sentences with symbols."""

# Greek letters and the true minus sign are meant.
# ruff: noqa: RUF001

import re
from collections.abc import Mapping
from typing import Any

from jbw.report.text import SYMBOLS, percent, symbol, unit_text

MEANINGS = {
    "omega_n": "the natural frequency of the stuck joint",
    "zeta": "viscous damping",
    "alpha": "the stiffness that slip takes away",
    "delta": "how soon it softens",
    "gamma": "how far the loop opens",
    "gain": "force per unit mass and unit of input",
    "cubic": "a cubic spring beside the joint",
}
SPELLED = {
    **{name: SYMBOLS[name] for name in ("omega_n", "zeta", "alpha", "delta", "gamma")},
    **{name: SYMBOLS[name] for name in ("alpha_delta", "alpha_gamma")},
    **{f"lambda_{n}": f"λ{digit}" for n, digit in enumerate("₀₁₂₃")},
    **{"ess_bulk": "bulk ESS", "ess_tail": "tail ESS", "r_hat": "R-hat", "Gamma": "γ"},
}
_NAMES = "|".join(sorted(SPELLED, key=len, reverse=True))
# Not within a path or a name in backticks; after a stroke only where a symbol stands before it.
_NAME = re.compile(rf"(?<![\w./`])({_NAMES})(?![\w`])")
_DIVISOR = re.compile(rf"(?<=[αδγζₙ])/({_NAMES})(?![\w`])")

KNOWN, ROUGHLY = 0.05, 0.3  # standard deviation over mean: up to where a parameter is known
LEARNT = 0.5  # nats over the prior: from where on the data have said something
UNCOUNTED = "noise_std"


def in_symbols(text: str) -> str:
    """Return a sentence with parameters as symbols, products as dots and exponents raised."""
    found = _NAME.sub(lambda match: SPELLED[match[1]], text)
    found = _DIVISOR.sub(lambda match: f"/{SPELLED[match[1]]}", found)
    found = re.sub(r"(?<=[αδγζₙ])\*(?=[αδγζω])", "·", found)
    found = re.sub(r"(?<=\d)e([+-]\d\d)\b", lambda m: f"×10^{int(m[1])}", found)
    return re.sub(r"\^-?\d+(?![\d.])", lambda match: unit_text(match[0]), found)


def identified_words(summary: Mapping[str, Any]) -> list[str]:
    """Return which parameters the main posterior knows, roughly knows and does not know.

    A parameter counts as known up to a standard deviation of 5 % of its mean, roughly up to 30 %;
    one whose draws say less than half a nat more than its prior is the prior's.

    Args:
        summary: The run's summary.json.
    """
    main = (summary.get("steps") or {}).get(summary.get("main")) or {}
    groups: dict[str, list[str]] = {"known": [], "roughly": [], "not": [], "prior": []}
    for name, facts in (main.get("parameters") or {}).items():
        cv, kl = facts.get("cv"), facts.get("kl")
        if name.startswith(UNCOUNTED) or cv is None:
            continue
        meaning = f", {MEANINGS[name]}" if name in MEANINGS else ""
        size = _together(percent(abs(cv), digits=2))
        groups[_grade(cv, kl)].append(f"{symbol(name)} ({size}{meaning})")
    heads = {
        "known": "Known, with its standard deviation",
        "roughly": "Known roughly",
        "not": "Hardly known",
        "prior": "Not known, its prior all but unchanged",
    }
    return [f"{heads[grade]}: {'; '.join(found)}." for grade, found in groups.items() if found]


def _together(text: str) -> str:
    """Return a number and its unit with a space that does not break."""
    return text.replace(" ", "\N{NO-BREAK SPACE}")


def _grade(cv: float, kl: float | None) -> str:
    """Return how well a parameter is known."""
    if kl is not None and kl < LEARNT:
        return "prior"
    size = abs(cv)
    return "known" if size <= KNOWN else "roughly" if size <= ROUGHLY else "not"
