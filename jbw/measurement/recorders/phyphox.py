"""Telephones: phyphox and other apps that write a table for each sensor.

Files: .csv, .txt, .tsv
Recognised by: a first column `Time (s)` and columns such as `Acceleration x (m/s^2)`
Names: the columns
Units: in parentheses after the names
Rate: the times, which are not evenly spaced: `jbw init` proposes `resample`
Start: the first time
Based on: DataExport.java of phyphox/phyphox-android: quoted names, comma, semicolon or tab, decimal
comma or point, ten digits, NaN at the end of shorter columns; and `Raw Data.csv` of
PHIRElab/ExampleAccML
Untested: tables with sensors that are sampled at different times; exports of other apps
"""

import re
from collections.abc import Sequence
from pathlib import Path

from jbw.measurement.files.csv import table
from jbw.measurement.files.tree import Contents
from jbw.measurement.recorders.recorder import Recorder

FIRST = re.compile(
    r"\"?Time \(s\)\"?[,;\t]\"?(?:Linear |Absolute |Total )?(?:Acceleration|Gyroscope)", re.I
)


def is_text(lines: Sequence[str]) -> bool:
    """Return whether the columns of a text are those of a telephone's sensor."""
    return bool(lines) and FIRST.match(lines[0].lstrip("\ufeff")) is not None


def read_text(lines: Sequence[str], path: Path) -> Contents:
    """Return the table of a phyphox text."""
    return table(lines, path)


RECORDER = Recorder("phyphox", of_text=is_text, read_text=read_text)
