"""Text columns in any notation: delimiter, decimal mark, names, units, footers, lost cells."""

import io
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from jbw.errors import DataError
from jbw.measurement.channels import Reals
from jbw.measurement.files.cells import is_lost, since_first, stamp, ungrouped
from jbw.measurement.files.clocks import on_clock
from jbw.measurement.files.tree import Contents, Leaf, Node, Opaque, leaf
from jbw.measurement.recorders import of_lines
from jbw.measurement.recorders.recorder import axis_in, is_time, rate_in, stated
from jbw.report.messages import reading as messages
from jbw.units import is_unit, titled

WORDS = {None: "spaces", "\t": "tab", ";": "semicolon", ",": "comma", "|": "stroke"}
LOOKED_AT = 400  # number of lines examined to find the notation of a file
LEAST_LINES = 2  # smallest number of lines of numbers for which a notation is accepted
HEADED = 6  # number of lines above a table that may contain names and units
# first line that spreadsheets write
SEPARATOR = re.compile(r'\s*"?sep\s*=\s*(\\t|.)"?\s*$', re.IGNORECASE)
# entries in a row of units that mean "no unit"
NO_UNIT = ("-", "--", "none", "1", "[-]", "(-)", "[]", "()", "'")
OTHER_UNIT = re.compile(r"EU|%|Pa|[a-z]?C|degC|K|bar|psi|[dDmMyYhHsSfF][dDmMyYhHsSfF.:/ -]*")
COMMENT = re.compile(r'\s*"?(?:[#;%!*]|//)')  # start of a comment line
LEAST_ROWS = 3  # smallest number of rows in a table that has columns of text
PART = re.compile(
    r"(.*?)[\s_.]*[\[(]?\b(?:(re|real)|(im|imag|imaginary))\b\.?[\])]?", re.IGNORECASE
)
KEYED = re.compile(r"^(?:[A-Z]{2,}\s*=|headers?[:;,\t]|columns?[:;,\t])\s*", re.IGNORECASE)


@dataclass(frozen=True)
class Dialect:
    """The notation in which a text file writes its numbers."""

    delimiter: str | None  # text between the fields; None means any white space
    decimal: str  # decimal mark
    first: int = 0  # index of the first line of numbers, counted from zero
    columns: int = 0  # fields in a line
    trailing: bool = False  # whether every line ends with a delimiter

    def fields(self, line: str) -> list[str]:
        """Split a line into fields without quotes; ignore a delimiter that ends every line."""
        fields = [text.strip().strip('"').strip() for text in line.split(self.delimiter)]
        return fields[:-1] if self.trailing and len(fields) > 1 and not fields[-1] else fields

    def is_number(self, text: str) -> bool:
        """Return whether a field is a number; with a decimal comma, it contains no point."""
        if "_" in text:  # Python would accept the underscore
            return False
        for written in (text if self.decimal == "." else None, ungrouped(text, self.decimal)):
            with suppress(ValueError):
                if written is not None:
                    float(written)
                    return True
        return False

    def is_cell(self, text: str) -> bool:
        """Return whether a field is a number, a date, a time or a lost sample."""
        return self.is_number(text) or is_lost(text) or stamp(text) is not None

    def has_decimals(self, fields: Sequence[str]) -> bool:
        """Return whether any field is a number with decimals, which no column number has."""
        return any(self.decimal in text and self.is_number(text) for text in fields)

    def width(self, line: str) -> int:
        """Return the number of cells in a line; 0 if it cannot be read, -1 if it is blank."""
        if not line.strip():
            return -1
        if self.delimiter and self.delimiter not in line:
            return 0  # single columns are handled separately
        if '"' in line and any(text.count('"') % 2 for text in line.split(self.delimiter)):
            return 0  # Here the delimiter occurs within a quoted field, such as "1,5".
        fields = self.fields(line)
        is_row = all(map(self.is_cell, fields)) and not all(map(is_lost, fields))
        return len(fields) if is_row else 0

    def digits(self, line: str) -> tuple[int, int, int]:
        """Return the length of a line, and the fraction and exponent digits of its last number."""
        last = (self.fields(line) or [""])[-1].lower()
        mantissa, _, exponent = last.partition("e")
        fraction = mantissa.partition(self.decimal)[2]
        return len(line.replace("-", "").replace("+", "")), len(fraction), len(exponent.strip("+-"))


DIALECTS = tuple(
    Dialect(*marks)
    for marks in (("\t", "."), ("\t", ","), (";", "."), (";", ","), (",", "."), ("|", "."),
                  (None, "."), (None, ","))
)  # fmt: skip


