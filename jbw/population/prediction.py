"""The prediction of an unmeasured unit of the population: parameters, frequency and damping."""

import numpy as np
import xarray as xr
from jaxtyping import Float

from jbw.population.coordinates import laws_of, unit_names
from jbw.population.population import Population, require_torque
from jbw.population.trend import expected
from jbw.population.unit import GAIN
from jbw.results.attributes import DrawnPosterior
from jbw.verification.backbone import HERTZ, RATIO, curves
from jbw.verification.bands import QUANTILE_AXIS, band

NUM_UNITS = 400
NUM_AMPLITUDES = 40


def new_coordinates(
    population: Population, torque: float | None, rng: np.random.Generator, num: int = NUM_UNITS
) -> Float[np.ndarray, "unit d"]:
    r"""Draw logarithms of new units' pooled quantities, $\varphi = B x + L_T \epsilon$."""
    require_torque(population.design, torque)
    flat = {n: v.reshape(-1, *v.shape[2:]) for n, v in population.draws.items() if n != "diverging"}
    some = rng.integers(len(flat["tau"]), size=num)
    bent = flat["u"][some] if "u" in flat else None
    row = population.design.at(torque)[None]
    middle = np.asarray(expected(flat["line"][some], row, population.design, bent))[:, 0]
    root = np.linalg.cholesky(flat["scatter"][some])
    return middle + np.einsum("sij,sj->si", root, rng.standard_normal(middle.shape))


def new_units(
    population: Population,
    fleet: xr.DataTree,
    torque: float | None = None,
    *,
    seed: int = 0,
    num: int = NUM_UNITS,
) -> dict[str, Float[np.ndarray, " unit"]]:
    r"""Return draws of the parameters of new units, at a torque [N m] or the reference torque.

    The pooled coordinates may be fewer than the parameters: products, where data do not determine
    the factors. A draw of a measured unit is moved by the least step, in logarithms, that gives it
    the pooled coordinates of the new unit and keeps the other coordinates of its law,

    $$\ln\theta' = \ln\theta + (P, Q)^+ (\varphi - P \ln\theta,\ 0)$$

    so that the pooled coordinates vary as in the population, and the rest as within the units. Q is
    the share of the stiffness where no unit determines it. The `gain` of the source is no part of
    the population: it is that of the measured unit whose draw was moved, where all units determine
    theirs.

    Args:
        population: A population from `jbw.population_of`.
        fleet: The fleet from which the population was made.
        torque: Torque at which the units are tightened [N m].
        seed: Seed of all random numbers.
        num: Number of units.

    Raises:
        ConfigError: The torque is not positive.
        DataError: A torque is given but the fleet has no trend with it.

    Examples:
        The frequency of new units varies as that of the measured ones, about 118.1 rad/s:

        >>> import jbw; jbw.enable_x64()
        >>> from dataclasses import replace
        >>> asked = {"tests": ["noise_0p005V"], "repeats": 2, "fs": 128.0}
        >>> units = jbw.rig.measure_fleet("laboratory", torques=[8.0], assemblies=3, **asked)
        >>> studies = [jbw.identify(replace(unit, laws=()), quick=True) for unit in units]
        >>> fleet = jbw.fleet_of(studies)
        >>> new = jbw.new_units(jbw.population_of(fleet), fleet)
        >>> print(sorted(new), f"{new['omega_n'].mean():.0f} rad/s")
        ['gain', 'omega_n', 'zeta'] 118 rad/s
    """
    rng = np.random.default_rng(seed)
    target = new_coordinates(population, torque, rng, num)
    parameters, powers = list(population.pooled.parameters), population.pooled.powers
    unit_draws = [
        fleet[name]["draws"].sel(parameter=parameters).values for name in unit_names(fleet)
    ]
    which = rng.integers(len(unit_draws), size=num)
    place = rng.integers([len(unit_draws[k]) for k in which])
    start = np.stack([unit_draws[k][s] for k, s in zip(which, place, strict=True)])
    both = np.concatenate([powers, population.pooled.common])
    moves = np.pad(target - start @ powers.T, ((0, 0), (0, len(population.pooled.common))))
    units = dict(zip(parameters, np.exp(start + moves @ np.linalg.pinv(both).T).T, strict=True))
    gains = gains_of(fleet)
    if gains is not None:
        units[GAIN] = np.array([gains[k][s] for k, s in zip(which, place, strict=True)])
    return units


def gains_of(fleet: xr.DataTree) -> list[Float[np.ndarray, " draw"]] | None:
    """Return draws of each unit's source gain; None if a unit has no gain."""
    gains = []
    for name in unit_names(fleet):
        group = fleet[name].to_dataset()
        if GAIN in group:
            gains.append(group[GAIN].values)
        elif GAIN in group["parameter"].values:
            gains.append(np.exp(group["draws"].sel(parameter=GAIN).values))
    return gains if len(gains) == fleet.sizes["unit"] else None


def y_peak_of(fleet: xr.DataTree) -> float:
    """Return the displacement [m] that all units' tests reach; NaN if no unit states it."""
    peaks = np.array([DrawnPosterior.of(fleet[name]).y_peak for name in unit_names(fleet)], float)
    return float(np.min(peaks[np.isfinite(peaks)], initial=np.inf)) if np.any(peaks > 0) else np.nan


def new_backbone(
    population: Population, fleet: xr.DataTree, torque: float | None = None, *, seed: int = 0
) -> xr.Dataset:
    """Return 99 % bands of a new unit's frequency and damping, over motion that all units reached.

    For arguments and errors see `jbw.new_units`.

    Examples:
        The median frequency of a new unit is near the 18.8 Hz of the virtual rig:

        >>> import jbw; jbw.enable_x64()
        >>> from dataclasses import replace
        >>> asked = {"tests": ["noise_0p005V"], "repeats": 2, "fs": 128.0}
        >>> units = jbw.rig.measure_fleet("laboratory", torques=[8.0], assemblies=3, **asked)
        >>> studies = [jbw.identify(replace(unit, laws=()), quick=True) for unit in units]
        >>> fleet = jbw.fleet_of(studies)
        >>> bands = jbw.new_backbone(jbw.population_of(fleet), fleet)
        >>> print(f"{bands['frequency'].sel(quantile=0.5).values[0]:.1f} Hz")
        18.8 Hz
    """
    y_peak = y_peak_of(fleet)
    y_peak = y_peak if np.isfinite(y_peak) else 1e-3
    amplitude = y_peak * np.arange(1, NUM_AMPLITUDES + 1) / NUM_AMPLITUDES
    draws = new_units(population, fleet, torque, seed=seed)
    frequency, damping, _ = curves(draws, amplitude, laws_of(fleet))
    dims = ("quantile", "amplitude")
    return xr.Dataset(
        {"frequency": (dims, band(frequency), HERTZ), "damping": (dims, band(damping), RATIO)},
        {"amplitude": ("amplitude", amplitude, {"units": "m"}), "quantile": QUANTILE_AXIS},
        {} if torque is None else {"torque": torque},
    )
