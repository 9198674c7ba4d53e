"""Python: NumPy, h5py with attributes, pandas, xarray, and SEP-005 data stored in these formats.

Files: .npz, .h5, .hdf5, .nc
Recognised by: a two-dimensional array `data` (in HDF5 any array) with the names of its channels in
an attribute or array `channel_names`, `channels`, `names` or `columns`; `block0_values` for a data
frame of pandas; a coordinate `time` for xarray
Names: that list; `block0_items` of pandas; the variables of xarray
Units: `units`, `unit` or `unit_str`, a list with one unit per channel, or one unit for all
Rate: `fs`, `sampling_rate`, `dt` and the like; the index of a data frame; the coordinate `time`
Start: the first value of index or coordinate
Based on: `BlockManagerFixed` in pandas/io/pytables.py of pandas-dev/pandas; files that xarray
writes with h5netcdf, and xarray/coding/times.py of pydata/xarray; for the keys of SEP-005, which
does not define files, docs/seps/sep-0005.rst of sdypy/sdypy. The names of keys in NumPy and h5py
files come from common knowledge and are not checked against a file or a description.
Untested: a file of `to_hdf` itself, data frames of mixed types, and pandas' table format
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from jbw.measurement.files.clocks import on_clock
from jbw.measurement.files.tree import Contents, Leaf, Opaque, load
from jbw.measurement.recorders.recorder import Recorder, number_in, positive, top

NAMES = ("channel_names", "channels", "names", "columns", "labels", "channel")
UNITS = ("units", "unit", "unit_str", "channel_units")
RATES = ("fs", "sampling_rate", "sample_rate", "sampling_frequency", "samplerate")
INTERVALS = ("dt", "interval", "sampling_interval", "increment")
ITEMS, VALUES, INDEX = "block0_items", "block0_values", "axis1"  # names of pandas' arrays in HDF5


def _list(facts: Mapping[str, Any], keys: tuple[str, ...]) -> list[str]:
    for key in keys:
        value = facts.get(key)
        text = value.text if isinstance(value, Opaque) else value
        if isinstance(text, str) and text:
            return [line.strip() for line in text.split("\n")]
    return []


def _rate(facts: Mapping[str, Any]) -> float | None:
    for keys, to_fs in ((RATES, lambda x: x), (INTERVALS, lambda x: 1 / x)):
        for key in keys:
            value = facts.get(key)
            value = load(value).ravel() if isinstance(value, Leaf) else value
            if value is not None and np.size(value) == 1:
                number = number_in(np.ravel(value)[0])
                if positive(number):
                    return float(to_fs(number))
    return None


def _facts(node: Any, item: Leaf) -> dict[str, Any]:
    """Return the values stored next to an array, and its attributes, which take precedence."""
    siblings = dict(node) if isinstance(node, Mapping) else {}
    return {**siblings, **item.attributes}


def _tables(node: Any, prefix: str = "") -> list[tuple[str, Leaf, dict[str, Any]]]:
    tables = []
    for name, item in node.items() if isinstance(node, Mapping) else ():
        if isinstance(item, Mapping):
            tables += _tables(item, f"{prefix}{name}.")
        elif isinstance(item, Leaf) and len(item.shape) == 2:
            facts = _facts(node, item)
            names = _list(facts, NAMES) or _list(facts, (ITEMS,)) * (name == VALUES)
            if names and names.count("") == 0 and len(names) in item.shape:
                tables.append((f"{prefix}{name}", item, {**facts, "_names": names}))
    return tables


def _clock(node: Any) -> Leaf | None:
    clock = node.get("time") if isinstance(node, Mapping) else None
    is_one = isinstance(clock, Leaf) and len(clock.shape) == 1 and "units" in clock.attributes
    return clock if is_one else None


def is_of(contents: Contents) -> bool:
    """Return whether a file contains a table with channel names."""
    return bool(_tables(top(contents)))


def read(contents: Contents) -> Contents:
    """Return the contents with each row or column of a named table as a channel."""
    root = top(contents)
    series: dict[str, Leaf] = {}
    for _, item, facts in _tables(top(contents)):
        names, units = facts["_names"], _list(facts, UNITS)
        along = 0 if item.shape[0] == len(names) else 1
        if item.shape[0] == item.shape[1]:
            raise ValueError(
                f"a square table of {len(names)} channels does not show whether rows or columns "
                "are channels; export more samples than channels"
            )
        units = units * len(names) if len(units) == 1 else units
        units = units if len(units) == len(names) else [""] * len(names)
        fs, start = _rate(facts) or contents.fs or _rate(contents.attributes), None
        index = facts.get(INDEX)
        if isinstance(index, Leaf) and index.shape == (item.shape[1 - along],):
            # An index of whole numbers only counts the rows, and contains no times.
            clock = on_clock(Leaf(None, (), fs=fs), load(index), "")
            fs, start = clock.fs, clock.start_s
        for i, (name, unit) in enumerate(zip(names, units, strict=True)):
            axis = item.axes[along]
            channel = Leaf(
                item.array, tuple(a for a in item.axes if a != axis), {**item.fixed, axis: i},
                fs, unit, start,
            )  # fmt: skip
            if name in root:
                continue  # The file uses this name for something other than channel names.
            root[name] = series[name] = channel
    return replace(contents, root=root, series=series)


def is_labelled(contents: Contents) -> bool:
    """Return whether an HDF5 file has a coordinate of times, as xarray writes it."""
    return _clock(top(contents)) is not None


def read_labelled(contents: Contents) -> Contents:
    """Return the variables along the time coordinate, which gives the times of all channels."""
    clock = _clock(top(contents))
    if clock is None:
        return contents
    along_clock = {
        str(name): item
        for name, item in top(contents).items()
        if isinstance(item, Leaf) and item.shape == clock.shape
    }
    return replace(contents, series=along_clock)


RECORDERS = (
    Recorder("Python tables", is_of, read, readers=("HDF5", "npz")),
    Recorder("xarray", is_labelled, read_labelled, readers=("HDF5",)),
)
