"""Starts that find the optimum: first values without a model, earlier steps, points of the box."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from jbw.inference.fit.costly_fit import costly_fit
from jbw.inference.fit.fitting import Fit, fit
from jbw.inference.space.box import Box, box, from_unit
from jbw.observables.dataset import Dataset, stacked
from jbw.observables.observable import AmplitudeCurve
from jbw.oscillator.oscillator import Oscillator, oscillator_of

NUM_SCREENED = 32  # points of the box whose cost is looked at
NUM_STARTS = 3  # of them fitted
EXPLAINED = 5.0  # chi-square a degree of freedom below which a fit explains the data
CURVE_STARTS = 8  # of the fit to frequency and damping against amplitude, which costs nothing
MOST_CURVE_POINTS = 200
FREQUENCY_STD, DAMPING_STD = 1e-4, 0.03  # relative: weights of such a curve


def first_values(data: Dataset) -> dict[str, float]:
    """omega_n [rad/s], zeta [-] and gain as the first part tells them that can; empty if none."""
    return next((found for part in data.parts if (found := part.first_values())), {})


def from_amplitude_curve(
    key: Key[Array, ""], data: Dataset, prior: Box, known: Mapping[str, float]
) -> dict[str, float]:
    r"""The laws' parameters from frequency and damping against amplitude, where data show them.

    $$\omega(Y)^2 = k + \sum_l K_l(Y), \qquad
      2\,\zeta(Y)\,\omega(Y)^2 = 2\zeta\omega_n\omega(Y) + \sum_l C_l(Y)$$

    with K and C of the steady loops: no solve in time, so that many starts cost nothing.
    """
    curve = next((c for part in data.parts if (c := part.amplitude_curve()) is not None), None)
    if curve is None or "zeta" not in prior.names:
        return {}
    some = np.unique(np.linspace(0, len(curve.y) - 1, MOST_CURVE_POINTS).astype(int))
    thin = AmplitudeCurve(*(values[some] for values in curve))
    laws = data.laws

    def left(theta: Mapping[str, Array], seen: AmplitudeCurve) -> Float[Array, " value"]:
        omega, zeta = jax.vmap(lambda y: equivalent(oscillator_of(theta, laws), y))(seen.y)
        return jnp.concatenate(
            [
                (omega / seen.omega - 1) / FREQUENCY_STD,
                (zeta - seen.zeta) / (DAMPING_STD * jnp.max(seen.zeta)),
            ]
        )

    inner = [i for i, name in enumerate(prior.names) if name != "gain"]
    names = tuple(prior.names[i] for i in inner)
    lower, upper = (np.asarray(side)[inner].tolist() for side in (prior.lower, prior.upper))
    bounds = dict(zip(names, zip(lower, upper, strict=True), strict=True))
    found = fit(left, box(bounds), thin, starts=CURVE_STARTS, key=key)
    return {name: value for name, value in found.theta.items() if name not in known}


def equivalent(
    joint: Oscillator, y_peak: Float[Array, ""]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Equivalent frequency [rad/s] and damping ratio [-] at an amplitude."""
    loop = joint.loop(y_peak)
    square = joint.k + loop.stiffness
    omega = jnp.sqrt(square)
    return omega, joint.zeta * joint.omega_n / omega + loop.damping / (2 * square)


def fit_from(key: Key[Array, ""], data: Dataset, prior: Box, known: Mapping[str, float]) -> Fit:
    """Least squares over all parameters, from what is known of them.

    Where that fit does not explain the data, also from the best of many points all over the box:
    their costs are looked at first, for a solve costs far less than a fit.
    """
    middle = from_unit(jnp.full(len(prior.names), 0.5), prior)
    start = {name: known.get(name, float(middle[name])) for name in prior.names}
    first = costly_fit(stacked, prior, data, starts=inside(start, prior))
    chi_square, dof = first.chi_square
    if chi_square < EXPLAINED * dof:
        return first
    points = from_unit(jax.random.uniform(key, (NUM_SCREENED, len(prior.names))), prior)
    for name in {"omega_n", "gain"} & set(points) & set(known):  # known far better than the box
        points[name] = jnp.full(NUM_SCREENED, known[name])
    order = np.argsort(np.asarray(_costs(points, data)))[:NUM_STARTS]
    starts = {name: np.asarray(values)[order] for name, values in points.items()}
    second = costly_fit(stacked, prior, data, starts=inside(starts, prior))
    best = min(first, second, key=lambda one: one.cost)
    return replace(best, waterfall=np.sort(np.append(first.waterfall, second.waterfall)))


def inside(starts: Mapping[str, Any], prior: Box) -> dict[str, np.ndarray]:
    """Starts moved into the box."""
    return {
        name: np.clip(starts[name], prior.lower[i], prior.upper[i])
        for i, name in enumerate(prior.names)
    }


@jax.jit
def _costs(points: Mapping[str, Array], data: Dataset) -> Float[Array, " point"]:
    costs = jax.lax.map(lambda theta: jnp.sum(stacked(theta, data) ** 2), dict(points))
    return jnp.where(jnp.isfinite(costs), costs, jnp.inf)
