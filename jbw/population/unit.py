"""One run as a unit of a fleet: its draws of the joint in SI, and the checks that units agree."""

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from jbw.errors import DataError
from jbw.inference.posterior.summary import posterior_draws
from jbw.observables.observable import OFFSETS
from jbw.oscillator.laws import laws_named, quantities_of
from jbw.quantities import OSCILLATOR, RESIDUAL_TERMS, Quantity, are_at_joints
from jbw.report.result import laws_of, read_result, unit_of
from jbw.results.attributes import DrawnPosterior, StoredVariable
from jbw.results.run import RunSummary
from jbw.study.study import Study
from jbw.verification.predicted import noise_by_label

GAIN = "gain"  # name of the source's gain, which is not a property of the joint
NOISE = "noise"
# first words of the names of those attributes that predictions need
STARTS = ("tests", "substeps", "scatter")
# largest number of parent folders in a unit's name, if its folder's name is not unique
DEEPEST = 3
# names of a fleet's own variables, which no unit may have as its name
TAKEN = set(
    "torque sequence temperature assembly verdict sampling num_draws ess mean covariance lower "
    "upper beyond run_scatter unit parameter other".split()
)


class Unit(NamedTuple):
    """One run as a unit of a fleet."""

    name: str
    laws: tuple[str, ...]
    # draws of each quantity, in the unit of the quantity; the draws of all chains are in one row
    draws: Mapping[str, NDArray[np.float64]]
    quantities: Mapping[str, Quantity]  # unit, symbol and meaning of each quantity
    # lower and upper bound of the uniform prior of each sampled parameter
    bounds: Mapping[str, tuple[float, float]]
    # standard deviation between runs within the unit, relative to the mean
    scatter: Mapping[str, float]
    summary: RunSummary
    # Campaign, folder, source, largest fitted displacement y_peak [m], settings of predictions.
    origin: Mapping[str, Any]
    # draws of the source's gain, or its known value; None if unknown
    gain: NDArray[np.float64] | None
    noise: Mapping[str, float]  # noise of every data group, by the group's label
    # draws of the residual terms, which represent other modes
    terms: Mapping[str, NDArray[np.float64]]

    @property
    def ess(self) -> float:
        """The smallest effective number of draws among the parameters of the main posterior."""
        return min(self.summary.main_step.known("ess_bulk"), default=np.nan)


def units_of(runs: Sequence[Study | str | Path]) -> list[Unit]:
    """Return every run as a unit; its unique name comes from its folder."""
    folders = [None if isinstance(run, Study) else Path(run).resolve() for run in runs]
    for folder in folders:
        if folder is not None and folders.count(folder) > 1:
            raise DataError(f"The run {folder} is given twice.", remedy="Give each run once.")
    read = [
        (run.result, run.tree) if isinstance(run, Study) else read_result(Path(run)) for run in runs
    ]
    names = _names(folders, [summary.campaign for summary, _ in read])
    return [
        _unit(name, folder, summary, tree)
        for name, folder, (summary, tree) in zip(names, folders, read, strict=True)
    ]


def _names(folders: Sequence[Path | None], campaigns: Sequence[str]) -> list[str]:
    """Return a unique name for each run, from its folder and parent folders, or its campaign."""
    names: list[str] = []
    for depth in range(1, DEEPEST + 1):
        names = [
            campaign if folder is None else "_".join(folder.parts[-depth:])
            for folder, campaign in zip(folders, campaigns, strict=True)
        ]
        if len(set(names)) == len(names):
            break
    for name, count in Counter(names).items():
        if count > 1:
            raise DataError(
                f"{count} runs have the name `{name}`.",
                why="A unit is identified by the name of its run.",
                remedy="Give the folders, or the campaigns of runs in memory, different names.",
            )
    clean = [name.replace("/", "_") for name in names]
    return [f"{name}_run" if name in TAKEN else name for name in clean]


