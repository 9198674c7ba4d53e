"""UFF 58 files, read and written by the optional package pyuff; sets are numbered from zero."""

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from jbw.errors import ConfigError, DataError
from jbw.measurement.files.clocks import sampling_frequency
from jbw.measurement.files.tree import Contents, Leaf, Node, cells, leaf, load, names, optional
from jbw.measurement.records import Record
from jbw.units import FACTORS, measured, plain

# the quantity for each specific data type of the format
SPECIFIC = {8: "displacement", 9: "force", 11: "velocity", 12: "acceleration", 13: "force"}
BEHIND = {"displacement": "", "force": "", "velocity": "/s", "acceleration": "/s^2"}
SYSTEMS = {
    1: {"length": "m", "force": "N"}, 2: {"length": "ft", "force": "lbf"},
    3: {"length": "m", "force": "kgf"}, 5: {"length": "mm", "force": "mN"},
    7: {"length": "in", "force": "lbf"}, 8: {"length": "mm", "force": "kgf"},
    10: {"length": "mm", "force": "N"},
}  # fmt: skip
SAME_FACTOR = 1e-5  # largest relative error of a unit's factor, because files round it
MOST_PADDED = 5  # largest number of values that pad the last line of a set
FREQUENCY_RESPONSE = 4  # function type of data sets that contain an FRF
# the header of a data set
SET = re.compile(rb"^ {4}-1[ \t]*\r?\n[ \t]*(\d+)b?(?=\s)", re.MULTILINE)
TAKEN = (58, 151, 164)  # types of data sets that are read: functions, program, units


@contextmanager
def contents(path: Path) -> Iterator[Contents]:
    """Open a universal file as `set[0]`, `set[1]`, ..., and by names if these are unique."""
    declared = [int(number) for number in SET.findall(path.read_bytes())]
    if declared and 58 not in declared:
        others = ", ".join(map(str, sorted(set(declared))))
        raise DataError(
            f"File `{path}` contains no data set of type 58 (time records, FRFs): all data sets "
            f"are of type {others}.",
            remedy="Export the time records or FRFs as UFF 58.",
        )
    library = optional("pyuff", "uff", path).UFF(str(path))
    taken = [i for i, number in enumerate(library.get_set_types()) if int(number) in TAKEN]
    read_sets = library.read_sets(taken) if taken else []
    every = read_sets if isinstance(read_sets, list) else [read_sets]
    sets = [dataset for dataset in every if dataset.get("type") == 58]
    if not sets or len(sets) != declared.count(58):
        raise DataError(
            f"File `{path}` declares {declared.count(58)} sets of type 58, but {len(sets)} can be "
            "read.",
            remedy="Export the file again, as UFF 58 with time records.",
        )
    system = next((dataset for dataset in every if dataset.get("type") == 164), {})
    nodes = [_node(dataset, f"{path.name}, set[{i}]", system) for i, dataset in enumerate(sets)]
    titles = _titles(sets)
    root: dict[str, Node] = {"set": cells(nodes, (len(nodes),))}
    unique = {
        title: node
        for title, node in zip(titles, nodes, strict=True)
        if title and titles.count(title) == 1
    }
    series: dict[str, Leaf] = {}
    for i, (title, node) in enumerate(zip(titles, nodes, strict=True)):
        path_of = title if title in unique else f"set[{i}]"
        series |= dict(names_of(node, path_of))
    notes = {} if not system else {"units of set 164": str(system.get("units_code", ""))}
    program = next((dataset for dataset in every if dataset.get("type") == 151), {})
    facts = {"program": str(program.get("prog_name") or program.get("model_name") or "").strip()}
    yield Contents(root | unique, "UFF 58", notes=notes, series=series, attributes=facts)


def names_of(node: Node, path: str) -> Iterator[tuple[str, Leaf]]:
    """Yield the arrays of a set with their paths."""
    for name, item in names(node):
        if isinstance(item, Leaf):
            yield (f"{path}.{name}" if name else path), item


def _stated(dataset: Mapping[str, Any], key: str) -> str:
    """Return a text field of a data set; empty if it contains NONE."""
    # pyuff replaces bytes that are not UTF-8; after an `s` such a byte was a Latin-1 superscript
    # two.
    text = re.sub("(?<=s)\ufffd", "^2", str(dataset.get(key, "")).strip())
    return "" if text.upper() == "NONE" else text


def _number(dataset: Mapping[str, Any], key: str) -> float:
    """Return a number of a data set; 0 if it is missing."""
    return float(dataset.get(key) or 0.0)


