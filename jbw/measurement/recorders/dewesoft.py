"""DEWESoft X: MATLAB files and text.

Files: .mat, .csv, .txt
Recognised by: arrays `Data1_NAME`, each with an array `Data1_time_NAME`; in text files a preamble
with `Sample rate` and `Data info`
Names: the text after `Data1_`; in text files the titles of the columns
Units: none in MATLAB files; in text files in parentheses after the names
Rate: the times of each channel; in text files the column of times, with which `Sample rate` must
agree
Start: the first time of each channel
Based on: public scripts that load such exports
Untested: files of asynchronous channels
"""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from jbw.measurement.files.clocks import on_clock
from jbw.measurement.files.tree import Contents, Leaf, load
from jbw.measurement.recorders.recorder import (
    Recorder,
    number_at,
    rate_of,
    stated,
    titled_leaf,
    top,
)

TIME = re.compile(r"(Data\d+)_time_?(.*)")


def is_of(contents: Contents) -> bool:
    """Return whether a MATLAB file has arrays named like DEWESoft's times, `Data1_time_NAME`."""
    return any(TIME.fullmatch(str(name)) for name in top(contents))


def read(contents: Contents) -> Contents:
    """Return the contents with each channel's rate and start, from the channel's own times."""
    root = top(contents)
    series: dict[str, Leaf] = {}
    for name, item in top(contents).items():
        data = re.fullmatch(r"(Data\d+)_(.+)", str(name))
        if TIME.fullmatch(str(name)) or not (data and isinstance(item, Leaf)):
            continue
        clock = root.get(f"{data[1]}_time_{data[2]}", root.get(f"{data[1]}_time"))
        channel = titled_leaf(item, data[2])
        if isinstance(clock, Leaf) and clock.shape == item.shape:
            channel = on_clock(channel, np.ravel(load(clock)), "s")
        root[name] = series[str(name)] = channel
    fs = rate_of(1 / number_at(root, "Sample_rate")) if "Sample_rate" in root else None
    return replace(contents, root=root, series=series, fs=contents.fs or fs)


def is_text(lines: Sequence[str]) -> bool:
    """Return whether the first lines of a text are a DEWESoft preamble."""
    has_rate = any(stated(line, "sample rate") for line in lines)
    return has_rate and any(line.lower().lstrip(' "').startswith("data info") for line in lines)


def read_text(lines: Sequence[str], path: Path) -> Contents:
    """Return the table below the preamble of a DEWESoft text."""
    from jbw.measurement.files.csv import table

    return table(lines, path)


RECORDER = Recorder("DEWESoft", is_of, read, is_text, read_text, readers=("MATLAB",))
