"""What a run left behind, as the figures read it: groups, parameters, tests in order of level."""

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float

from jbw.errors import DataError


class Parameter(NamedTuple):
    """The draws of one parameter, with what is known of it.

    Args:
        name: Its name, with the index of an array's element.
        unit: Its unit as written in the file.
        draws: Draws of every chain.
        box: Prior interval (lower, upper), or None.
        truth: The value the rig was built with, or None.
    """

    name: str
    unit: str
    draws: Float[np.ndarray, "chain draw"]
    box: tuple[float, float] | None
    truth: float | None


def read_result(folder: Path) -> tuple[dict[str, Any], xr.DataTree]:
    """Read the summary and the posterior of a run's folder.

    Raises:
        DataError: If either file is missing or cannot be read.
    """
    summary_path, tree_path = folder / "summary.json", folder / "posterior.nc"
    for path in (summary_path, tree_path):
        if not path.is_file():
            raise DataError(
                f"The folder {folder} has no {path.name}, so there is nothing to report.",
                remedy="Give the folder of a finished run, or finish it: jbw resume DIR.",
            )
    try:
        summary = json.loads(summary_path.read_text(encoding="utf-8"))
        with xr.open_datatree(tree_path, engine="h5netcdf") as stored:
            tree = stored.load()
    except (OSError, ValueError) as cause:
        raise DataError(
            f"The result in {folder} cannot be read: {cause}",
            remedy="Run the identification again, or restore the folder from a copy.",
        ) from cause
    return summary, tree


def node(tree: xr.DataTree, path: str) -> xr.DataTree | None:
    """Return the node at `path`, or None where the run did not write it."""
    found: xr.DataTree | None = tree
    for part in path.strip("/").split("/"):
        found = None if found is None else found.children.get(part)
    return found


def branch(tree: xr.DataTree, path: str, *needed: str) -> xr.Dataset:
    """Return the group at `path` as a dataset that holds the variables `needed`.

    Raises:
        DataError: If the group or one of the variables is missing.
    """
    found = node(tree, path)
    if found is None:
        raise DataError(f"The result has no group /{path.strip('/')}.")
    missing = [name for name in needed if name not in found.data_vars]
    if missing:
        raise DataError(f"The group /{path.strip('/')} lacks {', '.join(missing)}.")
    return found.to_dataset()


def tests(tree: xr.DataTree, path: str, *needed: str) -> list[tuple[str, xr.Dataset]]:
    """Return the tests under `path` by name, in order of their level.

    Raises:
        DataError: If there is none, or one lacks a variable `needed`.
    """
    parent = node(tree, path)
    names = list(parent.children) if parent is not None else []
    if not names:
        raise DataError(f"The result has no test under /{path.strip('/')}.")
    found = [(name, branch(tree, f"{path}/{name}", *needed)) for name in names]
    return sorted(found, key=lambda test: float(test[1].attrs.get("level", 0.0)))


def parameters(group: xr.Dataset) -> list[Parameter]:
    """Return the parameters of a posterior group, an array element by element."""
    found = []
    for name, values in group.data_vars.items():
        rest = [dim for dim in values.dims if dim not in ("chain", "draw")]
        flat = np.asarray(values.transpose("chain", "draw", *rest), float)
        flat = flat.reshape(*flat.shape[:2], -1)
        for index in range(flat.shape[2]):
            labels = [_label(values, rest, index)] if rest else []
            truth, lower, upper = (
                _element(values.attrs.get(key), index) for key in ("truth", "lower", "upper")
            )
            found.append(
                Parameter(
                    "".join([str(name), *labels]),
                    str(values.attrs.get("units", "")),
                    flat[:, :, index],
                    None if lower is None or upper is None else (lower, upper),
                    truth,
                )
            )
    return found


def _label(values: xr.DataArray, rest: list[Any], index: int) -> str:
    """Return the coordinates of a flat index, as in [0.05]."""
    place = np.unravel_index(index, [values.sizes[dim] for dim in rest])
    marks = [
        values[dim].values[at] if dim in values.coords else at
        for dim, at in zip(rest, place, strict=True)
    ]
    texts = [str(mark) if isinstance(mark, str) else f"{mark:g}" for mark in marks]
    return f"[{', '.join(texts)}]"


def _element(value: Any, index: int) -> float | None:
    """Return one element of an attribute that is a number, an array or absent."""
    if value is None:
        return None
    flat = np.asarray(value, float).reshape(-1)
    return float(flat[index if flat.size > 1 else 0])


def parameter(tree: xr.DataTree, path: str, name: str) -> Parameter | None:
    """Return the parameter `name` of the posterior at `path`, or None where it is absent."""
    group = node(tree, path)
    if group is None:
        return None
    return next((each for each in parameters(group.to_dataset()) if each.name == name), None)


def frequency(test: xr.Dataset) -> Float[np.ndarray, " freq"]:
    """Return the frequency axis of a group [Hz]."""
    name = next((key for key in ("freq", "freq_hz") if key in test.coords), None)
    if name is None:
        raise DataError("A group of the result has no frequency axis.")
    return np.asarray(test[name].values, float)
