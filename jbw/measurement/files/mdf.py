"""MDF files of vehicle measurement systems, read by the optional package asammdf."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from jbw.measurement.files.clocks import on_clock
from jbw.measurement.files.tree import Contents, Leaf, Node, leaf, numeric, optional


@contextmanager
def contents(path: Path) -> Iterator[Contents]:
    """Open an MDF file as groups of channels; each group's times determine its rate and start.

    All samples are read at once, in the units to which the file converts them.
    """
    root: dict[str, Node] = {}
    series: dict[str, Leaf] = {}
    with optional("asammdf", "mdf", path).MDF(path) as file:
        for number in range(len(file.groups)):
            group = _group(file, number)
            if group:
                root[f"group {number}"] = group
                series |= {f"group {number}.{name}": item for name, item in group.items()}
    yield Contents(root, "MDF", series=series)


def _group(file: Any, number: int) -> dict[str, Leaf]:
    """Return the channels of a group that have one number per time, preceded by the times."""
    channels, master = file.groups[number].channels, file.masters_db.get(number)
    chosen = [(channel.name, number, i) for i, channel in enumerate(channels) if i != master]
    group: dict[str, Leaf] = {}
    for signal in file.select(chosen):
        item = numeric(np.asarray(signal.samples))
        if isinstance(item, Leaf) and len(item.shape) == 1:
            group.setdefault("time", leaf(signal.timestamps, unit="s"))
            channel = replace(item, unit=str(signal.unit or "").strip(), label=signal.name)
            group[signal.name] = on_clock(channel, signal.timestamps, "s")
    return group
