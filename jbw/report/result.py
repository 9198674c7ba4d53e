"""Access of figures and tables to a run's result: groups, names, parameters, tests."""

import json
import shlex
from collections.abc import Iterable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float
from pydantic import ValidationError

from jbw.errors import DataError, reason_of
from jbw.quantities import BY_NAME, GAINS, Quantity, in_dialect, natural
from jbw.report.text import about, plain, quantity, symbol, unit_text
from jbw.results.attributes import DrawnPosterior, PredictedTest, StoredVariable
from jbw.results.run import RunSummary
from jbw.run.integrity import MARK, SEAL, damaged, unsealed
from jbw.run.netcdf import read_tree

TURN = 360.0  # one full turn [degrees]
BACKBONE = "verification/backbone"
FREE_LAW = "free_law"
# Names of groups that contain draws, anywhere in the tree.
DRAWN = ("posterior", "as_recorded", "runs")
HELD_OUT = "held out"  # attribute value of a test that no fit uses


class PosteriorParameter(NamedTuple):
    """The draws of one parameter or array element, its prior bounds, and the rig's true value."""

    name: str
    symbol: str
    unit: str
    meaning: str
    draws: Float[np.ndarray, "chain draw"]
    box: tuple[float, float] | None
    truth: float | None


def read_result(folder: Path, *groups: str) -> tuple[RunSummary, xr.DataTree]:
    """Read the summary and the posterior in a run's folder; raise a DataError if this fails.

    Only `groups` below the root of the posterior's file are read; all groups if none is given.
    """
    for name in ("summary.json", "posterior.nc"):
        if not (folder / name).is_file():
            raise _unfinished(folder, name)
    try:
        record = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
        if not isinstance(record, Mapping):
            raise ValueError("summary.json contains no table")
        has_hashes = SEAL in record
        summary = _typed(folder, unsealed(record, folder / "posterior.nc"))
        tree = read_tree(folder / "posterior.nc", *groups)
        if tree.attrs.pop(MARK, None) is not None and not has_hashes:
            raise damaged(folder / "summary.json")
    except DataError as error:
        # The run was killed after its final posterior had replaced the first posterior, but before
        # its final summary had replaced the first summary.
        if _is_unfinished(folder):
            raise _completed_by_resume(folder, error.what) from None
        raise
    # The error lies in this process: the result may be undamaged.
    except (ImportError, MemoryError):
        raise
    except Exception as cause:  # For damaged files, JSON and HDF5 may raise any exception.
        raise DataError(
            f"The result in {folder} is damaged and cannot be read: {reason_of(cause)}",
            remedy="Run the identification again, or restore the folder from a copy.",
        ) from cause
    require_finite(tree, folder / "posterior.nc")
    return summary, tree


def _typed(folder: Path, record: Mapping[str, Any]) -> RunSummary:
    """Return the content of `summary.json` as typed objects; an error names its version."""
    try:
        return RunSummary.read(record)
    except ValidationError as cause:
        first = cause.errors()[0]
        place = ".".join(map(str, first["loc"]))
        versions = record.get("versions") or {}
        raise of_another_version(folder, versions, f"{place}: {first['msg']}") from cause


def of_another_version(folder: Path, versions: Mapping[str, str], what: str) -> DataError:
    """Return the error for a run that cannot be read, naming the version of jbw that made it."""
    writer = versions.get("jbw", "unknown") if isinstance(versions, Mapping) else "unknown"
    return DataError(
        f"The run in {folder} cannot be read: {what}",
        why=f"The run was made by version {writer} of jbw; this is version {version('jbw')}.",
        remedy=f"Read the run with version {writer} of jbw, or identify again: jbw identify "
        "CAMPAIGN.toml.",
    )


def require_finite(tree: xr.DataTree, path: Path) -> None:
    """Raise an error if a posterior draw of a result is not finite.

    Raises:
        DataError: A variable of a posterior, or of the runs' parameters, has such draws.
    """
    for group in tree.subtree:
        for name, values in group.data_vars.items() if group.name in DRAWN else ():
            numbers = np.asarray(values.values)
            if numbers.dtype.kind == "f" and (lost := np.count_nonzero(~np.isfinite(numbers))):
                raise DataError(
                    f"The draws of {name} in {path} must be finite numbers, but {lost} of "
                    f"{numbers.size} are not.",
                    why="No quantity computed from these draws is reliable.",
                    remedy="Restore the folder from a copy, or identify again: jbw identify "
                    "CAMPAIGN.toml.",
                )