def _unit(name: str, folder: Path | None, summary: RunSummary, tree: xr.DataTree) -> Unit:
    if "posterior" not in tree.children:
        raise DataError(
            f"The run {name} has no posterior.",
            remedy=f"Identify the campaign of {name} again: jbw identify CAMPAIGN.",
        )
    posterior, laws = posterior_draws(tree), laws_of(tree)
    if are_at_joints(laws):
        raise DataError(
            f"The run {name} must be of one joint, but has several.",
            why="A population compares units that have one joint each.",
            remedy="Leave the run out. To compare two runs joint by joint: jbw diff.",
        )
    draws, quantities = _quantities(posterior, laws)
    for quantity, values in draws.items():
        if not np.all(np.isfinite(values)):
            raise DataError(
                f"The run {name} has draws of {quantity} that are not finite.",
                remedy=f"Identify the campaign of {name} again, or leave the run out.",
            )
    attrs = {n: posterior[n].attrs for n in draws if n in posterior}
    for quantity, meaning in attrs.items():
        if "prior" in meaning:
            raise DataError(
                f"The run {name} has the prior {meaning['prior']} of {quantity}.",
                why="A population removes the priors of its runs, which is possible only for "
                "uniform priors.",
                remedy=f"Identify the campaign of {name} with bounds for `{quantity}` in "
                "[identify.prior].",
            )
    stated_bounds = {n: StoredVariable.of(posterior[n]).bounds for n in attrs}
    bounds = {n: pair for n, pair in stated_bounds.items() if pair is not None}
    stored = DrawnPosterior.of(tree)
    scatter = {n: s / float(draws[n].mean()) for n, s in zip(OFFSETS, stored.scatter, strict=False)}
    origin = {
        "campaign": summary.campaign,
        "folder": str(folder or ""),
        "source": summary.campaign_file or "",
        "y_peak": float("nan") if stored.y_peak is None else stored.y_peak,
        **{name: tree.attrs[name] for name in STARTS if name in tree.attrs},
    }
    return Unit(
        name, laws, draws, quantities, bounds, scatter, summary, origin,
        _gain(draws, stored.held), noise_by_label(posterior),
        {term.name: np.ravel(posterior[term.name].values) for term in RESIDUAL_TERMS
         if term.name in posterior},
    )  # fmt: skip


def _gain(
    draws: Mapping[str, NDArray[np.float64]], held: Mapping[str, float]
) -> NDArray[np.float64] | None:
    if GAIN in draws:
        return draws[GAIN]
    first = next(iter(draws.values()))
    return np.full(len(first), held[GAIN]) if GAIN in held else None


def _quantities(
    posterior: xr.Dataset, laws: Sequence[str]
) -> tuple[dict[str, NDArray[np.float64]], dict[str, Quantity]]:
    """Return draws and descriptions of a run's parameters, products and other coordinates."""
    by_name = {quantity.name: quantity for quantity in (*OSCILLATOR, *quantities_of(laws))}
    # The gain comes last, because it belongs to the source and not to the joint.
    by_name[GAIN] = by_name.pop(GAIN)
    present = [name for name in by_name if name in posterior]
    draws = {name: np.ravel(posterior[name].values).astype(float) for name in present}
    quantities = {
        name: by_name[name]._replace(unit=unit_of(posterior[name]) or by_name[name].unit)
        for name in present
    }
    for law in laws_named(laws):
        others = (
            monomial for coordinate in law.coordinates.values() for monomial in coordinate.inverse
        )
        for monomial in (*law.products, *others):
            if monomial.name not in draws and monomial.powers.keys() <= draws.keys():
                draws[monomial.name] = np.asarray(monomial.of(draws))
                quantities[monomial.name] = monomial.quantity
    return draws, quantities


def require_alike(units: Sequence[Unit], *, mixed_versions: bool) -> None:
    """Raise an error if runs differ in laws, units or versions, or if two runs share records."""
    for first, second in pairwise(units):
        pair = f"The runs {first.name} and {second.name}"
        if first.laws != second.laws:
            raise DataError(
                f"{pair} have different laws of the joint: {_laws(first)}, and {_laws(second)}.",
                why="The parameters of different laws are different quantities.",
                remedy="Identify all units with the same [joint] laws, or collect the runs of each "
                "law separately.",
            )
        for name in first.quantities.keys() & second.quantities.keys():
            was, is_ = first.quantities[name].unit, second.quantities[name].unit
            if was != is_:
                raise DataError(
                    f"{pair} have {name} in different units: {was}, and {is_}.",
                    why="Values in different units cannot be compared.",
                    remedy="Use the same unit of the source in both runs, or collect the two runs "
                    "separately.",
                )
        versions = first.summary.versions, second.summary.versions
        packages = versions[0].keys() | versions[1].keys()
        for name in () if mixed_versions else sorted(packages):
            was, is_ = (of_run.get(name, "unknown") for of_run in versions)
            if was != is_:
                raise DataError(
                    f"{pair} were made with different versions of {name}: {was}, and {is_}.",
                    why="The same records may have different posteriors in different versions.",
                    remedy="Identify the older run again, or accept both versions with "
                    "--mixed-versions.",
                )
    _require_own_records(units)


def _require_own_records(units: Sequence[Unit]) -> None:
    """Raise an error if two runs have the same records, because one unit would count twice."""
    seen: dict[frozenset[str], str] = {}
    for unit in units:
        records = frozenset(unit.summary.inputs.values())
        if records and records in seen:
            raise DataError(
                f"The runs {seen[records]} and {unit.name} were identified from the same records.",
                why="One unit would count as two, and the variation would be underestimated.",
                remedy=f"Give only one of the runs {seen[records]} and {unit.name}.",
            )
        seen[records] = unit.name


def _laws(unit: Unit) -> str:
    return " + ".join(unit.laws) or "none"
