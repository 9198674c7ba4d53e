"""MDF of measurement systems in vehicles, through asammdf, an optional extra."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from jbw.measurement.files.clocks import on_clock
from jbw.measurement.files.tree import Contents, Leaf, Node, leaf, numeric, optional


@contextmanager
def contents(path: Path) -> Iterator[Contents]:
    """Open an MDF file: its groups hold channels, each with rate and start by its group's times.

    Samples are read at once, in the units that the file converts them to.
    """
    root: dict[str, Node] = {}
    series: dict[str, Leaf] = {}
    with optional("asammdf", "mdf", path).MDF(path) as file:
        for number in range(len(file.groups)):
            group: dict[str, Node] = {}
            for signal in file.select(_channels_of(file, number), validate=True):
                item = numeric(np.ma.filled(signal.samples, np.nan))
                if not isinstance(item, Leaf) or len(item.shape) != 1:
                    continue
                group.setdefault("time", leaf(signal.timestamps, unit="s"))
                unit = str(signal.unit or "").strip()
                named = Leaf(item.array, item.axes, unit=unit, label=signal.name)
                group[signal.name] = on_clock(named, signal.timestamps, "s")
                series[f"group {number}.{signal.name}"] = group[signal.name]
            if group:
                root[f"group {number}"] = group
                series = {f"group {number}.time": group["time"], **series}
    yield Contents(root, "MDF", series=series)


def _channels_of(file: object, number: int) -> list[tuple[str, int, int]]:
    """Return name, group and place of the channels of a group but its times."""
    group = file.groups[number]
    master = file.masters_db.get(number)
    return [(channel.name, number, i) for i, channel in enumerate(group.channels) if i != master]
