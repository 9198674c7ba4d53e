"""Starts that find the optimum: a linear look at the data, earlier steps, points of the box."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key
from numpy.typing import NDArray

from jbw.inference.box import Box, from_unit
from jbw.inference.costly_fit import costly_fit
from jbw.inference.fitting import Fit
from jbw.measurement.channels import derivative_order
from jbw.observables.evidence import Evidence, residual
from jbw.observables.harmonics import Points
from jbw.observables.linear import LineReading
from jbw.observables.loops import Loops
from jbw.observables.response import Records

NUM_SCREENED = 32  # points of the box whose cost is looked at
NUM_STARTS = 3  # of them fitted
EXPLAINED = 5.0  # chi-square a degree of freedom below which a fit explains the data
NEAR_PEAK = 0.3  # of the peak: lines of a spectrum that the linear look uses


def linear_look(data: Evidence) -> dict[str, float]:
    r"""Natural frequency, damping and gain by linear least squares, no iteration.

    $$(\omega_n^2 + 2j\zeta\omega_n\omega)\,Y - g\,U = \omega^2\,Y$$

    over the points of steady motion of the lowest level, or the lines near the peak of a record's
    spectrum.

    Args:
        data: The evidence.

    Returns:
        omega_n [rad/s], zeta [-] and gain; empty where nothing shows them.
    """
    for part in data.parts:
        if isinstance(part, LineReading):
            omega_n, zeta, gain = (float(value) for value in part.mean)
            return {"omega_n": omega_n, "zeta": zeta, "gain": gain}
    for part in data.parts:
        if isinstance(part, Points):
            return _look(*_quietest(part))
        if isinstance(part, Records):
            return _look(*_spectrum(part))
    return {}


def _look(
    omega: NDArray[np.float64], u: NDArray[np.complex128], y: NDArray[np.complex128]
) -> dict[str, float]:
    columns = np.column_stack([y, 1j * omega * y, -u])
    scale = np.linalg.norm(columns, axis=0)
    target = omega**2 * y
    stacked = np.concatenate([(columns / scale).real, (columns / scale).imag])
    found = np.linalg.lstsq(stacked, np.concatenate([target.real, target.imag]))[0] / scale
    omega_n = float(np.sqrt(max(found[0], np.min(omega) ** 2)))
    return {
        "omega_n": omega_n,
        "zeta": float(max(found[1] / (2 * omega_n), 1e-4)),
        "gain": float(found[2]),
    }


def _quietest(
    part: Points,
) -> tuple[NDArray[np.float64], NDArray[np.complex128], NDArray[np.complex128]]:
    """Points of the group of first harmonics with the smallest motion at its peak."""
    point, position = np.asarray(part.point), np.asarray(part.position)
    sizes = np.asarray(part.repeats.size).astype(int) // 2
    motion, load, omega = (np.asarray(x) for x in (part.motion, part.load, part.omega))
    first = [i for i in range(len(sizes)) if position[i] == 0 and sizes[i] >= 3]
    first = first or [i for i in range(len(sizes)) if position[i] == 0]
    peaks = [np.abs(motion[point[i, : sizes[i]], 0]).max() for i in first]
    chosen = point[first[int(np.argmin(peaks))], : sizes[first[int(np.argmin(peaks))]]]
    return omega[chosen], load[chosen, 0], motion[chosen, 0]


def _spectrum(
    part: Records,
) -> tuple[NDArray[np.float64], NDArray[np.complex128], NDArray[np.complex128]]:
    """Lines of the lowest level near the peak of its response."""
    mean, source = np.asarray(part.mean), np.asarray(part.source)
    level = int(np.argmin(np.mean(mean**2, axis=1)))
    omega = 2 * np.pi * np.fft.rfftfreq(mean.shape[1], 1 / part.fs)[1:]
    x, u = (np.fft.rfft(row[level])[1:] for row in (mean, source))
    y = x / (1j * omega) ** derivative_order(part.response)
    driven = np.abs(u) > 0.1 * np.abs(u).max()
    near = driven & (np.abs(x) > NEAR_PEAK * np.abs(x[driven]).max())
    return omega[near], u[near], y[near]


def largest_displacement(data: Evidence, omega_n: float) -> float:
    """Largest displacement that was measured [m]; of noise, of which the rms is known, that."""
    found = [0.0]
    for part in data.parts:
        if isinstance(part, Records):
            power = derivative_order(part.response)
            found.append(float(jnp.max(jnp.abs(part.mean))) / omega_n**power)
        elif isinstance(part, Points):
            found.append(float(jnp.max(jnp.abs(part.motion))))
        elif isinstance(part, Loops):
            found.append(float(jnp.max(jnp.abs(part.displacement))))
        elif isinstance(part, LineReading):
            found.append(float(part.y_rms))
        else:
            found.append(float(part.y_start))
    return max(found)


def fit_from(key: Key[Array, ""], data: Evidence, prior: Box, known: Mapping[str, float]) -> Fit:
    """Least squares over all parameters, from what is known of them.

    Where that fit does not explain the data, also from the best of many points all over the box:
    their costs are looked at first, for a solve costs far less than a fit.

    Args:
        key: Random key of the points.
        data: The evidence.
        prior: The box.
        known: Starting values by name; the middle of the box for the others.

    Returns:
        The best fit, with the costs from all starts.
    """
    middle = from_unit(jnp.full(len(prior.names), 0.5), prior)
    start = {name: known.get(name, float(middle[name])) for name in prior.names}
    first = costly_fit(residual, prior, data, starts=inside(start, prior))
    chi_square, dof = first.chi_square
    if chi_square < EXPLAINED * dof:
        return first
    points = from_unit(jax.random.uniform(key, (NUM_SCREENED, len(prior.names))), prior)
    for name in {"omega_n", "gain"} & set(points) & set(known):  # known far better than the box
        points[name] = jnp.full(NUM_SCREENED, known[name])
    order = np.argsort(np.asarray(_costs(points, data)))[:NUM_STARTS]
    starts = {name: np.asarray(values)[order] for name, values in points.items()}
    second = costly_fit(residual, prior, data, starts=inside(starts, prior))
    best = min(first, second, key=lambda one: one.cost)
    return replace(best, waterfall=np.sort(np.append(first.waterfall, second.waterfall)))


def inside(starts: Mapping[str, Any], prior: Box) -> dict[str, np.ndarray]:
    """Starts moved into the box."""
    return {
        name: np.clip(starts[name], prior.lower[i], prior.upper[i])
        for i, name in enumerate(prior.names)
    }


@jax.jit
def _costs(points: Mapping[str, Array], data: Evidence) -> Float[Array, " point"]:
    costs = jax.lax.map(lambda theta: jnp.sum(residual(theta, data) ** 2), dict(points))
    return jnp.where(jnp.isfinite(costs), costs, jnp.inf)
