"""PicoScope: MATLAB files and text.

Files: .mat, .csv, .txt
Recognised by: a number `Tinterval` and arrays `A`, `B`, ...; in text files columns `Time`, `Channel
A`, ...
Names: the letters of the channels
Units: none in MATLAB files; in text files a separate row in parentheses, such as `(ms),(V),(mV)`
Rate: `Tinterval`; in text files the column of times
Start: `Tstart`
Based on: PicoScope 6 User's Guide (psw.en r32), section 6.1.1.1 "File formats for exported data":
CSV, text with tabs, and MAT-files of version 4; CSV files as public scripts show them, with a blank
line below the units and no blanks after the commas
Untested: a MAT-file that PicoScope wrote; an array of times `T` instead of `Tinterval`; files of
several captured waveforms
"""

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from jbw.measurement.files.tree import Contents, Leaf
from jbw.measurement.recorders.recorder import Recorder, number_at, rate_of, top


def is_of(contents: Contents) -> bool:
    """Return whether a file has PicoScope's interval, and channels named by one letter."""
    root = top(contents)
    return "Tinterval" in root and any(
        re.fullmatch("[A-H]", str(name)) for name in root
    )  # fmt: skip


def read(contents: Contents) -> Contents:
    """Return the contents with the rate and start of every PicoScope channel."""
    root = top(contents)
    series: dict[str, Leaf] = {}
    fs, start = rate_of(number_at(root, "Tinterval")), number_at(root, "Tstart")
    for name, item in top(contents).items():
        if isinstance(item, Leaf) and re.fullmatch("[A-H]", str(name)):
            start_s = None if math.isnan(start) else start
            channel = replace(item, fs=fs, start_s=start_s, label=f"Channel {name}")
            root[name] = series[str(name)] = channel
    return replace(contents, root=root, series=series)


def is_text(lines: Sequence[str]) -> bool:
    """Return whether the columns of a text are named as PicoScope names them."""
    return bool(lines) and re.match(r"\"?Time\"?[,;\t] *\"?Channel [A-H]", lines[0]) is not None


def read_text(lines: Sequence[str], path: Path) -> Contents:
    """Return the table of a PicoScope text, below its names and units."""
    from jbw.measurement.files.csv import table

    return table(lines, path)


RECORDER = Recorder("PicoScope", is_of, read, is_text, read_text, readers=("MATLAB",))