@contextmanager
def contents(path: Path) -> Iterator[Contents]:
    """Open a text file of columns; without a header they are named `column[0]`, `column[1]`, ..."""
    text = _decode(path.read_bytes())
    lines = text.replace("\r\r\n", "\n").splitlines()
    recorded = of_lines(lines, path)
    yield recorded or table(lines, path, is_ended=text.endswith(("\n", "\r")))


def table(
    lines: Sequence[str],
    path: Path,
    *,
    is_ended: bool = True,
    names: Sequence[str] | None = None,
    units: Sequence[str] | None = None,
    fs: float | None = None,
    dialect: Dialect | None = None,
) -> Contents:
    """Read the table in a text; given names, units, rate and notation replace those in the lines.

    Args:
        lines: Lines of the file, or their version prepared by a recorder module.
        path: Path of the file, for messages.
        is_ended: Whether the last line ends with a line break.
        names: Names of all columns; by default from the lines above the table.
        units: Units of all columns; by default from the lines above the table.
        fs: Sampling frequency [Hz]; by default from the lines above the table, if they state one.
        dialect: Notation of the numbers, if it is known.
    """
    separator = SEPARATOR.match(lines[0].lstrip("\ufeff")) if lines else None
    lines = lines[1:] if separator else lines
    mark = separator[1].replace("\\t", "\t") if separator else ""
    texts = 0
    if dialect is None:
        lines, texts, dialect = _sniffed(lines, path.name, mark)
    header, body = lines[: dialect.first], lines[dialect.first :]
    _refuse_broken(header, dialect, path)
    body, footer = _without_footer(body, dialect)
    is_cut = not is_ended and not footer and _is_cut(body, dialect, path)
    columns, stamped = _columns(body[:-1] if is_cut else body, dialect, path)
    titles, stated = _titles(header, dialect)
    doubts = [] if titles or names is not None else _unfitting_names(header, dialect)
    titles = list(names) if names is not None else titles or [""] * len(columns)
    stated = list(units) if units is not None else stated or [""] * len(columns)
    axis = axis_in(header)
    if axis and not re.search(r"\w", titles[0]):
        titles[0], stated[0] = axis.name, axis.unit
    stated = ["s" if i in stamped else unit for i, unit in enumerate(stated)]
    notes = {
        "delimiter": WORDS.get(dialect.delimiter, str(dialect.delimiter)),
        "decimal mark": dialect.decimal,
        "header lines": str(dialect.first + bool(separator)),
    }
    for name, count in (("footer", len(footer)), ("columns of text", texts), ("cut line", is_cut)):
        notes |= {name: f"{count:d} left out"} if count else {}
    root, series = _tree(columns, titles, stated)
    is_timed = any(is_time(title) for title in titles)
    fs = fs or rate_in(header, with_sentences=not is_timed) or (axis.fs if axis else None)
    return Contents(root, "CSV", fs=fs, notes=notes, series=series, doubts=tuple(doubts))


def _sniffed(lines: Sequence[str], file: str, mark: str) -> tuple[list[str], int, Dialect]:
    """Return a table's lines without text columns, the number of text columns, and the notation."""
    try:
        return list(lines), 0, sniff(lines[:LOOKED_AT], file, mark)
    except DataError as error:
        for marks in DIALECTS:
            texts = _text_columns(lines[:LOOKED_AT], marks)
            if texts:
                numbers = [_without(line, marks, texts) for line in lines]
                with suppress(DataError):
                    found = sniff(numbers[:LOOKED_AT], file, marks.delimiter or "")
                    return numbers, len(texts), found
        raise error


def _text_columns(lines: Sequence[str], marks: Dialect) -> tuple[int, ...]:
    """Return the columns of a table that contain words and no numbers; empty if it is no table."""
    rows = [marks.fields(line) for line in lines if line.strip() and not COMMENT.match(line)]
    tail = [row for row in takewhile(lambda row: len(row) == len(rows[-1]), reversed(rows))
            if any(map(marks.is_number, row))]  # fmt: skip
    if len(tail) < LEAST_ROWS:
        return ()
    columns = list(zip(*tail, strict=True))
    texts = [
        i for i, cells in enumerate(columns)
        if not any(map(marks.is_number, cells)) and not all(map(marks.is_cell, cells))
    ]  # fmt: skip
    numeric = sum(all(map(marks.is_cell, cells)) for cells in columns)
    return tuple(texts) if texts and len(texts) + numeric == len(columns) and numeric > 1 else ()


