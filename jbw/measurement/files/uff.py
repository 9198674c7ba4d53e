"""UFF 58 through pyuff, an optional extra: read with every set counted, and written."""

import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from jbw.errors import ConfigError, DataError
from jbw.measurement.files.sampling import sampling_frequency
from jbw.measurement.files.tree import Contents, Leaf, Node, cells, leaf, load, names, optional
from jbw.measurement.records import Record

FREQUENCY_RESPONSE = 4  # function type of the format
SET_58 = re.compile(rb"^ {4}-1 *\r?\n *58[ b]", re.MULTILINE)


@contextmanager
def contents(path: Path) -> Iterator[Contents]:
    """Open a universal file as `set[0]`, `set[1]`, ..., and by their names where unique."""
    declared = len(SET_58.findall(path.read_bytes()))
    found = optional("pyuff", "uff", path).UFF(str(path)).read_sets()
    every = found if isinstance(found, list) else [found]
    sets = [one for one in every if one.get("type") == 58]
    if not sets or len(sets) != declared:
        raise DataError(
            f"File `{path}` declares {declared} sets of type 58, but {len(sets)} can be read.",
            remedy="Export it again, as UFF 58 with time records.",
        )
    nodes = [_node(one, f"{path.name}, set[{i}]") for i, one in enumerate(sets)]
    titles = [str(one.get("id1", "")).strip() for one in sets]
    root: dict[str, Node] = {"set": cells(nodes, (len(nodes),))}
    root |= {
        title: node
        for title, node in zip(titles, nodes, strict=True)
        if title and titles.count(title) == 1
    }
    yield Contents(root, "UFF 58")


def _node(found: Mapping[str, Any], where: str) -> Node:
    data = np.asarray(found["data"])
    if found.get("num_pts") not in (None, len(data)):
        raise DataError(
            f"{where} declares {found['num_pts']} samples, but has {len(data)}.",
            remedy="Copy the file again, or export it again.",
        )
    unit = str(found.get("ordinate_axis_units_lab", "")).strip()
    unit = "" if unit.upper() == "NONE" else unit
    if found.get("func_type") == FREQUENCY_RESPONSE:
        return {
            "frequency": leaf(np.asarray(found["x"]), unit="Hz"),
            "response": leaf(data, unit=unit),
        }
    spacing, fs = float(found.get("abscissa_inc") or 0.0), None
    if spacing > 0:
        fs = 1 / spacing
    elif len(found["x"]) > 1:  # uneven
        fs, _ = sampling_frequency(np.asarray(found["x"]), f"{where}, abscissa")
    return leaf(data, fs=fs, unit=unit)


def write_uff(path: str | Path, record: Record) -> None:
    """Write the channels of a record in time as UFF 58, a double-precision set each, in SI.

    The sets are named by the channels' roles, so that `jbw.read` takes them by these; the file is
    read again before it gets its name. The format says the sampling interval in five digits.

    Args:
        path: A new file, ending in .uff or .unv.
        record: A record in time, all of whose samples are finite.

    Raises:
        DataError: A response curve, a sample that is not finite, or a file that reads otherwise.
        ConfigError: The file exists, cannot be written, or has another ending.
    """
    path = Path(path)
    if np.isnan(record.fs):
        raise DataError(
            f"{record.name or 'The record'}: UFF is written of time series, but this is a response "
            "curve.",
            remedy="Write its columns as CSV.",
        )
    for role, samples in record.channels.items():
        if not np.all(np.isfinite(samples)):
            raise DataError(
                f"Channel `{role}` must be finite, but {np.sum(~np.isfinite(samples))} of its "
                f"{len(samples)} samples are not.",
                why="UFF would hold zeros in their place.",
                remedy="Cut the record to what is finite.",
            )
    if path.suffix.lower() not in (".uff", ".unv"):
        raise ConfigError(
            f"Argument `path` must end in .uff or .unv, but is {path.name}.",
            remedy="jbw.read tells formats by the ending.",
        )
    if path.exists():
        raise ConfigError(f"File `{path}` exists.", remedy="Choose another name, or remove it.")
    part = path.with_name(f"{path.stem}.part{path.suffix}")
    try:
        part.write_bytes(b"")  # pyuff would say less of what it cannot open
        # Only this mode writes sets whole.
        writer = optional("pyuff", "uff", path).UFF(str(part))
        writer.write_sets([_set_of(record, role) for role in record.channels], mode="add")
        _require_same(part, record)
        os.replace(part, path)
    except OSError as error:
        raise ConfigError(
            f"File `{path}` cannot be written: {error.strerror or error}.",
            remedy="Choose another folder.",
        ) from error
    finally:
        part.unlink(missing_ok=True)


def _set_of(record: Record, role: str) -> dict[str, Any]:
    samples = np.asarray(record.channels[role], float)
    return {
        "type": 58, "func_type": 1, "binary": 0, "id1": role, "id2": record.name or "NONE",
        "rsp_node": 1, "rsp_dir": 1, "ref_node": 1, "ref_dir": 1, "ord_data_type": 4,
        "abscissa_spacing": 1, "abscissa_min": 0.0, "abscissa_inc": 1 / record.fs,
        "abscissa_axis_units_lab": "s", "ordinate_axis_units_lab": record.units[role],
        "orddenom_spec_data_type": 0, "num_pts": len(samples), "data": samples,
        "x": np.arange(len(samples)) / record.fs,
    }  # fmt: skip


def _require_same(path: Path, record: Record) -> None:
    """Refuse a file that does not hold what was written; of five digits the sampling interval."""
    with contents(path) as found:
        leaves = dict(names(found.root))
        for role, samples in record.channels.items():
            own = leaves.get(role)
            if not (
                isinstance(own, Leaf)
                and own.shape == np.shape(samples)
                and np.allclose(load(own), samples, rtol=1e-10, atol=0.0)
            ):
                raise DataError(
                    f"Channel `{role}` of {path} does not read as it was written.",
                    remedy="Write HDF5 or NumPy instead.",
                )
