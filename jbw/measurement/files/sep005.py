"""Conversion from and to SEP-005, the time-series dictionaries of the sdypy community."""

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jbw.errors import DataError, naming
from jbw.measurement.faults.channels import inspect
from jbw.measurement.files.assemble import records_of
from jbw.measurement.files.clocks import sampling_frequency
from jbw.measurement.files.read import report
from jbw.measurement.files.sampling import Wanted
from jbw.measurement.files.tree import Contents, Leaf, leaf
from jbw.measurement.records import ROLES, Record

# the standard's letter for the measured quantity of each role
QUANTITIES = {"force": "f", "acceleration": "a", "velocity": "v", "displacement": "d"}
NEEDED = ("name", "data", "unit_str")


def from_sep005(
    series: Sequence[Mapping[str, Any]],
    channels: Mapping[str, str] | None = None,
    *,
    name: str = "SEP-005",
) -> Record:
    """Return SEP-005 series that were sampled together as one checked record in SI units.

    `channels` gives the name of the series of each role. Without it, series named like a role are
    taken, or else series whose `quantity` belongs to a role.

    Examples:
        A series in mm/s becomes a channel in m/s:

        >>> import jbw
        >>> import numpy as np
        >>> v = 20.0 * np.cos(118.0 * np.arange(1024) / 512.0)
        >>> series = {"name": "laser", "quantity": "v", "data": v, "fs": 512.0, "unit_str": "mm/s"}
        >>> record = jbw.from_sep005([series])
        >>> print(record.channels["velocity"][0], record.units["velocity"])
        0.02 m/s
    """
    leaves = [_leaf(signal, i) for i, signal in enumerate(series)]
    names = [str(signal["name"]) for signal in series]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise DataError(
            f"{name}: {names.count(repeated[0])} series have the name {repeated[0]!r}.",
            remedy="Give each series a different name, because the name identifies a channel.",
        )
    digest = hashlib.sha256(b"".join(np.asarray(signal["data"]).tobytes() for signal in series))
    contents = Contents(dict(zip(names, leaves, strict=True)), "SEP-005")
    if channels is None:
        role_of = {letter: role for role, letter in QUANTITIES.items()}
        channels = {role: role for role in names if role in ROLES} or {
            role_of[signal["quantity"]]: str(signal["name"])
            for signal in series
            if signal.get("quantity") in role_of
        }
    with naming(name):
        (record,) = records_of(contents, Path(name), Wanted(channels), digest.hexdigest())
    report(record, inspect(record))
    return record


def to_sep005(record: Record, names: Mapping[str, str] | None = None) -> list[dict[str, Any]]:
    """Return the channels of a time record as SEP-005 dictionaries in SI, named by `names`.

    Examples:
        A channel becomes a series under the name that the other tool knows:

        >>> import jbw
        >>> import numpy as np
        >>> record = jbw.Record(512.0, {"velocity": np.zeros(1024)}, {"velocity": "m/s"})
        >>> (series,) = jbw.to_sep005(record, names={"velocity": "laser"})
        >>> print(series["name"], series["quantity"], series["unit_str"], series["fs"])
        laser v m/s 512.0
    """
    if np.isnan(record.fs):
        raise DataError(
            f"SEP-005 stores only time series, but record {record.name} is a response curve.",
            remedy="Write the columns of the curve as CSV.",
        )
    signals = []
    for role, samples in record.channels.items():
        name, unit = (names or {}).get(role, role), record.units[role]
        signal = {"name": name, "data": samples, "fs": record.fs, "unit_str": unit}
        quantity = {"quantity": QUANTITIES[role]} if role in QUANTITIES else {}
        signals.append({**signal, **quantity, "group": record.name})
    return signals


def _leaf(signal: Mapping[str, Any], i: int) -> Leaf:
    missing = [key for key in NEEDED if key not in signal]
    if missing:
        raise DataError(
            f"SEP-005 series [{i}] has no `{missing[0]}`.",
            remedy=f"Each series needs {', '.join(NEEDED)}, and fs or time.",
        )
    name, data, time = signal["name"], np.asarray(signal["data"]), signal.get("time")
    if data.ndim != 1 or not np.issubdtype(data.dtype, np.number):
        raise DataError(
            f"SEP-005 series {name!r}: `data` must be one axis of numbers, "
            f"but has shape {data.shape} and type {data.dtype}."
        )
    fs = signal.get("fs")
    if time is not None:
        time = np.asarray(time)
        if time.shape != data.shape:
            raise DataError(
                f"SEP-005 series {name!r}: `time` and `data` must have equally many values, but "
                f"have {time.size} and {data.size}."
            )
        fs = sampling_frequency(time, f"{name}, time")[0] if fs is None else fs
    return leaf(data, fs=None if fs is None else float(fs), unit=str(signal["unit_str"]))
