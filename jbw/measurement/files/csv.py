"""Text columns in their dialects: delimiter, decimal comma, header lines, byte order marks."""

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path

import numpy as np

from jbw.errors import DataError
from jbw.measurement.files.tree import Contents, Node, leaf
from jbw.units import FACTORS, plain, titled

WORDS = {None: "spaces", "\t": "tab", ";": "semicolon", ",": "comma"}
LOOKED_AT = 400  # lines, to find the dialect
LEAST_LINES = 2  # of numbers, before a dialect is believed


@dataclass(frozen=True)
class Dialect:
    """How the numbers are written."""

    delimiter: str | None  # between the fields; None is any white space
    decimal: str  # decimal mark
    first: int = 0  # line of the first numbers, counted from zero
    columns: int = 0  # fields in a line

    def fields(self, line: str) -> list[str]:
        """Fields of a line, without quotes; a delimiter at its end begins none."""
        fields = [text.strip().strip('"') for text in line.split(self.delimiter)]
        return fields[:-1] if self.delimiter and len(fields) > 1 and not fields[-1] else fields

    def is_number(self, text: str) -> bool:
        """Whether a field is a number; a point beside a decimal comma makes it none."""
        if self.decimal == ",":
            text = text.replace(".", "?").replace(",", ".")
        try:
            float(text)
        except ValueError:
            return False
        return True

    def has_decimals(self, fields: Sequence[str]) -> bool:
        """Whether a field is a number with decimals, as no column's number is."""
        return any(self.decimal in text and self.is_number(text) for text in fields)

    def width(self, line: str) -> int:
        """Numbers in a line; 0 when some field is no number, -1 when the line is blank."""
        if not line.strip():
            return -1
        if any(text.count('"') % 2 for text in line.split(self.delimiter)):
            return 0  # the delimiter cuts a quoted field, such as "1,5"
        fields = self.fields(line)
        return len(fields) if all(map(self.is_number, fields)) else 0

    def digits(self, line: str) -> tuple[int, int, int]:
        """Length of a line without signs, and digits of its last number's fraction and exponent."""
        last = (self.fields(line) or [""])[-1].lower()
        mantissa, _, exponent = last.partition("e")
        fraction = mantissa.partition(self.decimal)[2]
        return len(line.replace("-", "").replace("+", "")), len(fraction), len(exponent.strip("+-"))


DIALECTS = tuple(
    Dialect(*marks)
    for marks in (("\t", "."), ("\t", ","), (";", "."), (";", ","), (",", "."), (None, "."),
                  (None, ","))
)  # fmt: skip


@contextmanager
def contents(path: Path) -> Iterator[Contents]:
    """Open a text file of columns; without a header they are `column[0]`, `column[1]`, ..."""
    text = _decode(path.read_bytes())
    lines = text.splitlines()
    dialect = sniff(lines[:LOOKED_AT], path.name)
    header, body = lines[: dialect.first], lines[dialect.first :]
    _refuse_broken(header, dialect, path)
    _refuse_cut(text, body, dialect, path)
    rows = "\n".join(line.rstrip(dialect.delimiter) for line in body).replace('"', "")
    rows = rows.replace(",", ".") if dialect.decimal == "," else rows
    # A short or broken line raises with its number.
    table = np.loadtxt(io.StringIO(rows), delimiter=dialect.delimiter, comments=None, ndmin=2)
    root: dict[str, Node] = {"column": leaf(table.T)}
    root |= {name: leaf(table[:, i], unit=unit) for i, name, unit in _named(header, dialect)}
    notes = {
        "delimiter": WORDS[dialect.delimiter],
        "decimal mark": dialect.decimal,
        "header lines": str(dialect.first),
    }
    yield Contents(root, "CSV", notes=notes)


def sniff(lines: Sequence[str], file: str) -> Dialect:
    """The dialect that reads most of the first lines as numbers, in at least two columns."""
    count, dialect = max((_trial(lines, marks) for marks in DIALECTS), key=lambda found: found[0])
    if count < LEAST_LINES:
        shown = " | ".join(line[:60] for line in lines[:3])
        raise DataError(
            f"File `{file}` does not read as two or more columns of numbers; it begins: {shown!r}.",
            why="A single column is usually a wrong delimiter or decimal mark.",
            remedy="Export columns with a tab or a semicolon between, and a decimal point.",
        )
    if _is_ambiguous(lines, dialect):
        raise DataError(
            f"File `{file}` may hold two columns of integers or one with a decimal comma; "
            f"it begins: {lines[dialect.first][:60]!r}.",
            remedy="Add a header line with the names of the columns, or use semicolons.",
        )
    return dialect


