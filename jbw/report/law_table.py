"""The table that compares laws of the joint, one row per law."""

from collections.abc import Mapping
from typing import Any

from jbw.report.messages import free_law as messages
from jbw.report.messages import tables as notes
from jbw.report.table import Column, Table, table, words
from jbw.report.text import NOTHING


def law_order(record: Mapping[str, Any]) -> list[str]:
    """Return the names of compared laws: the preferred law first, then the others by score."""
    worst = -float("inf")

    def rank(name: str) -> tuple[bool, float]:
        row = record["laws"][name]
        keys = ("elpd", "log_evidence")
        score = next((row[key] for key in keys if row[key] is not None), worst)
        # With few runs the evidence decides, whatever the scores are.
        return row.get("answer") == "best", score

    return sorted(record["laws"], key=rank, reverse=True)


def laws_table(record: Mapping[str, Any]) -> Table:
    """Return the table of a comparison of laws, the best law first."""
    laws = record["laws"]
    rows = [{"law": name, "floor": record["line"], **laws[name]} for name in law_order(record)]
    return table(
        notes.laws(record["campaign"]),
        rows,
        words("law", "law"),
        words("parameters", "num_parameters", "right"),
        _percent("fit [%]", "error"),
        _percent("left out [%]", "error_left_out"),
        _percent("highest [%]", "error_highest"),
        Column("other kinds [%]", _across_kinds),
        _percent("held out [%]", "error_held_out"),
        _percent("beyond [%]", "error_beyond"),
        _percent("linear by run [%]", "floor"),
        Column("log score", _difference("elpd_difference", "elpd_difference_se")),
        _number("weight", "weight", ".2f"),
        Column("log evidence", _difference("log_evidence_difference", "log_evidence_error")),
        Column("answer", lambda row: row["answer"], align="left"),
    )


def free_law_table(record: Mapping[str, Any]) -> Table | None:
    """Return a table of laws by evidence of the readings alone, best first; None if not read."""
    free = record.get("free_law")
    if free is None:
        return None
    differences = free["log_evidence_difference"]
    rows = [
        {"law": name, "difference": differences[name]}
        for name in sorted(differences, key=differences.__getitem__, reverse=True)
    ]
    return table(
        messages.TABLE,
        rows,
        words("law", "law"),
        _number("log evidence", "difference", "+.1f"),
    )


def _across_kinds(row: Mapping[str, Any]) -> str:
    """Return the largest error [%] of a kind of test that is predicted from the other kinds."""
    errors = row.get("error_across")
    return f"{100 * max(errors.values()):.3g}" if errors else NOTHING


def _number(heading: str, key: str, form: str, scale: float = 1.0) -> Column:
    def shown(row: Mapping[str, Any]) -> str:
        return NOTHING if row[key] is None else format(scale * row[key], form)

    return Column(heading, shown)


def _percent(heading: str, key: str) -> Column:
    return _number(heading, key, ".3g", 100.0)


def _difference(key: str, error: str) -> Any:
    def shown(row: Mapping[str, Any]) -> str:
        if row[key] is None:
            return NOTHING
        difference = f"{row[key]:+.1f}" if row[key] else "0"
        return difference if row[error] is None else f"{difference} +- {row[error]:.2g}"

    return shown
