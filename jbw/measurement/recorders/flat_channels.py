"""HBK Pulse (B&K) and HBM catman: flat MATLAB files.

Files: .mat
Recognised by: a struct `File_Header` with `SampleFrequency`, and arrays `Channel_1_Data`
Names: `Channel_1_Header.SignalName`
Units: `Channel_1_Header.Unit`
Rate: `File_Header.SampleFrequency`, as text, perhaps with a decimal comma
Start: none
Based on: the reader of the ITA toolbox, public scripts for exports of PULSE and of catman
Untested: files of several rates
"""

import math
import re
from dataclasses import replace

from jbw.measurement.files.tree import Contents, Leaf
from jbw.measurement.recorders.recorder import Recorder, named, number_at, positive, text_at, top

DATA = re.compile(r"(Channel_\d+)_Data")


def is_of(contents: Contents) -> bool:
    """Return whether a file has the header and channel arrays of HBK Pulse or HBM catman."""
    root = top(contents)
    return not math.isnan(number_at(root, "File_Header", "SampleFrequency")) and any(
        DATA.fullmatch(str(name)) for name in root
    )


def read(contents: Contents) -> Contents:
    """Return the contents with the rate and each channel's name and unit, from the headers."""
    root = top(contents)
    series: dict[str, Leaf] = {}
    fs = positive(number_at(root, "File_Header", "SampleFrequency"))
    count = number_at(root, "File_Header", "NumberOfSamplesPerChannel")
    for name, item in top(contents).items():
        match = DATA.fullmatch(str(name))
        if not (match and isinstance(item, Leaf)):
            continue
        header = f"{match[1]}_Header"
        size = max(item.shape, default=0)
        if not math.isnan(count) and count != size:
            raise ValueError(f"`{name}` contains {size} samples, but the file declares {count:g}")
        title = text_at(root, header, "SignalName") or str(name)
        channel = named(item, title, text_at(root, header, "Unit"))
        root[name] = series[str(name)] = replace(channel, fs=fs)
    return replace(contents, root=root, series=series)


RECORDER = Recorder("HBK Pulse and HBM catman", is_of, read, readers=("MATLAB",))
