"""A verdict in a few lines, for a notebook's cell and for `print`."""

from collections.abc import Iterable, Iterator, Sequence
from html import escape
from textwrap import shorten
from typing import Any

Said = Any  # a finding: its code, status, reason and action
CHARACTERS = 200  # of a reason or a remedy at most
SIZE = 1500  # bytes of a table at most


def first_line(status: str, answers: Iterable[tuple[str, str]] = ()) -> str:
    """The status, and that of each answer."""
    parts = ", ".join(f"{name} {answer}" for name, answer in answers)
    return f"Verdict: {status}" + (f" ({parts})" if parts else "")


def text_of(findings: Sequence[Said]) -> Iterator[str]:
    """A line a finding that is not ok, and how many are."""
    against = [finding for finding in findings if finding.status != "ok"]
    for finding in against:
        reason = shorten(finding.reason, CHARACTERS)
        yield f"  {finding.status}, {finding.code}: {reason} {finding.action}".rstrip()
    yield f"  {len(findings) - len(against)} of {len(findings)} checks passed"


def table_of(findings: Sequence[Said], size: int = SIZE) -> str:
    """The same as a table of HTML of at most `size` bytes, the failed first; names escaped."""
    against = sorted((finding for finding in findings if finding.status != "ok"), key=_badness)
    rows, spent = [], 0
    for finding in against:
        cells = finding.status, finding.code, shorten(finding.reason, CHARACTERS), finding.action
        row = "".join(f"<td>{escape(shorten(cell, CHARACTERS))}</td>" for cell in cells)
        spent += len(row.encode()) + 10
        if spent > size:
            break
        rows.append(f"<tr>{row}</tr>")
    omitted = len(against) - len(rows)
    more = f", {omitted} more against it" if omitted else ""
    passed = f"<p>{len(findings) - len(against)} of {len(findings)} checks passed{more}</p>"
    return (f"<table>{''.join(rows)}</table>" if rows else "") + passed


def _badness(finding: Said) -> int:
    return ("failed", "not assessed", "usable").index(finding.status)