def _trial(lines: Sequence[str], marks: Dialect) -> tuple[int, Dialect]:
    """Lines that read as numbers in the last block of one width, and the dialect if believed."""
    widths = [marks.width(line) for line in lines]
    while widths and widths[-1] < 0:  # blank lines at the end
        widths.pop()
    columns = widths[-1] if widths else 0
    count = len(list(takewhile(lambda width: width == columns, reversed(widths))))
    dialect = replace(marks, first=len(widths) - count, columns=columns)
    return count if columns > 1 else 0, dialect


def _is_ambiguous(lines: Sequence[str], dialect: Dialect) -> bool:
    """`1,5` alone on a line: two integers, or one number with a decimal comma."""
    if dialect.delimiter != "," or dialect.columns % 2:
        return False
    body = [line for line in lines[dialect.first :] if line.strip()]
    if not all(text.strip("+-").isdigit() for line in body for text in dialect.fields(line)):
        return False
    above = len(dialect.fields(lines[dialect.first - 1])) if dialect.first else 0
    return above == dialect.columns // 2 or (dialect.columns == 2 and above != 2)


def _refuse_broken(header: Sequence[str], dialect: Dialect, path: Path) -> None:
    """A line of measured values above the table: one below it broke the table in two."""
    rows = [dialect.fields(line) for line in header]
    wide = [i for i, row in enumerate(rows) if len(row) == dialect.columns]
    # The first line of the table's width may name the columns, by numbers too; and a recorder may
    # list a word and numbers above the names, but not between the names and the table.
    words = [sum(not dialect.is_number(text) for text in row) for row in rows]
    values = [i for i in wide[1:] if words[i] == 0 and dialect.has_decimals(rows[i])]
    last = len(rows) - 1
    if wide and wide[0] < last and len(rows[-1]) >= dialect.columns and words[-1] <= 1:
        values += [last] if dialect.has_decimals(rows[-1]) else []
    share = rows[-1] if rows else []
    tail = share[1 - dialect.columns :]
    if len(share) - 2 * dialect.columns in (-1, 0) and all(map(dialect.is_number, tail)):
        raise DataError(
            f"File `{path}` cannot be read by the csv reader: its header and its first row share "
            f"line {len(rows)}: {header[-1][:60]!r}.",
            why="The first sample would be lost, and with it the beginning of the record.",
            remedy="Break the line behind the names of the columns, or export the file again.",
        )
    if values:
        broken = next(i for i in (*range(values[0], last), last) if words[i] or i not in wide)
        raise DataError(
            f"File `{path}` cannot be read by the csv reader: line {broken + 1} breaks the table "
            f"of {dialect.columns} columns: {header[broken][:60]!r}.",
            why="The lines before it hold numbers, and would be lost.",
            remedy="Copy or export the file again, or correct the line.",
        )


def _refuse_cut(text: str, body: Sequence[str], dialect: Dialect, path: Path) -> None:
    """A last line without its end, with fewer digits than all others: some may be lacking."""
    if text.endswith(("\n", "\r")) or len(body) < 2:
        return
    last, *others = map(dialect.digits, (body[-1], *body[:-1]))
    if any(own < min(column) for own, column in zip(last, zip(*others, strict=True), strict=True)):
        raise DataError(
            f"File `{path}` ({path.stat().st_size} bytes) ends in the middle of a line for the csv "
            f"reader: {body[-1][:60]!r} has no end and fewer digits than every other line.",
            why="The last number may lack digits.",
            remedy="Copy the file again; if it is whole, end its last line.",
        )


def _named(header: Sequence[str], dialect: Dialect) -> Iterator[tuple[int, str, str]]:
    """Columns with their names and units, from the last header lines of the table's width."""
    rows = [dialect.fields(line.lstrip("#% ")) for line in header[-2:]]
    rows = [row for row in rows if len(row) == dialect.columns]
    known = {unit for factors in FACTORS.values() for unit in factors}
    has_units = len(rows) == 2 and all(plain(text.strip("[]()")) in known for text in rows[1])
    titles = (rows[0] if has_units else rows[-1]) if rows else []
    units = [text.strip("[]()") for text in rows[1]] if has_units else [""] * len(titles)
    if not has_units and titles:
        parts = [titled(title) for title in titles]
        alone = len({name for name, _ in parts}) == len(parts)
        titles, units = zip(*parts, strict=True) if alone else (titles, units)
    for i, (title, unit) in enumerate(zip(titles, units, strict=True)):
        # A name that is given twice would be a guess; its columns keep their numbers only.
        if title and titles.count(title) == 1:
            yield i, title, unit


def _decode(data: bytes) -> str:
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")
