"""A unit of the population that nobody measured: its parameters, frequency and damping."""

import json
from typing import Any

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Float

from jbw.population.coordinates import unit_names
from jbw.population.population import Population, require_torque
from jbw.population.trend import expected
from jbw.verification.backbone import HERTZ, RATIO, curves
from jbw.verification.bands import QUANTILE_AXIS, band
from jbw.verification.predicted import carry

NUM_UNITS = 400
NUM_AMPLITUDES = 40


def new_coordinates(
    found: Population, torque: float | None, rng: np.random.Generator, num: int = NUM_UNITS
) -> Float[np.ndarray, "unit d"]:
    r"""Logarithms of the pooled coordinates of further units, $\varphi = B x + L_T \epsilon$."""
    require_torque(found, torque)
    flat = {n: v.reshape(-1, *v.shape[2:]) for n, v in found.draws.items() if n != "diverging"}
    some = rng.integers(len(flat["tau"]), size=num)
    bent = flat["u"][some] if "u" in flat else None
    row = found.design.at(torque)[None]
    middle = np.asarray(expected(flat["line"][some], row, found.design, bent))[:, 0]
    root = np.linalg.cholesky(flat["scatter"][some])
    return middle + np.einsum("sij,sj->si", root, rng.standard_normal(middle.shape))


def new_units(
    found: Population,
    fleet: xr.DataTree,
    torque: float | None = None,
    *,
    seed: int = 0,
    num: int = NUM_UNITS,
) -> dict[str, Float[np.ndarray, " unit"]]:
    r"""Parameters of further units, at a torque [N m] or at the reference.

    What is pooled may be fewer numbers than the parameters: products, where data know no factor. A
    draw of a measured unit is moved by the least step, in logarithms, that gives it the pooled
    coordinates of the new one,

    $$\ln\theta' = \ln\theta + P^+ (\varphi - P \ln\theta)$$

    so that what is pooled scatters as the population does, and the rest as within the units.
    """
    rng = np.random.default_rng(seed)
    wanted = new_coordinates(found, torque, rng, num)
    parameters = list(found.pooled.parameters)
    names = unit_names(fleet)
    own = [fleet[name]["draws"].sel(parameter=parameters).values for name in names]
    start = np.stack([own[k][rng.integers(len(own[k]))] for k in rng.integers(len(own), size=num)])
    powers = found.pooled.powers
    step = (wanted - start @ powers.T) @ np.linalg.pinv(powers).T
    return dict(zip(parameters, np.exp(start + step).T, strict=True))


def new_backbone(
    found: Population, fleet: xr.DataTree, torque: float | None = None, *, seed: int = 0
) -> xr.Dataset:
    """99 % bands of a further unit's frequency and damping, to what every unit was driven to."""
    peaks = [float(fleet[one].attrs.get("y_peak", np.nan)) for one in unit_names(fleet)]
    known = [one for one in peaks if np.isfinite(one)]
    y_peak = min(known) if known else 1e-3
    amplitude = y_peak * np.arange(1, NUM_AMPLITUDES + 1) / NUM_AMPLITUDES
    draws = new_units(found, fleet, torque, seed=seed)
    laws: Any = tuple(json.loads(fleet.attrs["laws"]))
    frequency, damping, _ = carry(curves, draws, jnp.asarray(amplitude), laws)
    dims = ("quantile", "amplitude")
    return xr.Dataset(
        {"frequency": (dims, band(frequency), HERTZ), "damping": (dims, band(damping), RATIO)},
        {"amplitude": ("amplitude", amplitude, {"units": "m"}), "quantile": QUANTILE_AXIS},
        {} if torque is None else {"torque": torque},
    )
