"""Rows of the report's tables on identifiability, from the summary."""

from collections.abc import Mapping
from typing import Any

from jbw.report.identifiability import spelled
from jbw.report.text import NOTHING, number, percent, symbol


def spectrum_rows(summary: Mapping[str, Any]) -> list[dict[str, str]]:
    """Return the information spectrum, a row a direction, the strongest first."""
    return [
        {
            "combination": spelled(str(row.get("combination") or "")),
            "information": number(row.get("information")),
            "ratio": number(row.get("ratio"), digits=2),
        }
        for row in _found(summary).get("spectrum") or []
    ]


def quantity_rows(summary: Mapping[str, Any]) -> list[dict[str, str]]:
    """Return what is known of every parameter and combination, before and after sampling."""
    found = _found(summary)
    rows = {**(found.get("parameters") or {}), **(found.get("combinations") or {})}
    contraction, shifts = found.get("contraction") or {}, found.get("box_sensitivity") or {}
    profiles = found.get("profiles") or {}
    return [
        {
            "symbol": symbol(name),
            "relative": percent(row.get("relative"), digits=2),
            "ratio": number(row.get("ratio"), digits=2),
            "contraction": percent(contraction.get(name)),
            "shift": _shift(shifts.get(name)),
            "profile": _profile(profiles.get(name)),
        }
        for name, row in rows.items()
    ]


def waterfall_words(summary: Mapping[str, Any]) -> str:
    """Return the costs from all starts of the fit as a sentence; nothing for one start."""
    costs = (_found(summary).get("waterfall") or {}).get("costs") or []
    if len(costs) < 2:
        return ""
    listed = ", ".join("none" if cost is None else number(cost, digits=4) for cost in costs)
    return f"Costs from the starts of the fit, lowest first: {listed}."


def _found(summary: Mapping[str, Any]) -> Mapping[str, Any]:
    return summary.get("identifiability") or {}


def _shift(row: Mapping[str, Any] | None) -> str:
    """Return how far a mean follows the box, and which bound moves it."""
    if row is None or not row.get("box"):
        return NOTHING
    size = "∞" if row.get("shift") is None else number(row["shift"], 0.1)
    return f"{size} by {symbol(row['box'])} {row['end']}"


def _profile(row: Mapping[str, Any] | None) -> str:
    """Return the interval of a profile; an open side has no number."""
    if row is None:
        return NOTHING
    low, high = row["interval"]
    width = (high - low) / 5
    ends = zip(row["interval"], row["open"], strict=True)
    return " to ".join("open" if is_open else number(end, width) for end, is_open in ends)