def _without(line: str, marks: Dialect, columns: Sequence[int]) -> str:
    """Return a line of a text table without the given columns."""
    fields = line.split(marks.delimiter)
    delimiter = marks.delimiter or " "
    return delimiter.join(field for i, field in enumerate(fields) if i not in columns)


def _unfitting_names(header: Sequence[str], dialect: Dialect) -> list[str]:
    """Return a warning if a line of names does not have as many entries as there are columns."""
    rows = [_row(line, dialect) for line in header[-HEADED:] if line.strip()]
    words = [text for text in (rows[-1] if rows else []) if text and not dialect.is_number(text)]
    if len(words) < 2 or dialect.columns < 2:
        return []
    return [messages.unfitting_names(words, dialect.columns)]


def sniff(lines: Sequence[str], file: str, mark: str = "") -> Dialect:
    """Find the notation with which most lines are rows of numbers, or that of a single column."""
    among = [marks for marks in DIALECTS if not mark or marks.delimiter == mark] or DIALECTS
    count, dialect = max((_trial(lines, marks) for marks in among), key=lambda trial: trial[0])
    if count < LEAST_LINES:
        count, dialect = _one_column(lines)
    if count < LEAST_LINES:
        shown = " | ".join(line[:60] for line in lines[:3])
        raise DataError(
            f"File `{file}` must contain two or more columns of numbers, but begins: {shown!r}.",
            why="A single column can be read only if its numbers contain a decimal point and no "
            "other mark.",
            remedy="Export columns that are separated by tabs or semicolons, with decimal points.",
        )
    if _is_ambiguous(lines, dialect):
        raise DataError(
            f"File `{file}` may be two columns of integers or one column with a decimal comma; "
            f"the file begins: {lines[dialect.first][:60]!r}.",
            remedy="Add a header line with the names of the columns, or use semicolons.",
        )
    return dialect


def _trial(lines: Sequence[str], marks: Dialect) -> tuple[int, Dialect]:
    """Count the last lines that are rows of numbers of one width; return also their notation."""
    if marks.delimiter and not any(marks.delimiter in line for line in lines):
        return 0, marks
    widths = [marks.width(line) for line in lines]
    rows = [line for line, width in zip(lines, widths, strict=True) if width > 1]
    if (
        marks.delimiter
        and rows
        and all(line.rstrip(" ").endswith(marks.delimiter) for line in rows)
    ):
        marks = replace(marks, trailing=True)
        widths = [marks.width(line) for line in lines]
    while widths and (widths[-1] < 0 or (widths[-1] == 0 and _is_remark(lines[len(widths) - 1]))):
        widths.pop()  # Blank lines and statistics at the end are skipped.
    columns = widths[-1] if widths else 0
    count = len(list(takewhile(lambda width: width == columns, reversed(widths))))
    dialect = replace(marks, first=len(widths) - count, columns=columns)
    return count if columns > 1 else 0, dialect


def _one_column(lines: Sequence[str]) -> tuple[int, Dialect]:
    """Count the last lines that consist of one decimal number; return their notation as well."""
    marks = Dialect(None, ".")
    widths = [0 if re.search("[,;\t]", line) else marks.width(line) for line in lines]
    while widths and widths[-1] < 0:
        widths.pop()
    count = len(list(takewhile(lambda width: width == 1, reversed(widths))))
    first = len(widths) - count
    is_decimal = any(marks.has_decimals([line.strip()]) for line in lines[first : len(widths)])
    return count if is_decimal else 0, replace(marks, first=first, columns=1)


def _is_label(line: str) -> bool:
    """Return whether a line begins with a word, as a label does, instead of a number."""
    first = line.strip().strip('"#*%')
    return bool(re.match(r"\s*[^\W\d_]{2,}", first)) and not is_lost(first.split(";")[0])


def _is_remark(line: str) -> bool:
    """Return whether a line is a comment or begins with a word, instead of a row of numbers."""
    return bool(COMMENT.match(line)) or _is_label(line)


def _without_footer(body: Sequence[str], dialect: Dialect) -> tuple[list[str], list[str]]:
    """Separate a table's rows from final lines that begin with a word, such as maxima or means."""
    end = len(body)
    while end and (not body[end - 1].strip() or _is_remark(body[end - 1])):
        if body[end - 1].strip() and dialect.width(body[end - 1]) == dialect.columns:
            break
        end -= 1
    return list(body[:end]), [line for line in body[end:] if line.strip()]


