r"""Periodic motions of odd harmonics, y = Re sum q_n exp(j n theta)."""

from collections.abc import Callable
from functools import cache
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient
from jaxtyping import Array, ArrayLike, Complex, Float, Int, Real

from jbw.oscillator.parameters import Restoring

# Number of Newton steps from the grid, whose cell around the extremum is at most 0.05 rad wide.
_NUM_NEWTON = 4
_POINTS_PER_HARMONIC = 8
_LEAST_POINTS = 64


def orders(num_harmonics: int) -> Float[np.ndarray, " harmonic"]:
    """Return the odd orders 1, 3, 5, ... as floats."""
    return 2.0 * np.arange(num_harmonics) + 1.0


def exponentials(theta: Float[Array, "..."], num_harmonics: int) -> Complex[Array, "... harmonic"]:
    r"""Return the harmonics exp(j n theta) of odd orders at given angles, by repeated products."""
    powers = jnp.exp(1j * theta)[..., None]
    while (count := powers.shape[-1]) < num_harmonics:
        shift = jnp.exp(2j * count * theta)[..., None]
        powers = jnp.concatenate([powers, shift * powers[..., : num_harmonics - count]], -1)
    return powers


def synthesis(
    q: Complex[Array, " harmonic"], theta: Float[Array, "..."], derivative: int = 0
) -> Float[Array, "..."]:
    r"""Return Re sum q_n exp(j n theta), or its m-th derivative with respect to theta."""
    basis = exponentials(theta, q.shape[0])
    return jnp.sum(basis * (1j * orders(q.shape[0])) ** derivative * q, -1).real


def crest(q: Complex[Array, " harmonic"]) -> Float[Array, ""]:
    r"""Return the angle of the largest absolute displacement in a period.

    Its first derivative by `q` is exact; therefore two derivatives of y at the crest are exact.
    """
    theta, basis = _half_grid(q.shape[0])
    y = jnp.real(basis @ q)
    top = jnp.argmax(jnp.abs(y))
    angle = jnp.asarray(theta)[top] + jnp.where(y[top] < 0.0, jnp.pi, 0.0)
    fixed = stop_gradient(q)
    angle = jax.lax.fori_loop(0, _NUM_NEWTON, lambda _, angle: flatter(fixed, angle), angle)
    return flatter(q, stop_gradient(angle))


def num_turns(q: Complex[Array, " harmonic"]) -> Int[Array, ""]:
    """Return the number of turning points of y in a period, counted on a grid.

    The grid is shifted by half a cell from the usual one, because the crest of an in-phase motion
    lies on a grid angle, where a zero slope neither rises nor falls.
    """
    theta, basis = _half_grid(q.shape[0])
    beside = np.exp(0.5j * orders(q.shape[0]) * theta[1])
    slope = jnp.real(basis @ (1j * orders(q.shape[0]) * beside * q))
    rising = jnp.append(slope, -slope[0]) > 0.0
    return 2 * jnp.sum(rising[1:] != rising[:-1])


def odd_harmonics(force: Restoring, q: Complex[Array, " harmonic"]) -> Complex[Array, " harmonic"]:
    r"""Return the harmonics of an odd force along the motion, from its values on a uniform grid.

    $$f_n = \frac{2}{M}\sum_{j<M} f(y(\theta_j))\,e^{-jn\theta_j}, \qquad
      \theta_j = \pi j/M, \quad M = \max(64, 8H)$$

    The other half of the period mirrors this one. The result is exact for polynomials up to degree
    7; for other smooth forces the error falls exponentially with the number of points.
    """
    _, basis = _half_grid(q.shape[0])
    return 2.0 / basis.shape[0] * (jnp.asarray(force(jnp.real(basis @ q))) @ basis.conj())


def _half_grid(
    num_harmonics: int,
) -> tuple[Float[np.ndarray, " grid"], Complex[np.ndarray, "grid harmonic"]]:
    """Return angles over half a period, with the odd harmonics exp(j n theta) at them."""
    points = max(_LEAST_POINTS, _POINTS_PER_HARMONIC * num_harmonics)
    theta = np.pi * np.arange(points) / points
    return theta, np.exp(1j * theta[:, None] * orders(num_harmonics))


def flatter(q: Complex[Array, " harmonic"], theta: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return an angle closer to a turning point (y' = 0), by one Newton step."""
    curvature = synthesis(q, theta, 2)
    safe = jnp.where(curvature == 0.0, 1.0, curvature)
    return theta - synthesis(q, theta, 1) / safe


def angle_of(
    q: Complex[Array, " harmonic"], start: Float[Array, ""], target: Float[Array, ""]
) -> Float[Array, ""]:
    """Return the angle at which y falls to a target value in the half period after the crest.

    It serves as a break point of a quadrature, where an error enters only by a higher power.
    """
    ratio = target / synthesis(q, start)
    angle = start + jnp.arccos(jnp.clip(jnp.where(jnp.isfinite(ratio), ratio, 0.0), -1.0, 1.0))

    def newton(_: int, angle: Array) -> Array:
        slope = synthesis(q, angle, 1)
        step = (synthesis(q, angle) - target) / jnp.where(slope == 0.0, -1.0, slope)
        return jnp.clip(angle - step, start, start + jnp.pi)

    return jax.lax.fori_loop(0, 5, newton, angle)


def over_half_period(
    force_at: Callable[[Array], Any],
    q: Complex[Array, " harmonic"],
    num_nodes: int,
    *breaks: Real[ArrayLike, "..."],
) -> Complex[Array, " harmonic"]:
    r"""Return the odd harmonics of a force that is smooth in y between rising break points.

    $$F_n = \frac{2}{\pi}\int F(y(\theta))\, e^{-jn\theta}\,d\theta$$

    over the half period from the first to the last break point.
    """
    theta, weights = gauss_legendre(num_nodes, *breaks)
    basis = exponentials(theta, q.shape[0])
    y: Float[Array, " node"] = jnp.sum(basis * q, -1).real
    return 2.0 / jnp.pi * ((weights * force_at(y)) @ basis.conj())


def gauss_legendre(
    num_nodes: int, *breaks: Real[ArrayLike, "..."]
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Return Gauss nodes and weights on the intervals between rising break points.

    They are exact to degree 2 num_nodes - 1 on each interval.
    """
    rule, shares = _rule(num_nodes)
    nodes, weights = [], []
    for ends in pairwise(breaks):
        lower, upper = jnp.broadcast_arrays(*(jnp.asarray(end, float) for end in ends))
        width = (upper - lower)[..., None]
        nodes.append(lower[..., None] + width * rule)
        weights.append(width * shares)
    return jnp.concatenate(nodes, -1), jnp.concatenate(weights, -1)


@cache
def _rule(num_nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the Gauss-Legendre nodes and weights on [0, 1]."""
    nodes, _ = np.polynomial.legendre.leggauss(num_nodes)
    # Christoffel's sum of squares is used: NumPy's weights have errors of 1e-12 at the ends.
    squares = np.polynomial.legendre.legvander(nodes, num_nodes - 1) ** 2
    weights = 1.0 / (squares @ (np.arange(num_nodes) + 0.5))
    return 0.5 * (nodes + 1.0), 0.5 * weights
