"""The table that compares laws of the joint, one row per law."""

from operator import itemgetter
from typing import TYPE_CHECKING

from jbw.report.messages import free_law as messages
from jbw.report.messages import tables as notes
from jbw.report.table import Column, Table, table, words
from jbw.report.text import NOTHING

if TYPE_CHECKING:
    from jbw.results.laws import StoredLaws  # loads pydantic


def law_order(record: "StoredLaws") -> list[str]:
    """Return the names of compared laws: the preferred law first, then the others by score."""
    worst = -float("inf")

    def rank(name: str) -> tuple[bool, float]:
        row = record.laws[name]
        scores = (score for score in (row.elpd, row.log_evidence) if score is not None)
        # With few sessions the evidence decides, whatever the scores of predictions are.
        return row.answer == "best", next(scores, worst)

    return sorted(record.laws, key=rank, reverse=True)


def laws_table(record: "StoredLaws") -> Table:
    """Return the table of a comparison of laws, the best law first."""
    return table(
        notes.laws(record.campaign),
        [record.laws[name] for name in law_order(record)],
        words("law", "name"),
        words("parameters", "num_parameters", "right"),
        _percent("fit [%]", "error"),
        _percent("left out [%]", "error_left_out"),
        _percent("highest [%]", "error_highest"),
        _percent("other kinds [%]", "error_of_worst_kind"),
        _percent("held out [%]", "error_held_out"),
        _percent("beyond [%]", "error_beyond"),
        Column("linear by run [%]", lambda _: _percents(record.line)),
        Column("log score", lambda row: _difference(row.elpd_difference, row.elpd_difference_se)),
        Column("weight", lambda row: NOTHING if row.weight is None else f"{row.weight:.2f}"),
        Column(
            "log evidence",
            lambda row: _difference(row.log_evidence_difference, row.log_evidence_error),
        ),
        words("answer", "answer"),
    )


def free_law_table(record: "StoredLaws") -> Table | None:
    """Return a table of laws fitted to frequency and damping only, best first; None if missing."""
    if record.free_law is None:
        return None
    differences = record.free_law.log_evidence_difference
    return table(
        messages.TABLE,
        sorted(differences.items(), key=itemgetter(1), reverse=True),
        Column("law", itemgetter(0), align="left"),
        Column("log evidence", lambda row: f"{row[1]:+.1f}"),
    )


def _percent(heading: str, key: str) -> Column:
    return Column(heading, lambda row: _percents(getattr(row, key)))


def _percents(ratio: float | None) -> str:
    return NOTHING if ratio is None else f"{100 * ratio:.3g}"


def _difference(difference: float | None, error: float | None) -> str:
    if difference is None:
        return NOTHING
    text = f"{difference:+.1f}" if difference else "0"
    return text if error is None else f"{text} +- {error:.2g}"