def _is_ambiguous(lines: Sequence[str], dialect: Dialect) -> bool:
    """Return whether lines such as `1,5` may be two integers or one decimal number."""
    if dialect.delimiter != "," or dialect.columns % 2:
        return False
    body = [line for line in lines[dialect.first :] if line.strip()]
    if not all(text.strip("+-").isdigit() for line in body for text in dialect.fields(line)):
        return False
    above = len(dialect.fields(lines[dialect.first - 1])) if dialect.first else 0
    return above == dialect.columns // 2 or (dialect.columns == 2 and above != 2)


def _refuse_broken(header: Sequence[str], dialect: Dialect, path: Path) -> None:
    """Raise a DataError if a malformed line splits the table and values stand above that line."""
    rows = [dialect.fields(line) for line in header]
    wide = [i for i, row in enumerate(rows) if len(row) == dialect.columns]
    # The first line with the table's width may name the columns, even by numbers. A recorder may
    # also write a word and numbers above the names, but not between the names and the table.
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
            why="This line would be skipped, and the record would lack its first sample.",
            remedy="Break the line behind the names of the columns, or export the file again.",
        )
    if values:
        broken = next(i for i in (*range(values[0], last), last) if words[i] or i not in wide)
        raise DataError(
            f"File `{path}` cannot be read by the csv reader: line {broken + 1} does not fit the "
            f"table of {dialect.columns} columns: {header[broken][:60]!r}.",
            why=f"The lines before line {broken + 1} contain numbers, which would be lost.",
            remedy=f"Copy or export the file again, or correct line {broken + 1}.",
        )


def _is_cut(body: Sequence[str], dialect: Dialect, path: Path) -> bool:
    """Return whether the last line lacks a line break and has fewer digits than all others.

    Raises:
        DataError: All other lines have the same number of digits, so that some are missing here.
    """
    if len(body) < 2:
        return False
    last, *others = map(dialect.digits, (body[-1], *body[:-1]))
    columns = list(zip(*others, strict=True))
    fewer = [digits < min(column) for digits, column in zip(last, columns, strict=True)]
    if any(fewer) and all(min(column) == max(column) for column in columns[1:]):
        raise DataError(
            f"File `{path}` ({path.stat().st_size} bytes) cannot be read by the csv reader: the "
            f"last line, {body[-1][:60]!r}, has no line end and fewer digits than every other "
            "line.",
            why="The file may be cut off within the last number.",
            remedy="Copy the file again; if the file is complete, add a line end to the last line.",
        )
    return any(fewer)


def _titles(header: Sequence[str], dialect: Dialect) -> tuple[list[str], list[str]]:
    """Return the columns' names and units, from the last lines of equal width above the table."""
    lines = [line for line in header if line.strip()][-HEADED:]
    rows = [_row(line, dialect) for line in lines]
    rows = [row for row in rows if len(row) == dialect.columns]
    units: list[str] = []
    while rows:
        *rows, last = rows
        if not units and _are_units(last) and (rows or len(last) == 1):
            units = [_bare(text) for text in last]
        elif not any(text and not dialect.is_number(text) for text in last):
            if any(text.strip() for text in last) and not rows:
                return last, units or [""] * len(last)  # Numbers may also name the columns.
        else:
            parts = [titled(title) for title in last]
            # Several columns of times may have the same name.
            has_times = sum(is_time(name) for name, _ in parts) > 1
            if len({name for name, _ in parts}) < len(parts) and not has_times:
                return last, units or [""] * len(last)
            behind = [unit for _, unit in parts]
            if not units and not any(behind) and rows and _are_units(rows[-1]):
                units = [_bare(text) for text in rows[-1]]  # The row of units is above the names.
            if not units and not any(behind) and dialect.columns == 1:
                units = _unit_in(header)
            return [name.replace('"', "") for name, _ in parts], units or behind
    return [], []


def _unit_in(header: Sequence[str]) -> list[str]:
    """Return the unit of a single column from a line above it, such as `Unit: g`."""
    units = [stated(line, "units?|einheit|y[ _]units?") for line in header]
    return [text for text in units if text][-1:]


def _row(line: str, dialect: Dialect) -> list[str]:
    """Return the fields of a line above the table, without a final delimiter."""
    if dialect.columns == 1:  # The single name may consist of several words.
        is_fact = rate_in([line]) or stated(line, "units?|einheit|y[ _]units?")
        return [] if is_fact else [line.strip().strip('#% "')]
    fields = dialect.fields(KEYED.sub("", line.lstrip("#%; ")))
    extra = len(fields) == dialect.columns + 1 and not fields[-1] and dialect.delimiter
    return fields[:-1] if extra else fields


