r"""The Bouc-Wen force along a periodic motion (nu = 1).

Between two turning points the motion is monotone. With two turning points per period, the force
depends on the path only through the peak Y: it is that of the steady loop, in closed form. With
more, the exact map gives the force from the last turning point on; its value at the first one is
the root of the periodicity condition z(theta + pi) = -z(theta), one monotone scalar equation with
slope in [1, 2]. Everything is in one unit of length, with delta and gamma in its inverse and z
divided by alpha.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient
from jaxtyping import Array, Complex, Float

from jbw.oscillator.laws.hysteresis import hysteresis_map
from jbw.oscillator.laws.relaxation import half_width, opening_and_area, psi, unloading_lag
from jbw.oscillator.parameters import Hysteresis, Scalar
from jbw.oscillator.steady.waveform import (
    angle_of,
    crest,
    exponentials,
    flatter,
    gauss_legendre,
    over_half_period,
    synthesis,
)

# Between a turning point and a zero the force is smooth; each harmonic adds about pi/2 of phase.
_NODES = 24
_NODES_PER_HARMONIC = 2
_GRID_PER_HARMONIC = 16
_LEAST_GRID = 128
_NUM_HALVINGS = 20
_NUM_PERIODICITY = 12


def opening(y_peak: Scalar, delta: Scalar, gamma: Scalar) -> Float[Array, "..."]:
    """Return the displacement where z vanishes on unloading from `y_peak`, signed like gamma."""
    sign = jnp.where(gamma < 0.0, -1.0, 1.0)
    d, g = delta * y_peak, sign * gamma * y_peak
    # pyright: ignore[reportArgumentType]
    return sign * y_peak * opening_and_area(half_width(d, g), d + g, g)[0]  # pyright: ignore[reportArgumentType]


def relaxed_force(
    q: Complex[Array, " harmonic"], delta: Scalar, gamma: Scalar, max_turns: int
) -> Complex[Array, " harmonic"]:
    r"""Return the harmonics of the force lost to slip, r = z/alpha - y.

    $$r_n = \frac{2}{\pi}\int_{\theta_t}^{\theta_t+\pi} r\, e^{-jn\theta}\,d\theta, \qquad
      r = -(y_0 + \text{lag}) \text{ on unloading}$$

    by Gauss-Legendre quadrature between the turning points and the zero of z. The integrand is
    continuous at these break points and equal at both ends, up to its first derivative. Their
    motion therefore adds nothing to two derivatives of r_n, and the nodes carry none.
    """
    if max_turns > 2:
        return _folded_relaxed_force(q, delta, gamma, max_turns)
    delta, gamma = jnp.asarray(delta), jnp.asarray(gamma)
    start = crest(q)
    y_open = opening(synthesis(q, start), delta, gamma)
    start_fixed = stop_gradient(start)
    zero = angle_of(*stop_gradient((q, start, y_open)))
    num_nodes = _NODES + _NODES_PER_HARMONIC * q.shape[0]

    def lost(y: Array) -> Array:
        return -(y_open + unloading_lag(y, y_open, delta, gamma))

    return over_half_period(lost, q, num_nodes, start_fixed, zero, start_fixed + jnp.pi)


def force_over_period(
    q: Complex[Array, " harmonic"],
    theta: Float[Array, " time"],
    delta: Scalar,
    gamma: Scalar,
    max_turns: int,
) -> Float[Array, " time"]:
    """Return the steady Bouc-Wen force z/alpha at angles of the period."""
    if max_turns > 2:
        return _folded_force_over_period(q, theta, delta, gamma, max_turns)
    delta, gamma = jnp.asarray(delta), jnp.asarray(gamma)
    y_open = opening(synthesis(q, crest(q)), delta, gamma)
    # The loading branch mirrors the unloading branch.
    side = jnp.where(synthesis(q, theta, 1) > 0.0, -1.0, 1.0)
    y = side * synthesis(q, theta)
    return side * (y - y_open - unloading_lag(y, y_open, delta, gamma))


def _folded_relaxed_force(
    q: Complex[Array, " harmonic"], delta: Scalar, gamma: Scalar, max_turns: int
) -> Complex[Array, " harmonic"]:
    """Return `relaxed_force` for motion with more than two turning points per period."""
    num_harmonics = q.shape[0]
    law, turns, y_turn, z_turn = _turning_states(q, delta, gamma, max_turns)
    turns, zeros = stop_gradient((turns, _zeros(q, turns, y_turn, z_turn, law)))
    breaks = jnp.stack([turns[:-1], zeros], -1).ravel()
    breaks = jnp.append(breaks, turns[-1])
    num_nodes = _NODES + _NODES_PER_HARMONIC * num_harmonics
    theta, weights = gauss_legendre(num_nodes, breaks[:-1], breaks[1:])
    basis = exponentials(theta, num_harmonics)
    y = jnp.sum(basis * q, -1).real
    first = np.repeat(np.arange(turns.shape[0] - 1), 2)
    z = hysteresis_map(law, z_turn[first, None], y - y_turn[first, None])
    return 2.0 / jnp.pi * jnp.einsum("sp,spn->n", weights * (z - y), basis.conj())


def _folded_force_over_period(
    q: Complex[Array, " harmonic"],
    theta: Float[Array, " time"],
    delta: Scalar,
    gamma: Scalar,
    max_turns: int,
) -> Float[Array, " time"]:
    """Return `force_over_period` for motion with more than two turning points per period."""
    law, turns, y_turn, z_turn = _turning_states(q, delta, gamma, max_turns)
    after = jnp.mod(theta - turns[0], 2.0 * jnp.pi)
    side = jnp.where(after >= jnp.pi, -1.0, 1.0)
    place = turns[0] + jnp.where(after >= jnp.pi, after - jnp.pi, after)
    last = jnp.searchsorted(turns[1:-1], place, side="right")
    return side * hysteresis_map(law, z_turn[last], side * synthesis(q, theta) - y_turn[last])


def turning_angles(q: Complex[Array, " harmonic"], max_turns: int) -> Float[Array, " turn"]:
    r"""Return the turning points of half a period, from the crest to its mirror image."""
    start = crest(q)
    points = max(_LEAST_GRID, _GRID_PER_HARMONIC * q.shape[0])
    # The grid is half a cell away from both ends, where y' is zero anyway.
    theta = stop_gradient(start) + np.pi * (np.arange(points) + 0.5) / points
    rising = synthesis(stop_gradient(q), theta, 1) > 0.0
    size = max_turns // 2 - 1
    (cell,) = jnp.nonzero(rising[1:] != rising[:-1], size=size, fill_value=points)
    has_turn = cell < points
    lower = theta[jnp.minimum(cell, points - 2)]
    inner = _polish(q, lower, jnp.pi / points)
    end = start + jnp.pi
    return jnp.concatenate([start[None], jnp.where(has_turn, inner, end), end[None]])


def _polish(
    q: Complex[Array, " harmonic"], lower: Float[Array, " turn"], width: float
) -> Float[Array, " turn"]:
    """Return the zero of y' in each cell of a grid, by bisection and then by Newton steps."""
    fixed = stop_gradient(q)
    sign = jnp.sign(synthesis(fixed, lower, 1))

    def halve(i: Array, lower: Array) -> Array:
        half = width * 0.5 ** (i + 1.0)
        return lower + jnp.where(sign * synthesis(fixed, lower + half, 1) > 0.0, half, 0.0)

    angle = jax.lax.fori_loop(0, _NUM_HALVINGS, halve, lower)
    angle = stop_gradient(flatter(fixed, angle))
    return flatter(q, angle)


