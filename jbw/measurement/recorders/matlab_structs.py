"""MATLAB structs: exported tables and timetables, and arrays stored with their units and a rate.

Files: .mat
Recognised by: `Properties.VariableNames` and `Properties.VariableUnits`; or arrays with a field
`units`, which is a struct with one text per array name, or a list with one text per array
Names: the names of the fields
Units: `VariableUnits`, or `units`
Rate: a field `Time`; or a text or number called `fs`, `sample_rate`, and the like; or a number
`dt`, in seconds
Start: the first time
Based on: MathWorks' documentation of tables and timetables, and of MAT-files
Untested: tables stored as MATLAB's own objects; jbw refuses these and says what to export
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from jbw.measurement.files.tree import RATE, Contents, Leaf, Opaque
from jbw.measurement.recorders.recorder import (
    Recorder,
    node_at,
    number_at,
    number_in,
    positive,
    rate_of,
    top,
)

INTERVALS = ("dt", "Dt", "DT", "Tsample", "sampling_interval", "sample_interval")
UNITS = ("units", "Units", "unit", "VariableUnits")


def _texts(node: Any) -> list[str]:
    """Return the texts of a cell array, or the lines of one text."""
    if isinstance(node, Opaque):
        return [line.strip() for line in node.text.split("\n")] if node.text else []
    if isinstance(node, np.ndarray):
        return [item.text.strip() if isinstance(item, Opaque) else "" for item in node.ravel()]
    return []


def _units_of(node: Mapping[str, Any]) -> dict[str, str]:
    """Return the units of a struct's arrays by name; empty if none are stated."""
    fields = [name for name, item in node.items() if isinstance(item, Leaf)]
    properties = node_at(node, "Properties")
    if isinstance(properties, Mapping):
        names = _texts(properties.get("VariableNames"))
        units = _texts(properties.get("VariableUnits"))
        return dict(zip(names, units, strict=False)) if len(names) == len(units) else {}
    for key in UNITS:
        stated_units = node.get(key)
        if isinstance(stated_units, Mapping):
            return {n: x.text.strip() for n, x in stated_units.items() if isinstance(x, Opaque)}
        texts = _texts(stated_units)
        series = [n for n in fields if max(node[n].shape, default=0) > 1]
        if texts and len(texts) == len(series):
            return dict(zip(series, texts, strict=True))
    return {}


def _rate_of(node: Mapping[str, Any]) -> float | None:
    """Return a struct's rate, stated as text or as an interval [s]; None if it is not stated."""
    for name, item in node.items():
        if isinstance(item, Opaque) and item.text and RATE.search(str(name)):
            return positive(number_in(item.text))
        if str(name) in INTERVALS and isinstance(item, Leaf) and max(item.shape, default=1) == 1:
            return rate_of(number_at(node, str(name)))
    return None


def _states_units(node: Any) -> bool:
    return isinstance(node, Mapping) and bool(_units_of(node) or _rate_of(node))


def is_of(contents: Contents) -> bool:
    """Return whether a file, or a struct in it, states units or a rate for its arrays."""
    root = top(contents)
    return _states_units(root) or any(_states_units(node) for node in root.values())


def read(contents: Contents) -> Contents:
    """Return the contents with the units and the rate that are stated next to the arrays."""
    root = _with_units(top(contents))
    for name, node in top(contents).items():
        if _states_units(node):
            root[name] = _with_units(node)
    return replace(contents, root=root)


def _with_units(node: Any) -> dict[str, Any]:
    units, fs = _units_of(node), _rate_of(node)
    return {
        name: replace(item, unit=item.unit or units.get(name, ""), fs=item.fs or fs)
        if isinstance(item, Leaf) and max(item.shape, default=0) > 1
        else item
        for name, item in node.items()
    }


RECORDER = Recorder("MATLAB structs", is_of, read, readers=("MATLAB", "npz"))