def _are_units(row: Sequence[str]) -> bool:
    """Return whether a row consists of units and blanks, with at least one unit."""
    bare = [_bare(text) for text in row]
    return any(map(is_unit, bare)) and all(
        not text or is_unit(text) or OTHER_UNIT.fullmatch(text) for text in bare
    )


def _bare(text: str) -> str:
    """Return a unit without brackets and quotes; empty if the text means "no unit"."""
    text = text.strip(" '\"")
    if text.lower() in NO_UNIT:
        return ""
    outer = re.fullmatch(r"\[([^\[\]]*)\]|\(([^()]*)\)|\{([^{}]*)\}", text)
    return next((part.strip() for part in outer.groups() if part), "") if outer else text


def _columns(
    body: Sequence[str], dialect: Dialect, path: Path
) -> tuple[list[Reals], frozenset[int]]:
    """Return a table's columns, and the indices of columns of dates or times; NaN for lost samples.

    A ValueError names the line that breaks the table.
    """
    rows = "\n".join(
        line.rstrip().rstrip(dialect.delimiter) if dialect.trailing else line for line in body
    ).replace('"', "")
    rows = rows.replace(",", ".") if dialect.decimal == "," else rows
    try:
        if dialect.decimal == "," and any("." in line for line in body[:LOOKED_AT]):
            raise ValueError("grouped digits")
        matrix = np.loadtxt(io.StringIO(rows), delimiter=dialect.delimiter, comments=None, ndmin=2)
    except ValueError:
        return _cell_by_cell(body, dialect)
    if matrix.shape[1] != dialect.columns:
        raise ValueError(f"the table has {matrix.shape[1]} columns instead of {dialect.columns}")
    return list(matrix.T), frozenset()


def _cell_by_cell(body: Sequence[str], dialect: Dialect) -> tuple[list[Reals], frozenset[int]]:
    """Return a table's columns read cell by cell: lost cells, grouped digits, dates, times."""
    cells: list[list[str]] = []
    for i, line in enumerate(body):
        if not line.strip():
            continue
        fields = dialect.fields(line)
        if len(fields) != dialect.columns:
            raise ValueError(
                f"row {i + 1} must have {dialect.columns} columns, but has {len(fields)}: "
                f"{line[:60]!r}"
            )
        cells.append(fields)
    columns, stamped = [], set()
    for k in range(dialect.columns):
        texts = [row[k] for row in cells]
        stamps = [stamp(text) for text in texts]
        if any(stamps) and not any(dialect.is_number(text) for text in texts):
            if bad := next((i for i, (s, x) in enumerate(zip(stamps, texts, strict=True))
                            if s is None and not is_lost(x)), None):  # fmt: skip
                raise ValueError(f"row {bad + 1} contains an unreadable time: {texts[bad][:40]!r}")
            columns.append(since_first(stamps))
            stamped.add(k)
            continue
        columns.append(np.array([_value(text, dialect, i, k) for i, text in enumerate(texts)]))
    return columns, frozenset(stamped)


def _value(text: str, dialect: Dialect, row: int, column: int) -> float:
    if dialect.is_number(text):
        return float(ungrouped(text, dialect.decimal))
    if is_lost(text):
        return float("nan")
    raise ValueError(
        f"could not convert string {text[:40]!r} to float64 at row {row}, column {column + 1}."
    )


def _tree(
    columns: Sequence[Reals], titles: Sequence[str], units: Sequence[str]
) -> tuple[dict[str, Node], dict[str, Leaf]]:
    """Return all columns by number and by title, and the measured columns by path."""
    titles = list(titles) if len(titles) == len(columns) else [""] * len(columns)
    units = list(units) if len(units) == len(columns) else [""] * len(columns)
    # A column with a single date contains no times.
    moving = [len(np.unique(column[np.isfinite(column)])) > 1 for column in columns]
    clocks = [i for i, title in enumerate(titles) if is_time(title) and moving[i]]
    leaves = _on_own_clocks(columns, titles, units, clocks)
    root: dict[str, Node] = {"column": _numbered(columns, leaves)}
    series: dict[str, Leaf] = {}
    pairs = _complex_pairs(titles, leaves)
    parts = {title for title in titles if _part(title)[0] in pairs}
    for i, (title, column_leaf) in enumerate(zip(titles, leaves, strict=True)):
        # A name that occurs twice is ambiguous, so its columns are accessible only by number.
        is_unique = bool(title) and titles.count(title) == 1
        if is_unique:
            root[title] = column_leaf
        if title not in parts:
            series[title if is_unique else f"column[{i}]"] = column_leaf
    return root | pairs, series | pairs


