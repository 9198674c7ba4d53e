"""A predicted run for an unmeasured unit: draws of its parameters, and data for predictions."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float

from jbw.errors import DataError
from jbw.measurement.records import Test
from jbw.population.coordinates import laws_of, unit_names
from jbw.population.population import Population
from jbw.population.prediction import NUM_UNITS, new_units, y_peak_of
from jbw.population.unit import NOISE
from jbw.quantities import BY_NAME, CONSTANT_TERMS, RESIDUAL_TERMS
from jbw.report.result import require_finite
from jbw.results.attributes import DrawnPosterior, StoredFleet
from jbw.run.netcdf import read_tree
from jbw.verification.predict import Request, predict
from jbw.verification.predictive_basis import NUM_DRAWS, Basis, basis_of

CONSTANTS = tuple(quantity.name for quantity in CONSTANT_TERMS)
TERMS = tuple(quantity.name for quantity in RESIDUAL_TERMS)
TERMS_KEY = 3  # number that is added to the seed here, so that other random numbers stay the same
# relative difference up to which two torques count as equal, because three digits are stated
SAME_TORQUE = 1e-3


def new_terms(
    fleet: xr.DataTree, rng: np.random.Generator, num: int
) -> dict[str, Float[np.ndarray, " unit"]]:
    r"""Draw, for `num` new units, the constants that represent the response of other modes.

    The constants may have either sign, so that their logarithms cannot be pooled. Given K units,
    each with constants c_k, those of a new unit are, by the normal theory of a mean and a
    covariance that are both unknown,

    $$c = \bar c + \sqrt{\frac{1 + 1/K}{\chi^2_{K-1}}}\,\sum_k g_k (c_k - \bar c), \qquad
      g_k \sim N(0, 1)$$

    Each has Student's t distribution with K - 1 degrees of freedom, with the correlation between
    the constants that the units show; c_k are draws of the units' posteriors. A term that only some
    units have is left out, and so are linear neighbour modes, whose place belongs to one structure;
    predictions name them.

    Reference:
        Gelman et al. (2013), Bayesian Data Analysis, 3rd ed., sections 3.2 and 3.6.
    """
    names, units = terms_of(fleet)[0], unit_names(fleet)
    if not names:
        return {}
    groups = [fleet[unit].to_dataset() for unit in units]
    unit_draws = [np.stack([group[name].values for name in names], axis=-1) for group in groups]
    sampled = np.stack(
        [values[rng.integers(len(values), size=num)] for values in unit_draws], axis=1
    )
    middle, count = sampled.mean(axis=1), len(units)
    g = rng.standard_normal((num, count))
    stretch = np.sqrt((1.0 + 1.0 / count) / rng.chisquare(count - 1, num))
    away = np.einsum("nk,nkj->nj", g, sampled - middle[:, None])
    return dict(zip(names, (middle + stretch[:, None] * away).T, strict=True))


def terms_of(fleet: xr.DataTree) -> tuple[list[str], list[str]]:
    """Return the residual terms of a new unit, and the terms that only some of the units have."""
    held = [set(map(str, fleet[unit].data_vars)) & set(TERMS) for unit in unit_names(fleet)]
    every = [name for name in CONSTANTS if all(name in unit_terms for unit_terms in held)]
    return every, [name for name in TERMS if name not in every and any(name in o for o in held)]


def new_unit(
    population: Population,
    fleet: xr.DataTree,
    torque: float | None = None,
    *,
    seed: int = 0,
    num: int = NUM_UNITS,
) -> xr.DataTree:
    """Return draws of new, unmeasured units, in the same form as a single run's posterior.

    The variation between runs is that within the units, and the noise is the mean over the tests of
    all units. The fitted range ends at the smallest of the units' largest displacements. Constant
    residual terms that every unit has are included; others are left out, and predictions name them.
    """
    draws = new_units(population, fleet, torque, seed=seed, num=num)
    units = StoredFleet.of(fleet).units
    variables: dict[str, Any] = {
        name: (("chain", "draw"), values[None], {"units": units.get(name, "1")})
        for name, values in draws.items()
    }
    for name, values in new_terms(fleet, np.random.default_rng([seed, TERMS_KEY]), num).items():
        variables[name] = (("chain", "draw"), values[None], {"units": BY_NAME[name].unit})
    labels, noise = _noise(fleet)
    if labels:
        noise_std = np.broadcast_to(noise, (1, num, len(noise)))
        variables["noise_std"] = (("chain", "draw", "group"), noise_std)
    coords = {"chain": [0], "draw": np.arange(num), **({"group": labels} if labels else {})}
    root = xr.Dataset(attrs=_facts(population, fleet, torque))
    return xr.DataTree.from_dict({"/": root, "/posterior": xr.Dataset(variables, coords)})


def new_prediction(
    population: Population,
    fleet: xr.DataTree,
    test: Test,
    torque: float | None = None,
    *,
    num_draws: int = NUM_DRAWS,
    noise: bool = True,
    gain: float | None = None,
    seed: int = 0,
) -> xr.Dataset:
    """Predict any test of a new unit; its bands include the variation between units.

    Args:
        population: A population from `jbw.population_of`.
        fleet: The fleet from which the population was made.
        test: The predicted test, measured or planned.
        torque: Torque at which the unit is tightened [N m]; the reference torque when None.
        num_draws: Number of units that the model propagates; fewer for long records.
        noise: Whether the bands include the measurement noise, where it is known.
        gain: Gain of the test's source, or 1 / modal mass, where it is known; otherwise the units'
            own gains.
        seed: Seed of all random numbers.

    Returns:
        A dataset like that of `Study.predict`.

    Raises:
        ConfigError: The torque is not positive, or there are too few draws.
        DataError: A torque is given but the fleet has no trend with it, or no gain is known for the
            source.

    Examples:
        The band of a new unit contains the noise test of a measured unit:

        >>> import jbw; jbw.enable_x64()
        >>> from dataclasses import replace
        >>> asked = {"tests": ["noise_0p005V"], "repeats": 2, "fs": 128.0}
        >>> units = jbw.rig.measure_fleet("laboratory", torques=[8.0], assemblies=3, **asked)
        >>> studies = [jbw.identify(replace(unit, laws=()), quick=True) for unit in units]
        >>> fleet = jbw.fleet_of(studies)
        >>> population = jbw.population_of(fleet)
        >>> bands = jbw.new_prediction(population, fleet, units[0].tests[0], num_draws=20)
        >>> print(f"{bands.attrs['test']}: {bands.attrs['coverage']:.0%}")
        noise_0p005V: 100%
    """
    basis = basis_of(new_unit(population, fleet, torque, seed=seed, num=max(num_draws, 2)))
    return predict(basis, test, Request(num_draws, noise, gain, seed))


def _facts(population: Population, fleet: xr.DataTree, torque: float | None) -> dict[str, Any]:
    """Return the attributes of new units that predictions need, such as laws and noise.

    `basis_of` reads them; tests are those of all measured units, not of the new unit.
    """
    names = unit_names(fleet)
    units = [DrawnPosterior.of(fleet[name]) for name in names]
    seen = {}
    for name, unit in zip(names, units, strict=True):
        for test, facts in unit.tests.items():
            family = f"{name}: {facts['family']}" if facts.get("family") else ""
            seen[f"{name}: {test}"] = {**facts, "family": family}
    scatter = [unit.scatter for unit in units if unit.scatter]
    y_peak, at = y_peak_of(fleet), torque_of(population, torque)
    return {
        "laws": json.dumps(laws_of(fleet)),
        "tests": json.dumps(seen),
        "substeps": max(unit.substeps or 1 for unit in units),
        "y_peak": y_peak if np.isfinite(y_peak) else 0.0,
        **({"scatter": np.sqrt(np.mean(np.square(scatter), axis=0))} if scatter else {}),
        **({} if at is None else {"torque": at}),
        "lacking": json.dumps(terms_of(fleet)[1]),
    }


def torque_of(population: Population, torque: float | None) -> float | None:
    """Return a new unit's torque [N m]: the given, the reference or the common torque."""
    found = population.result
    stated = {unit_torque for unit_torque in found.torque if unit_torque is not None}
    common = stated.pop() if len(stated) == 1 else None
    return next((t for t in (torque, found.reference_torque, common) if t is not None), None)


