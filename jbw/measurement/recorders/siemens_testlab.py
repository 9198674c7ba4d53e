"""Siemens Simcenter Testlab, formerly LMS Test.Lab: MATLAB files.

Files: .mat
Recognised by: structs, of any name such as `Signal_0`, with `x_values.increment` and
`y_values.values`
Names: `function_record.name` of each struct
Units: `y_values.quantity.label`
Rate: `x_values.increment`; if `x_values.quantity.label` is Hz, the file is a spectrum and this is
the step of its frequencies
Start: `x_values.start_value`
Based on: public scripts that load such exports, and the public KAIST data sets of rotating machines
Untested: files whose units must be converted by `unit_transformation`; exports of several runs
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from jbw.measurement.files.tree import Contents, Leaf, leaf
from jbw.measurement.recorders.recorder import Recorder, node_at, number_at, rate_of, text_at, top
from jbw.units import plain


def signals(contents: Contents) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the structs of signals at the top level of a Testlab file, by name."""
    for name, node in top(contents).items():
        values = node_at(node, "y_values", "values")
        if isinstance(values, Leaf) and not math.isnan(number_at(node, "x_values", "increment")):
            yield str(name), node


def is_of(contents: Contents) -> bool:
    """Return whether a MATLAB file contains structs of Testlab signals."""
    return any(True for _ in signals(contents))


def read(contents: Contents) -> Contents:
    """Return rate, unit, start and name of each signal; its columns become separate channels."""
    root = top(contents)
    series: dict[str, Leaf] = {}
    for name, node in signals(contents):
        values = node["y_values"]["values"]
        increment = number_at(node, "x_values", "increment")
        start = number_at(node, "x_values", "start_value")
        count = number_at(node, "x_values", "number_of_values")
        size = max(values.shape, default=0)
        if count not in (size, 0) and not math.isnan(count):
            raise ValueError(f"signal `{name}` declares {count:g} values, but contains {size}")
        label = text_at(node, "function_record", "name") or name
        unit = text_at(node, "y_values", "quantity", "label")
        if plain(text_at(node, "x_values", "quantity", "label")) == "Hz":
            hz = (0.0 if math.isnan(start) else start) + increment * np.arange(size)
            signal = replace(values, unit=unit, label=label)
            added = {"frequency": replace(leaf(hz, unit="Hz"), label="frequency")}
            series[f"{name}.frequency"] = added["frequency"]
        else:
            start_s = None if math.isnan(start) else start
            signal = replace(values, fs=rate_of(increment), unit=unit, label=label, start_s=start_s)
            added = {}
        root[name] = {**node, **added, "y_values": {**node["y_values"], "values": signal}}
        path = f"{name}.y_values.values"
        if len(signal.shape) == 2 and signal.shape[1] < signal.shape[0]:
            series |= {f"{path}[:, {i}]": _column(signal, i) for i in range(signal.shape[1])}
        else:
            series[path] = signal
    return replace(contents, root=root, series=series)


def _column(values: Leaf, i: int) -> Leaf:
    axis = values.axes[1]
    return replace(values, axes=values.axes[:1], fixed={**values.fixed, axis: i})


RECORDER = Recorder("Siemens Testlab", is_of, read, readers=("MATLAB",))
