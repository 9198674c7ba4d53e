"""A fleet: the posteriors of several runs, one per unit, as one tree of logarithms.

The `xr.DataTree` that `fleet_of` returns and `fleet.nc` stores contains:

At the root, attributes

    format    1, of this description
    laws      JSON list of the laws of the joint, the same in every run
    units     JSON: parameter to the SI unit of the value whose logarithm is stored
    symbols   JSON: parameter to its displayed symbol
    meanings  JSON: parameter to its meaning in a few words
    versions  JSON: package to its version, the same in every run (jbw and numerical packages)
    left_out  JSON: quantity to the units that do not determine it, or have draws that are not
              positive and thus no logarithm; no variable contains it

coordinates

    unit       unique name of each run, that of its folder, in the given order (`mean_run` for
               `mean` and other names of variables)
    parameter  omega_n, zeta, the laws' own parameters, their products (`alpha_delta`) and their
               other coordinates (`softening` = alpha delta/omega_n^2), `gain` where every run
               inferred it; only those that every run has, positive in all of its draws

and variables

    torque       (unit)  tightening torque [N m], NaN where no run states one; either all runs or
                 none must state it
    sequence     (unit)  number of the tightening, NaN where not stated
    temperature  (unit)  temperature [degC], NaN where not stated
    assembly     (unit)  name of the assembly, empty where not stated
    verdict      (unit)  verdict on the run: ok, usable, failed, not assessed
    sampling     (unit)  verdict on the computation alone, from `jbw`'s answers; empty in old runs
    num_draws    (unit)  number of draws of the unit, all of equal weight
    ess          (unit)  smallest effective number of draws among the posterior's parameters
    mean         (unit, parameter)  means of the natural logarithms
    covariance   (unit, parameter, other)  covariances of the natural logarithms; `other` has the
                 names of `parameter`
    lower, upper (unit, parameter)  logarithms of the bounds of the uniform prior where the
                 parameter itself was sampled, NaN where it was not; lower is -inf where the bound
                 is not positive
    beyond       (unit, parameter)  probability beyond these bounds of a Gaussian in the sampled
                 coordinate (no logarithm) with the draws' mean and sd: near 0 where the prior does
                 not affect the posterior, about 0.04 and more where it cuts it; NaN where not
                 sampled
    run_scatter  (unit, parameter)  sd over the runs within the unit, over the mean, of omega_n and
                 zeta where the unit has several runs; NaN elsewhere

A group for each unit, `fleet[unit]`, with

    draws  (draw, parameter)  natural logarithms, chains one after the other; as many as in the run
    gain   (draw)  gain of the source (no logarithm), inferred or fixed; missing where unknown
    noise  (label)  noise of every group of data, in the unit of the compared values
    residual_upper and others  (draw)  residual terms of the run (no logarithms)
    attributes  campaign (its name), folder (of the run), source (the campaign file), y_peak (the
                largest fitted displacement [m]; NaN where the run does not state it); tests,
                substeps and scatter as in the run, for predictions

Logarithms of monomials are sums of those of their factors: ln(alpha delta/omega_n^2) is
`draws.sel(parameter="alpha_delta") - 2 draws.sel(parameter="omega_n")`. The uniform prior in theta
has the density exp(sum ln theta) over ln theta; nothing here removes it.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from scipy.stats import norm

from jbw.errors import DataError, RunError
from jbw.population.covariates import NUMBERS, Covariates, covariates_of, require_torque_of_all
from jbw.population.unit import GAIN, NOISE, Unit, require_alike, units_of
from jbw.report.messages import population as messages
from jbw.results.attributes import StoredFleet
from jbw.run.netcdf import read_tree, write_tree
from jbw.study.study import Study

FORMAT = 1
FEWEST = 2  # smallest number of units from which the variation between units can be estimated
ABOUT = {
    "torque": {"units": "N m", "long_name": "tightening torque"},
    "sequence": {"units": "1", "long_name": "number of the tightening"},
    "temperature": {"units": "degC", "long_name": "temperature"},
}


def fleet_of(
    runs: Iterable[Study | str | Path],
    *,
    covariates: Mapping[str, Mapping[str, Any]] | None = None,
    mixed_versions: bool = False,
) -> xr.DataTree:
    """Return the draws of several finished runs, one per unit, with their covariates.

    Args:
        runs: Folders of finished runs, or results of `jbw.identify` and `jbw.load_study`; one per
            unit, in the order of the units.
        covariates: Name of a run to `torque` [N m], `sequence`, `assembly`, `temperature` [degC],
            which replace those that its campaign states in [assembly].
        mixed_versions: Whether runs of different versions of jbw or its numerical packages are
            accepted.

    Raises:
        ConfigError: Covariates are given for an unknown run, or are unknown.
        DataError: There are fewer than two runs; runs have different laws, units or versions, or
            the same records; a run is not finished; or some runs state a torque and others do not.

    Examples:
        The finished runs of two torques make a fleet:

        >>> import jbw; jbw.enable_x64()
        >>> asked = {"tests": ["noise_0p005V"], "repeats": 2, "fs": 128.0}
        >>> units = jbw.rig.measure_fleet("laboratory", torques=[4.0, 8.0], assemblies=1, **asked)
        >>> fleet = jbw.fleet_of(jbw.identify(unit, quick=True) for unit in units)
        >>> print(sorted(fleet["torque"].values.tolist()), fleet["assembly"].values.tolist())
        [4.0, 8.0] ['assembly 1', 'assembly 1']
    """
    units = units_of(list(runs))
    if len(units) < FEWEST:
        raise DataError(
            f"A fleet needs at least {FEWEST} runs, but there {'is one' if units else 'is none'}.",
            why=f"With fewer than {FEWEST} units the variation between units cannot be estimated.",
            remedy="Give the folders of more finished runs, of other units or tightenings.",
        )
    require_alike(units, mixed_versions=mixed_versions)
    stated = covariates_of({unit.name: unit.summary.assembly for unit in units}, covariates or {})
    require_torque_of_all(stated)
    return _tree(units, [stated[unit.name] for unit in units])


def read_fleet(path: str | Path) -> xr.DataTree:
    """Read a fleet from the file that `write_fleet` or `jbw collect` wrote.

    Raises:
        DataError: The file does not exist, or contains no fleet of this format.

    Examples:
        The torques of a fleet are read from its file:

        >>> import jbw; jbw.enable_x64()
        >>> asked = {"tests": ["noise_0p005V"], "repeats": 2, "fs": 128.0}
        >>> units = jbw.rig.measure_fleet("laboratory", torques=[4.0, 8.0], assemblies=1, **asked)
        >>> fleet = jbw.fleet_of(jbw.identify(unit, quick=True) for unit in units)
        >>> jbw.write_fleet("fleet.nc", fleet)
        >>> print(sorted(jbw.read_fleet("fleet.nc")["torque"].values.tolist()))
        [4.0, 8.0]
    """
    path, remedy = Path(path), messages.WRITE_FLEET
    try:
        tree = read_tree(path)
    except OSError as cause:
        raise DataError(f"The fleet {path} cannot be read: {cause}", remedy=remedy) from cause
    if StoredFleet.of(tree).format != FORMAT or "unit" not in tree.coords:
        raise DataError(f"{path} contains no fleet of format {FORMAT}.", remedy=remedy)
    return tree


def write_fleet(path: str | Path, fleet: xr.DataTree) -> None:
    """Write a fleet to one NetCDF file; after an error, no incomplete file remains.

    Examples:
        A fleet is kept in one file:

        >>> import jbw; jbw.enable_x64()
        >>> asked = {"tests": ["noise_0p005V"], "repeats": 2, "fs": 128.0}
        >>> units = jbw.rig.measure_fleet("laboratory", torques=[4.0, 8.0], assemblies=1, **asked)
        >>> fleet = jbw.fleet_of(jbw.identify(unit, quick=True) for unit in units)
        >>> jbw.write_fleet("fleet.nc", fleet)
        >>> print(jbw.read_fleet("fleet.nc").identical(fleet))
        True
    """
    path = Path(path)
    try:
        write_tree(path, fleet)
    except OSError as error:
        raise RunError(
            f"The fleet {path} cannot be written: {error.strerror or error}.",
            remedy="Choose another file with --out, in an existing folder.",
        ) from error


def _tree(units: Sequence[Unit], stated: Sequence[Covariates]) -> xr.DataTree:
    names, left_out = _common(units)
    logs = [np.log(np.stack([unit.draws[name] for name in names], axis=-1)) for unit in units]
    first = units[0]
    per, square = ("unit", "parameter"), ("unit", "parameter", "other")
    bounds = np.array([[_log_bounds(unit, name) for name in names] for unit in units])
    scatter = [[unit.scatter.get(name, np.nan) for name in names] for unit in units]
    covariance = [np.atleast_2d(np.cov(log, rowvar=False)) for log in logs]
    root = xr.Dataset(
        {
            **{
                name: ("unit", [getattr(covariates, name) for covariates in stated], ABOUT[name])
                for name in NUMBERS
            },
            "assembly": ("unit", _words(covariates.assembly for covariates in stated)),
            "verdict": ("unit", _words(unit.summary.verdict.status for unit in units)),
            "sampling": ("unit", _words(unit.summary.verdict.answer("sampling") for unit in units)),
            "num_draws": ("unit", [len(log) for log in logs]),
            "ess": ("unit", [unit.ess for unit in units]),
            "mean": (per, [log.mean(axis=0) for log in logs]),
            "covariance": (square, covariance),
            "lower": (per, bounds[..., 0]),
            "upper": (per, bounds[..., 1]),
            "beyond": (per, [[beyond(unit, name) for name in names] for unit in units]),
            "run_scatter": (per, scatter),
        },
        {
            "unit": _words(unit.name for unit in units),
            "parameter": _words(names),
            "other": _words(names),
        },
        {
            "format": FORMAT,
            "laws": json.dumps(first.laws),
            "units": json.dumps({name: first.quantities[name].unit for name in names}),
            "symbols": json.dumps({name: first.quantities[name].symbol for name in names}),
            "meanings": json.dumps({name: first.quantities[name].meaning for name in names}),
            "versions": json.dumps(first.summary.versions),
            "left_out": json.dumps(left_out),
        },
    )
    groups = {f"/{unit.name}": _group(unit, log) for unit, log in zip(units, logs, strict=True)}
    return xr.DataTree.from_dict({"/": root, **groups})


def _group(unit: Unit, logs: Any) -> xr.Dataset:
    variables: dict[str, Any] = {"draws": (("draw", "parameter"), logs)}
    coords: dict[str, Any] = {}
    if unit.gain is not None:
        variables[GAIN] = ("draw", unit.gain)
    variables |= {name: ("draw", values) for name, values in unit.terms.items()}
    if unit.noise:
        variables[NOISE] = ("label", list(unit.noise.values()))
        coords = {"label": _words(unit.noise)}
    return xr.Dataset(variables, coords, unit.origin)


def _words(texts: Iterable[str]) -> Any:
    return np.asarray(list(texts), object)


def _common(units: Sequence[Unit]) -> tuple[list[str], dict[str, list[str]]]:
    """Return the quantities that are positive in every unit, and for all others the exceptions."""
    every = dict.fromkeys(name for unit in units for name in unit.draws)
    lacking = {
        name: [u.name for u in units if name not in u.draws or not np.all(u.draws[name] > 0)]
        for name in every
    }
    return [name for name in every if not lacking[name]], {n: w for n, w in lacking.items() if w}


def _log_bounds(unit: Unit, name: str) -> tuple[float, float]:
    """Return the logarithms of the prior's bounds: -inf for a bound of 0, NaN without a prior."""
    lower, upper = unit.bounds.get(name, (np.nan, np.nan))
    return float(np.log(lower)) if not lower <= 0 else -np.inf, float(np.log(upper))


def beyond(unit: Unit, name: str) -> float:
    """Return the probability beyond the prior bounds, for a Gaussian fitted to a unit's draws.

    It is almost zero for a posterior that the bounds do not affect, 9 % for a posterior that is cut
    at its mode (half a Gaussian), and 4 % for a posterior that is flat up to a bound. NaN if the
    parameter was not sampled.
    """
    if name not in unit.bounds:
        return np.nan
    lower, upper = unit.bounds[name]
    mean, sd = unit.draws[name].mean(), unit.draws[name].std()
    if sd == 0:
        return 0.0
    return float(norm.cdf((lower - mean) / sd) + norm.sf((upper - mean) / sd))