def _part(title: str) -> tuple[str, bool]:
    """Return the channel to which a real or imaginary part belongs, and whether it is real."""
    match = PART.fullmatch(title)
    return (match[1] or "response", bool(match[2])) if match else ("", False)


def _complex_pairs(titles: Sequence[str], leaves: Sequence[Leaf]) -> dict[str, Leaf]:
    """Return complex channels, by name, whose real and imaginary parts are columns."""
    found = {_part(title): i for i, title in enumerate(titles)}
    pairs = {}
    for (name, is_real), i in found.items():
        if name and is_real and (name, False) in found:
            real, imaginary = leaves[i], leaves[found[name, False]]
            both = np.asarray(real.array) + 1j * np.asarray(imaginary.array)
            pairs[name] = replace(leaf(both), unit=real.unit, label=name)
    return pairs


def _numbered(columns: Sequence[Reals], leaves: Sequence[Leaf]) -> Node:
    """Return columns by number: as one table if all are alike, otherwise as channels."""
    if all(column_leaf.fs is None and not column_leaf.unit for column_leaf in leaves):
        return leaf(np.stack(columns)) if columns else Opaque("empty")
    numbered: NDArray[np.object_] = np.empty(len(leaves), dtype=object)
    numbered[:] = leaves
    return numbered


def _on_own_clocks(
    columns: Sequence[Reals], titles: Sequence[str], units: Sequence[str], clocks: Sequence[int]
) -> list[Leaf]:
    """Return columns as channels, each with the nearest column of times to its left.

    Empty cells below the end of a shorter column, and those between the samples of a slower one,
    are no lost samples.
    """
    plain_leaves = [
        replace(leaf(column), unit=unit, label=title)
        for column, title, unit in zip(columns, titles, units, strict=True)
    ]
    if len(clocks) < 2:
        return [_of_slower(plain_leaf, columns, clocks) for plain_leaf in plain_leaves]
    leaves = []
    for i, plain_leaf in enumerate(plain_leaves):
        clock = max((k for k in clocks if k <= i), default=None)
        if clock is None:
            leaves.append(plain_leaf)
            continue
        time = columns[clock]
        size = _filled(time)
        if _filled(columns[i]) > size:
            raise ValueError(
                f"column {i + 1} has more values than its column of times, column {clock + 1}"
            )
        plain_leaf = replace(leaf(columns[i][:size]), unit=plain_leaf.unit, label=plain_leaf.label)
        timed = plain_leaf if i == clock else on_clock(plain_leaf, time[:size], units[clock])
        leaves.append(timed)
    return leaves


def _filled(column: Reals) -> int:
    """Return the length of a column without empty cells at its end."""
    filled = np.flatnonzero(np.isfinite(column))
    return int(filled[-1]) + 1 if len(filled) else 0


def _of_slower(full_rate: Leaf, columns: Sequence[Reals], clocks: Sequence[int]) -> Leaf:
    """Return a channel that fills only every k-th row, at its own slower rate."""
    values = np.asarray(full_rate.array)
    is_filled = np.isfinite(values)
    step = _stride(is_filled)
    if step < 2 or len(clocks) != 1:
        return full_rate
    first = int(np.argmax(is_filled))
    time = columns[clocks[0]][first::step]
    slow = replace(leaf(values[first::step]), unit=full_rate.unit, label=full_rate.label)
    return on_clock(slow, time, "s")


def _stride(is_filled: NDArray[np.bool_]) -> int:
    """Return the spacing of the filled rows if it is constant, otherwise 1."""
    rows = np.flatnonzero(is_filled)
    if len(rows) < 3 or 2 * len(rows) > len(is_filled) + 1:
        return 1
    steps = np.unique(np.diff(rows))
    return int(steps[0]) if len(steps) == 1 and rows[0] < steps[0] else 1


def _decode(data: bytes) -> str:
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16")
    if data[1:64:2] and not any(data[1:64:2]):
        return data.decode("utf-16-le", "replace")
    data = data.replace(b"\0", b"")  # Some recorders leave null bytes when they are switched off.
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")