def _is_unfinished(folder: Path) -> bool:
    return (folder / ".run" / "manifest.json").is_file()


def _completed_by_resume(folder: Path, what: str) -> DataError:
    return DataError(
        what,
        why="The run failed or was interrupted.",
        remedy=f"Finish the run: jbw resume {shlex.quote(str(folder))}",
    )


def _unfinished(folder: Path, name: str) -> DataError:
    """Return the error for a folder that lacks a file of a result, with its remedy."""
    what = f"The folder {folder} has no {name}, so there is nothing to report."
    if _is_unfinished(folder):
        return _completed_by_resume(folder, what)
    return DataError(
        what,
        remedy="Give the folder of a finished run: jbw identify CAMPAIGN.toml --out DIR makes one.",
    )


def node(tree: xr.DataTree, path: str) -> xr.DataTree | None:
    """Return the node of a result tree at `path`, or None if it does not exist."""
    group: xr.DataTree | None = tree
    for part in path.strip("/").split("/"):
        group = None if group is None else group.children.get(part)
    return group


def branch(tree: xr.DataTree, path: str, *needed: str) -> xr.Dataset:
    """Return the group of a result at `path` as a dataset; raise a DataError if it is missing."""
    group = node(tree, path)
    if group is None:
        raise DataError(
            f"The result has no group /{path.strip('/')}.",
            remedy="Choose a figure or table for which the run has results.",
        )
    if missing := [name for name in needed if name not in group.data_vars]:
        raise DataError(
            f"The group /{path.strip('/')} of the result lacks {', '.join(missing)}.",
            remedy="Identify the campaign again with this version of jbw and with all steps.",
        )
    return group.to_dataset()


def tests(tree: xr.DataTree, path: str, *needed: str) -> list[tuple[str, xr.Dataset]]:
    """Return the tests of a result below `path`, by level; raise a DataError if there are none."""
    parent = node(tree, path)
    if parent is None or not parent.children:
        raise DataError(
            f"The result has no test under /{path.strip('/')}.",
            remedy="Choose a figure or table for which the run has results.",
        )
    groups = [(name, branch(tree, f"{path}/{name}", *needed)) for name in parent.children]
    levels = {name: about(PredictedTest.of(test).level) for name, test in groups}
    return sorted(groups, key=lambda test: (levels[test[0]], natural(test[0])))


def verified(tree: xr.DataTree, attribute: str) -> list[tuple[str, str, xr.Dataset]]:
    """Return the group, name and bands of each predicted test that has the given attribute."""
    verification = node(tree, "verification")
    return [
        (group, name, test.to_dataset())
        for group, parent in (verification.children if verification is not None else {}).items()
        for name, test in parent.children.items()
        if attribute in test.attrs
    ]


def names_of(tree: xr.DataTree, summary: RunSummary | None = None) -> dict[str, Quantity]:
    """Return symbol, unit and meaning of each parameter of a run, by name."""
    # Entries that a run of jbw 0.1 lacks come from the present tables; a summary may have steps
    # that the tree lacks.
    quantities = {}
    for group in tree.subtree:
        for name, values in group.data_vars.items() if group.name == "posterior" else ():
            stored = StoredVariable.of(values)
            today = None if stored.symbol else quantity(str(name))
            quantities[str(name)] = Quantity(
                str(name),
                stored.symbol if today is None else today.symbol,
                unit_of(values),
                stored.long_name if today is None else today.meaning or stored.long_name,
            )
    for step in () if summary is None else summary.steps.values():
        for name in step.parameters:
            stem = name.partition("[")[0]
            quantities[stem] = quantity(stem, quantities)
    return quantities


def parameters(group: xr.Dataset) -> list[PosteriorParameter]:
    """Return the parameters of a posterior group, with each element of an array separately."""
    sampled = []
    quantities = names_of(xr.DataTree.from_dict({"/posterior": group}))
    for name, values in group.data_vars.items():
        rest = [dim for dim in values.dims if dim not in ("chain", "draw")]
        for index, place in enumerate(np.ndindex(*(values.sizes[dim] for dim in rest))):
            single = values.isel(dict(zip(rest, place, strict=True)))
            # A label such as `x[0.05]` states the coordinates of an array's element; the label of a
            # scalar has none.
            marks = [
                single[d].item() if d in single.coords else at
                for d, at in zip(rest, place, strict=True)
            ]
            texts = [mark if isinstance(mark, str) else f"{mark:g}" for mark in marks]
            label = f"{name}[{', '.join(texts)}]" if texts else str(name)
            truth, lower, upper = (
                _element(values.attrs.get(key), index) for key in ("truth", "lower", "upper")
            )
            box = None if lower is None or upper is None else (lower, upper)
            unit, meaning = quantities[str(name)].unit, quantities[str(name)].meaning
            draws = np.asarray(single.transpose("chain", "draw"), float)
            sampled.append(
                PosteriorParameter(
                    label, symbol(label, quantities), unit, meaning, draws, box, truth
                )
            )
    return sampled


