"""Oscilloscopes of Tektronix and Rigol: text with settings and samples in the same lines.

Files: .csv, .txt
Recognised by: Tektronix: `Record Length` in the first line, settings in the first columns and
samples in the last two; Rigol: a first line with the channels, `Start` and `Increment`, perhaps
with `X` before them
Names: Tektronix `Source`; Rigol the channels of the first line
Units: Tektronix `Vertical Units`; Rigol the second line
Rate: Tektronix `Sample Interval`, which must agree with the times; Rigol `Increment`
Start: Tektronix the first time; Rigol `Start`
Based on: Tektronix F0000CH1.CSV of chemdrv/python-for-pchem (TDS2001C) and of
MeesJanmaat/NSP2_Experiment (its last part), and "Reading oscilloscope data" of kevinpt/ripyl; Rigol
NewFile1.csv of Cbabe/Power_Electronics
Untested: several Tektronix channels in one file; Rigol's older files, which begin with
`Time,X(CH1)`
"""

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from jbw.measurement.files.csv import table
from jbw.measurement.files.tree import Contents
from jbw.measurement.recorders.recorder import Recorder, number_in, rate_of, top


def is_tektronix(lines: Sequence[str]) -> bool:
    """Return whether a text has Tektronix settings next to the samples."""
    return bool(lines) and re.match(r"\"?Record Length\"?,[^,]*,[^,]*,[^,]*,", lines[0]) is not None


def read_tektronix(lines: Sequence[str], path: Path) -> Contents:
    """Return the last two columns of a Tektronix text, which are times and samples."""
    rows = [line.rstrip().rstrip(",").split(",") for line in lines if line.strip()]
    facts = {row[0].strip('" '): row[1].strip('" ') for row in rows if len(row) > 1 and row[0]}
    texts = [",".join(cell.strip() for cell in row[3:5]) for row in rows]
    name = facts.get("Source", "CH1") or "CH1"
    units = [facts.get("Horizontal Units", "s") or "s", facts.get("Vertical Units", "")]
    return table(texts, path, names=["time", name], units=units,
                 fs=rate_of(number_in(facts.get("Sample Interval", ""))))  # fmt: skip


def is_rigol(lines: Sequence[str]) -> bool:
    """Return whether the first line of a text ends with Rigol's start and increment."""
    return (
        bool(lines)
        and re.match(r"(?:X|CH\d),.*,?\s*Start,\s*Increment", lines[0], re.I) is not None
    )


def read_rigol(lines: Sequence[str], path: Path) -> Contents:
    """Return the channels of a Rigol text at the rate stated in its second line."""
    first = [text.strip() for text in lines[0].split(",") if text.strip()][:-2]
    counted = first[0].upper() == "X"  # This column numbers the samples.
    second = [text.strip() for text in lines[1].split(",")]
    units, numbers = second[: len(first)], second[len(first) :]
    rows = [",".join(line.split(",")[: len(first)]) for line in lines[2:]]
    names = ["number", *first[1:]] if counted else first
    units = ["", *units[1:]] if counted else units
    fs = rate_of(number_in(numbers[1]) if len(numbers) > 1 else 0.0)
    columns = table(rows, path, names=names, units=units, fs=fs)
    start = number_in(numbers[0]) if numbers else math.nan
    start_s = None if math.isnan(start) else start
    series = {
        name: replace(item, start_s=start_s)
        for name, item in (columns.series or {}).items()
        if name != "number"
    }
    return replace(columns, root={**top(columns), **series}, series=series)


RECORDERS = (
    Recorder("Tektronix", of_text=is_tektronix, read_text=read_tektronix),
    Recorder("Rigol", of_text=is_rigol, read_text=read_rigol),
)
