"""NI LabVIEW measurement files (LVM).

Files: .lvm, .txt
Recognised by: the first line `LabVIEW Measurement`
Names: the titles in the line that begins with `X_Value`
Units: `Y_Unit_Label`
Rate: `Delta_X`, or the columns of times if `X_Columns` is `One` or `Multi`; if the digits of
`Delta_X` leave the rate uncertain by more than 1e-4, as 0.000977 does for 1024 Hz, the provenance
says so
Start: `X0`
Based on: the first sections of NI's page "Specification for the LabVIEW Measurement File (.lvm)";
lvm_read.py and the files short, with_comments, with_empty_fields, uneven_comments,
no_decimal_separator and long_single_header_multi_ch of ladisk/lvm_read, which all have the layout
that the reader expects
Untested: special blocks within the data, whose section of that page was not read; commas as
separators
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from jbw.errors import DataError
from jbw.measurement.files.csv import Dialect, table
from jbw.measurement.files.tree import Contents
from jbw.measurement.recorders.recorder import Recorder, number_in, rate_of, top
from jbw.report.messages import reading as messages

END = "***End_of_Header***"
SEPARATORS = {"tab": "\t", "comma": ","}
# An interval's relative rounding is mentioned in the provenance if it exceeds this.
LARGEST_ROUNDING = 1e-4


def is_text(lines: Sequence[str]) -> bool:
    """Return whether a text begins as the LVM specification requires."""
    return bool(lines) and lines[0].strip("\ufeff \t,").startswith("LabVIEW Measurement")


def read_text(lines: Sequence[str], path: Path) -> Contents:
    """Return the only segment of an LVM file: channels with their own rate, start and unit."""
    ends = [i for i, line in enumerate(lines) if line.startswith(END)]
    if len(ends) < 2:
        raise ValueError(f"a LabVIEW measurement has two headers, but this file has {len(ends)}")
    if len(ends) > 2:
        raise DataError(
            f"File `{path.name}` contains {len(ends) - 1} segments of a LabVIEW measurement, but "
            "only files of one segment can be read.",
            remedy="Write each segment into a separate file, or write all segments as TDMS.",
        )
    facts = _facts(lines[: ends[0]])
    mark = SEPARATORS.get(facts.get("separator", ["Tab"])[0].lower(), "\t")
    decimal = facts.get("decimal_separator", ["."])[0] or "."
    segment_facts = _facts(lines[ends[0] + 1 : ends[1]], mark)
    number = int(number_in(segment_facts.get("channels", ["0"])[0]))
    names = [text.strip() for text in lines[ends[1] + 1].split(mark)]
    x_columns = facts.get("x_columns", ["No"])[0].lower()
    if x_columns == "multi":
        return _with_times_of_each(lines[ends[1] + 1 :], path, segment_facts, (mark, decimal))
    has_times = x_columns == "one"
    titles = [names[0] or "X_Value", *names[1 : 1 + number]]
    first = 0 if has_times else 1
    rows = [_cells(line, mark, first, number) for line in lines[ends[1] + 2 :] if line.strip()]
    units = ["s", *_of_each(segment_facts, "y_unit_label", number)][first:]
    dialect = Dialect(mark, decimal, 0, number + 1 - first)
    columns = table(
        rows, path, names=["time" if i == 0 else t for i, t in enumerate(titles)][first:],
        units=units, dialect=dialect,
    )  # fmt: skip
    deltas, starts = (
        _of_each(segment_facts, "delta_x", number),
        _of_each(segment_facts, "x0", number),
    )
    counts = _of_each(segment_facts, "samples", number)
    if has_times:
        return _without_empty(columns, counts)
    is_one_header = facts.get("multi_headings", ["Yes"])[0].lower() == "no"
    notes = dict(columns.notes)
    channels = {}
    for i, (path_of, item) in enumerate((columns.series or {}).items()):
        start = number_in(starts[i])
        packets = _packets(path_of, number_in(counts[i]), item.shape[0], is_one_header)
        if packets > 1:
            notes["packets"] = messages.one_header(packets)
        rounding = _rounding(deltas[i])
        if rounding > LARGEST_ROUNDING:
            notes["digits of Delta_X"] = messages.rounded_rate(rounding)
        start_s = None if np.isnan(start) else start
        channels[path_of] = replace(item, fs=rate_of(number_in(deltas[i])), start_s=start_s)
    return replace(columns, root={**top(columns), **channels}, series=channels, notes=notes)


def _with_times_of_each(
    lines: Sequence[str], path: Path, segment_facts: dict[str, list[str]], marks: tuple[str, str]
) -> Contents:
    """Return the channels of an LVM segment in which each channel has its own column of times."""
    mark, decimal = marks
    number = int(number_in(segment_facts.get("channels", ["0"])[0]))
    names = [text.strip() for text in lines[0].split(mark)]
    titles = ["time" if i % 2 == 0 else name for i, name in enumerate(names[: 2 * number])]
    units = [
        unit for label in _of_each(segment_facts, "y_unit_label", number) for unit in ("s", label)
    ]
    rows = [_cells(line, mark, 0, 2 * number - 1) for line in lines[1:] if line.strip()]
    dialect = Dialect(mark, decimal, 0, 2 * number)
    return table(rows, path, names=titles, units=units, dialect=dialect)


def _without_empty(columns: Contents, counts: Sequence[str]) -> Contents:
    """Return the times and channels without channels that declare no samples."""
    series = columns.series or {}
    if len(series) != 1 + len(counts):
        return columns
    declared = [1.0, *(number_in(count) for count in counts)]
    measured = {
        key: item for (key, item), n in zip(series.items(), declared, strict=True) if n != 0
    }
    return replace(columns, series=measured)


def _packets(name: str, declared: float, size: int, is_one_header: bool) -> int:
    """Return the number of blocks of declared length that follow one header."""
    if np.isnan(declared) or declared == size:
        return 1
    if is_one_header and declared > 0 and size % declared == 0:
        return int(size // declared)
    raise ValueError(f"channel `{name}` declares {declared:g} samples, but has {size}")


def _rounding(text: str) -> float:
    """Return half a unit of a number's last digit, divided by the number; 0 for other text.

    LabVIEW writes six decimals, of which zeros at the end may be missing.
    """
    value = number_in(text)
    mantissa, _, exponent = text.strip().lower().partition("e")
    decimals = max(6, len(mantissa.replace(",", ".").partition(".")[2]))
    return 0.5 * 10.0 ** (int(exponent or 0) - decimals) / value if value > 0 else 0.0


def _facts(lines: Sequence[str], mark: str = "\t") -> dict[str, list[str]]:
    """Return the fields of each header line by its key, in lower case."""
    mark = mark if any(mark in line for line in lines) else ","
    parts = [[text.strip() for text in line.split(mark)] for line in lines]
    return {row[0].lower(): row[1:] for row in parts if row[0] and len(row) > 1}


def _of_each(facts: dict[str, list[str]], key: str, number: int) -> list[str]:
    values = facts.get(key, [])[:number]
    return values + [""] * (number - len(values))


def _cells(line: str, mark: str, first: int, number: int) -> str:
    """Return the numbers of a row without the empty column of times and without a comment."""
    return mark.join(line.split(mark)[first : number + 1])


RECORDER = Recorder("NI LabVIEW LVM", of_text=is_text, read_text=read_text)
