"""Rattlesnake, a controller of vibration tests: NetCDF.

Files: .nc, .nc4
Recognised by: an array `time_data` with a row per channel, and a group `channels`
Names: the type of each channel, then its node and direction
Units: `channels.unit`
Rate: the attribute `sample_rate`
Start: none
Based on: the user's manual of sandialabs/rattlesnake-vibration-controller, chapter on output files
Untested: files of several environments with other rates
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from jbw.measurement.files.tree import Contents, Leaf, Opaque, load
from jbw.measurement.recorders.recorder import Recorder, node_at, positive, top
from jbw.units import plain


def _texts(channels: Mapping[str, Any], name: str, number: int) -> list[str]:
    """Return one attribute of every channel as text; empty texts if the file lacks it."""
    node = channels.get(name)
    if isinstance(node, Opaque):
        found = node.text.split("\n")
    else:
        found = [f"{x:g}" for x in np.ravel(load(node))] if isinstance(node, Leaf) else []
    return [text.strip() for text in found] if len(found) == number else [""] * number


def is_of(contents: Contents) -> bool:
    """Return whether a file has the samples and the group of channels of Rattlesnake."""
    root = top(contents)
    table = root.get("time_data")
    is_table = isinstance(table, Leaf) and len(table.shape) == 2
    return is_table and isinstance(root.get("channels"), Mapping)


def read(contents: Contents) -> Contents:
    """Return the contents with each row of samples as a channel with name, unit and rate."""
    root = top(contents)
    table, channels = root["time_data"], node_at(root, "channels")
    number = table.shape[0]
    facts = [
        _texts(channels, name, number)
        for name in ("channel_type", "node_number", "node_direction", "comment", "unit")
    ]
    fs = positive(float(contents.attributes.get("sample_rate", 0.0))) or contents.fs
    series: dict[str, Leaf] = {}
    for i, (*words, unit) in enumerate(zip(*facts, strict=True)):
        axis = table.axes[0]
        series[f"time_data[{i}]"] = replace(
            table, axes=table.axes[1:], fixed={**table.fixed, axis: i}, fs=fs, unit=plain(unit),
            label=" ".join(filter(None, words)),
        )  # fmt: skip
    root["time_data"] = replace(table, fs=fs)
    return replace(contents, root=root, series=series)


RECORDER = Recorder("Rattlesnake", is_of, read, readers=("HDF5",))