def _noise(fleet: xr.DataTree) -> tuple[list[str], np.ndarray]:
    """Return the noise of all units' data groups; the unit's name precedes the group's label."""
    labels, values = [], []
    for name in unit_names(fleet):
        group = fleet[name].to_dataset()
        if NOISE in group:
            labels += [f"{name}: {label}" for label in group["label"].values]
            values += group[NOISE].values.tolist()
    return labels, np.array(values)


def holds_population(folder: Path) -> bool:
    """Return whether a folder contains the population of a fleet."""
    return (folder / "population.json").is_file()


def basis_of_population(folder: Path) -> Basis:
    """Return the inputs of predictions of new units, from the population in a folder.

    Raises:
        DataError: The folder contains no complete population.
    """
    try:
        tree = read_tree(folder / "population.nc")
        require_finite(tree, folder / "population.nc")
        return basis_of(tree)
    except (OSError, KeyError, TypeError, ValueError, DataError) as cause:
        raise DataError(
            f"The population in {folder} cannot be read: {type(cause).__name__} {cause}",
            remedy="Repeat: jbw population FLEET.",
        ) from cause


def require_same_torque(folder: Path, torque: float | None) -> float | None:
    """Return the torque [N m] of a stored population; raise an error if the tests have another.

    The result is None where the folder contains no population, or one without a torque.
    """
    if not holds_population(folder):
        return None
    at = json.loads((folder / "population.json").read_text())["new_unit"]["torque"]
    if torque is not None and at is not None and abs(torque / at - 1.0) > SAME_TORQUE:
        raise DataError(
            f"The tests are of a joint tightened to {torque:g} N m, but the population in "
            f"{folder} predicts units at {at:g} N m.",
            remedy=f"Compute the population at {torque:g} N m: jbw population FLEET --torque "
            f"{torque:g} --out DIR, then jbw predict DIR.",
        )
    return at