def _element(value: Any, index: int) -> float | None:
    if value is None:
        return None
    flat = np.ravel(value)
    return float(flat[index if flat.size > 1 else 0])


def of_joint(group: xr.Dataset) -> list[PosteriorParameter]:
    """Return the parameters of oscillator and laws, without gains, noise and products."""
    # The symbol of a product contains spaces.
    return [
        parameter
        for parameter in parameters(group)
        if parameter.name not in GAINS and " " not in parameter.symbol
    ]


def of_law(joint: Iterable[PosteriorParameter]) -> list[PosteriorParameter]:
    """Return the joint's parameters that belong to its laws."""
    return [parameter for parameter in joint if parameter.name not in BY_NAME]


def laws_of(tree: xr.DataTree) -> tuple[str, ...]:
    """Return the names of the joint's laws; in runs of jbw 0.1, Bouc-Wen and a cubic spring."""
    if (laws := DrawnPosterior.of(tree).laws) is not None:
        return laws
    main = node(tree, "posterior")
    return ("bouc_wen", "cubic") if main is not None and "cubic" in main else ("bouc_wen",)


def frequency(test: xr.Dataset) -> Float[np.ndarray, " freq"]:
    """Return the frequency axis of a group [Hz]."""
    for name in ("freq", "freq_hz"):
        if name in test.coords:
            return np.asarray(test[name].values, float)
    raise DataError("A group of the result must have a coordinate `freq` or `freq_hz`.")


def unit_of(values: xr.DataArray) -> str:
    """Return the unit of a variable in the present spelling of jbw."""
    return in_dialect(StoredVariable.of(values).units)


def arrays(group: xr.Dataset, *names: str) -> list[Float[np.ndarray, "..."]]:
    """Return variables of a group as arrays of numbers, in the order of their names."""
    return [np.asarray(group[name], float) for name in names]


def quantiles(group: xr.Dataset, name: str) -> Float[np.ndarray, "quantile ..."]:
    """Return lower end, median and upper end of a variable's band, along the first axis."""
    return np.asarray(group[name].transpose("quantile", ...), float)


def level_text(test: xr.Dataset) -> str:
    """Return a test's level with its unit, as text."""
    facts = PredictedTest.of(test)
    level = float("nan") if facts.level is None else facts.level
    return f"{level:g} {plain(unit_text(facts.level_unit))}".strip()


def fitted_text(test: xr.Dataset) -> str:
    """Return whether a test was fitted or held out; an empty text if the run does not state it.

    If some repeats were fitted and others are shown, the text says so.
    """
    facts = PredictedTest.of(test)
    if facts.fitted is None:
        return ""
    if not facts.fitted:
        return HELD_OUT
    return "fitted" if facts.seen else "fitted, held-out repeats"


def wrap_degrees(phase: Any) -> Any:
    """Return phases [rad] in degrees within [-270, 90), so that a receptance does not jump."""
    return (np.degrees(phase) + 270.0) % TURN - 270.0


def wrap_band(phase: Any) -> Float[np.ndarray, "quantile freq"]:
    """Return a phase band [rad] in degrees, shifted by full turns so that its median is wrapped."""
    degrees = np.degrees(phase)
    return degrees + (wrap_degrees(np.asarray(phase)[1]) - degrees[1])


def unwrapped_band(phase: Any) -> Float[np.ndarray, "quantile freq"]:
    """Convert a phase band from radians to degrees with a continuous median near zero."""
    # The phase of a velocity then runs from 90 to -90 degrees, that of a force from 0 to 180.
    degrees = np.degrees(phase)
    middle = np.unwrap(degrees[1], period=TURN)
    centre = 0.5 * (np.nanmax(middle) + np.nanmin(middle))
    return degrees - degrees[1] + middle - TURN * np.round(centre / TURN)


def near_branch(phase: Any, degrees: Float[np.ndarray, " freq"]) -> Float[np.ndarray, "... freq"]:
    """Convert phases from radians to degrees, each within half a turn of the curve `degrees`."""
    away = np.degrees(phase) - degrees
    return degrees + (away + TURN / 2) % TURN - TURN / 2