def _titles(sets: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return names of the datasets: the first ID line of each or, if these are equal, the label."""
    firsts = [_stated(dataset, "id1") for dataset in sets]
    labels = [_stated(dataset, "ordinate_axis_lab") for dataset in sets]
    first_lines_differ = len(set(firsts)) > 1 or len(sets) == 1
    return firsts if first_lines_differ and all(firsts) else labels


def _node(dataset: Mapping[str, Any], where: str, system: Mapping[str, Any]) -> Node:
    data, declared = np.asarray(dataset["data"]), dataset.get("num_pts")
    x = np.asarray(dataset["x"])
    if declared is not None and declared < len(data) <= declared + MOST_PADDED:
        if not np.any(data[declared:]):  # Zeros pad the last line.
            data, x = data[:declared], x[:declared]
    if declared not in (None, len(data)):
        raise DataError(
            f"{where} declares {declared} samples, but has {len(data)}.",
            remedy="Copy or export the file again.",
        )
    quantity = SPECIFIC.get(int(_number(dataset, "ordinate_spec_data_type")), "")
    unit = _unit_of(dataset, "ordinate", quantity, system)
    label = _stated(dataset, "ordinate_axis_lab")
    label = f"{quantity} {label}".strip() if quantity else label
    if dataset.get("func_type") == FREQUENCY_RESPONSE:
        per = SPECIFIC.get(int(_number(dataset, "orddenom_spec_data_type")), "")
        below = _unit_of(dataset, "orddenom", per, system)
        if unit and below and "/" + plain(below) not in plain(unit) and not _is_ratio(unit):
            unit = f"({unit})/{below}"
        return {
            "frequency": replace(leaf(x, unit="Hz"), label="frequency"),
            "response": replace(leaf(data, unit=unit), label=label),
        }
    spacing, fs = _number(dataset, "abscissa_inc"), None
    if spacing > 0:
        fs = 1 / spacing
    elif len(x) > 1:  # The file states the times instead of their spacing.
        fs, _ = sampling_frequency(x, f"{where}, abscissa")
    start = _number(dataset, "abscissa_min")
    return replace(leaf(data, fs=fs, unit=unit, start_s=start), label=label)


def _is_ratio(unit: str) -> bool:
    """Return whether a unit is that of a response per force, such as `m/s^2/N` or `1/kg`."""
    of_unit = measured(plain(unit))
    return of_unit is not None and of_unit[1][1] < 0


def _unit_of(
    dataset: Mapping[str, Any], axis: str, quantity: str, system: Mapping[str, Any]
) -> str:
    """Return an axis's unit in a universal file from its label, or from its quantity and set 164.

    Numbers of the file are SI numbers times the factors of set 164. The unit is empty if a factor
    contradicts the code of the unit system.
    """
    unit = _stated(dataset, f"{axis}_axis_units_lab")
    if unit or not quantity or not system:
        return unit
    which = "force" if quantity == "force" else "length"
    factor = _number(system, which)
    table = FACTORS["force" if which == "force" else "displacement"]
    base = next((n for n, si in table.items() if abs(si * factor - 1) < SAME_FACTOR), "")
    of_code = SYSTEMS.get(int(_number(system, "units_code")), {}).get(which, base)
    return base + BEHIND.get(quantity, "") if base and base == of_code else ""


def write_uff(path: str | Path, record: Record) -> None:
    """Write a time record's channels as UFF 58 in SI, one double-precision set per channel.

    The sets are named by the roles of the channels, so that `jbw.read` finds them. The file is read
    back before it gets its name. The format stores the sampling interval with five digits.

    Args:
        path: Path of the new file, ending in .uff or .unv.
        record: A time record whose samples are all finite.

    Raises:
        DataError: The record is a response curve, has a sample that is not finite, or does not
            read back as it was written.
        ConfigError: The file exists, cannot be written, or has another ending.

    Examples:
        A file is read by the roles of its channels:

        >>> import jbw
        >>> import numpy as np
        >>> v = 0.02 * np.cos(118.0 * np.arange(2048) / 512.0)
        >>> jbw.write_uff("hit_1.uff", jbw.Record(512.0, {"velocity": v}, {"velocity": "m/s"}))
        >>> (record,) = jbw.read("hit_1.uff")
        >>> print(record.fs, record.channels["velocity"][0], record.units["velocity"])
        512.0 0.02 m/s
    """
    path = Path(path)
    if np.isnan(record.fs):
        raise DataError(
            f"{record.name or 'The record'}: only time series can be written as UFF, but this "
            "record "
            "is a response curve.",
            remedy="Write the columns of the curve as CSV.",
        )
    for role, samples in record.channels.items():
        if not np.all(np.isfinite(samples)):
            raise DataError(
                f"Channel `{role}` must be finite, but {np.sum(~np.isfinite(samples))} of its "
                f"{len(samples)} samples are not.",
                why="The UFF file would contain zeros in place of samples that are not finite.",
                remedy="Cut the record to a part in which all samples are finite.",
            )
    if path.suffix.lower() not in (".uff", ".unv"):
        raise ConfigError(
            f"Argument `path` must end in .uff or .unv, but is {path.name}.",
            remedy="jbw.read recognises formats by the ending of the file name.",
        )
    if path.exists():
        raise ConfigError(
            f"File `{path}` exists already.", remedy="Choose another name, or remove this file."
        )
    part = path.with_name(f"{path.stem}.part{path.suffix}")
    try:
        part.write_bytes(b"")  # gives a clearer error than pyuff if the file cannot be created
        # pyuff writes complete data sets only with mode="add".
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
    """Raise a DataError if a file that was written does not contain the record's samples."""
    with contents(path) as written:
        leaves = dict(names(written.root))
        for role, samples in record.channels.items():
            channel = leaves.get(role)
            if not (
                isinstance(channel, Leaf)
                and channel.shape == np.shape(samples)
                and np.allclose(load(channel), samples, rtol=1e-10, atol=0.0)
            ):
                raise DataError(
                    f"Channel `{role}` was not written correctly: {path} contains other samples.",
                    remedy="Write the record as HDF5 or NumPy.",
                )
