"""UFF 58 through pyuff, an optional extra: every set counted, its declared length compared."""

import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from jbw.errors import DataError
from jbw.measurement.files.sampling import sampling_frequency
from jbw.measurement.files.tree import Contents, Node, leaf
from jbw.measurement.records import Record

TIME_RESPONSE, FREQUENCY_RESPONSE = 1, 4  # function types of the format
SET_58 = re.compile(rb"^ {4}-1 *\r?\n *58[ b]", re.MULTILINE)


@contextmanager
def contents(path: Path) -> Iterator[Contents]:
    """Open a universal file as `set[0]`, `set[1]`, ..., and by their names where unique."""
    declared = len(SET_58.findall(path.read_bytes()))
    sets = [found for found in _all_sets(path) if found.get("type") == 58]
    if not sets or len(sets) != declared:
        raise DataError(
            f"File `{path}` declares {declared} sets of type 58, but {len(sets)} can be read.",
            remedy="Export it again, as UFF 58 with time records.",
        )
    nodes = [_node(found, f"{path.name}, set[{i}]") for i, found in enumerate(sets)]
    cells = np.empty(len(nodes), dtype=object)
    for i, node in enumerate(nodes):
        cells[i] = node
    titles = [str(found.get("id1", "")).strip() for found in sets]
    root: dict[str, Node] = {"set": cells}
    root |= {
        title: node
        for title, node in zip(titles, nodes, strict=True)
        if title and titles.count(title) == 1
    }
    yield Contents(root, "UFF 58")


def write_uff(
    path: str | Path,
    record: Record,
    *,
    names: Mapping[str, str] | None = None,
    binary: bool = False,
) -> None:
    """Write a record as UFF 58 time records, one set a channel, and read it again to compare.

    ASCII keeps twelve digits; both keep six of the sampling interval, which the reader snaps.

    Args:
        path: File to write; an existing one is replaced when the new one is whole.
        record: What to write, in SI.
        names: Role to the set's name; the role itself when absent.
        binary: Whether the samples are binary.

    Raises:
        DataError: A sample is NaN, which the format cannot hold, or the file reads back otherwise.
    """
    path, time = Path(path), np.arange(record.num_samples) / record.fs
    partial = path.with_name(f".{path.stem}.{os.getpid()}.uff")
    try:
        for role, samples in record.channels.items():
            if not np.isfinite(samples).all():
                raise DataError(
                    f"{record.name}: role `{role}` has samples that are not finite, which UFF "
                    "turns into 0.",
                    remedy="Write it as HDF5 with write_hdf5.",
                )
            name = (names or {}).get(role, role)
            fields = _fields(name, samples, time, record.units[role], binary)
            # Only this mode writes binary sets whole.
            _pyuff(path).UFF(str(partial)).write_sets(fields, mode="add")
        _same(partial, record)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def _fields(
    name: str, samples: np.ndarray, time: np.ndarray, unit: str, binary: bool
) -> dict[str, Any]:
    """Fields of a set of type 58 with every one that pyuff wants filled in."""
    return {
        "type": 58,
        "func_type": TIME_RESPONSE,
        "binary": int(binary),
        "id1": name,
        "rsp_node": 1,
        "rsp_dir": 1,
        "ref_node": 1,
        "ref_dir": 1,
        "abscissa_spacing": 1,
        "abscissa_axis_units_lab": "s",
        "ordinate_axis_units_lab": unit,
        "orddenom_spec_data_type": 0,
        "data": samples,
        "x": time,
    }


def _same(path: Path, record: Record) -> None:
    """Compare what was written with what was meant."""
    for found, (role, samples) in zip(_all_sets(path), record.channels.items(), strict=True):
        data = np.asarray(found["data"])
        # Eleven decimals of the mantissa.
        if data.shape != samples.shape or not np.allclose(data, samples, rtol=1e-11, atol=0):
            raise DataError(f"{record.name}: role `{role}` reads back otherwise than it was.")


def _all_sets(path: Path) -> list[Mapping[str, Any]]:
    found = _pyuff(path).UFF(str(path)).read_sets()
    return found if isinstance(found, list) else [found]


def _pyuff(path: Path) -> Any:
    try:
        return import_module("pyuff")
    except ImportError:
        raise DataError(
            f"File `{path.name}` needs the package pyuff.",
            remedy="Install it: pip install jbw[uff]",
        ) from None


def _node(found: Mapping[str, Any], where: str) -> Node:
    data = np.asarray(found["data"])
    if found.get("num_pts") not in (None, len(data)):
        raise DataError(
            f"{where} declares {found['num_pts']} samples, but has {len(data)}.",
            remedy="Copy the file again, or export it again.",
        )
    unit = str(found.get("ordinate_axis_units_lab", "")).strip()
    array = leaf(data, fs=_fs(found, where), unit="" if unit.upper() == "NONE" else unit)
    if found.get("func_type") != FREQUENCY_RESPONSE:
        return array
    return {
        "frequency": leaf(np.asarray(found["x"]), unit="Hz"),
        "response": replace(array, fs=None),
    }


def _fs(found: Mapping[str, Any], where: str) -> float | None:
    """Sampling frequency of a set in time: from its interval, or from its times if uneven."""
    if found.get("func_type") == FREQUENCY_RESPONSE:
        return None
    spacing = float(found.get("abscissa_inc") or 0.0)
    if spacing > 0:
        return 1 / spacing
    times = np.asarray(found["x"])
    return sampling_frequency(times, f"{where}, abscissa")[0] if len(times) > 1 else None