def _turning_states(
    q: Complex[Array, " harmonic"], delta: Scalar, gamma: Scalar, max_turns: int
) -> tuple[Any, Float[Array, " turn"], Float[Array, " turn"], Float[Array, " turn"]]:
    """Return the parameters of z/alpha, the turning points, and y and z/alpha at each of them."""
    law: Any = _UnitLaw(jnp.ones_like(delta), delta, gamma)
    turns = turning_angles(q, max_turns)
    y = synthesis(q, turns)
    y = y.at[-1].set(-y[0])

    def path(law: Hysteresis, y: Array, z: Array) -> Array:
        def move(z: Array, dy: Array) -> tuple[Array, Array]:
            after = hysteresis_map(law, z, dy)
            return after, after

        return jnp.append(z, jax.lax.scan(move, z, jnp.diff(y))[1])

    def newton(law: Hysteresis, y: Array, z: Array) -> Array:
        (end, slope) = jax.jvp(lambda z: path(law, y, z)[-1], (z,), (jnp.ones_like(z),))
        return z - (end + z) / (1.0 + slope)

    fixed = stop_gradient((law, y))
    z = y[0] - opening(y[0], law.delta, law.gamma)
    z = jax.lax.fori_loop(0, _NUM_PERIODICITY, lambda _, z: newton(*fixed, z), stop_gradient(z))
    # These two steps do not change the value of the solution; they make its first and second
    # derivatives correct.
    z = newton(law, y, newton(law, y, stop_gradient(z)))
    return law, turns, y, path(law, y, z)


def _zeros(
    q: Complex[Array, " harmonic"],
    turns: Float[Array, " turn"],
    y_turn: Float[Array, " turn"],
    z_turn: Float[Array, " turn"],
    law: Hysteresis,
) -> Float[Array, " segment"]:
    """Return the angle at which z vanishes between successive turning points, or their midpoint."""
    q, turns, y_turn, z_turn, law = stop_gradient((q, turns, y_turn, z_turn, law))
    lower, upper = turns[:-1], turns[1:]
    direction = jnp.sign(y_turn[1:] - y_turn[:-1])
    distance = -psi(law.gamma - law.delta, direction * z_turn[:-1])
    target = y_turn[:-1] + direction * distance
    crosses = z_turn[:-1] * z_turn[1:] < 0.0
    middle = 0.5 * (lower + upper)

    def halve(_: int, bounds: tuple[Array, Array]) -> tuple[Array, Array]:
        lower, upper = bounds
        half = 0.5 * (lower + upper)
        before = direction * (synthesis(q, half) - target) < 0.0
        return jnp.where(before, half, lower), jnp.where(before, upper, half)

    lower, upper = jax.lax.fori_loop(0, _NUM_HALVINGS, halve, (lower, upper))
    return jnp.where(crosses, 0.5 * (lower + upper), middle)


class _UnitLaw(NamedTuple):
    """The Bouc-Wen parameters of z/alpha, for which alpha = 1."""

    alpha: Scalar
    delta: Scalar
    gamma: Scalar

    @property
    def nu(self) -> float:
        """The exponent, 1; it is not a leaf of the pytree."""
        return 1.0
