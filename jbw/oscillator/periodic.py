r"""Steady response to a periodic record: the fixed point of one period's map, by Newton.

Marching until nothing changes is a trap: the hysteresis forgets only by a few per cent a period
at small amplitude. Where a period of marching forgets most, it is the cheapest step; where it does
not, the map's derivative is at hand from the solve, and Newton settles it.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jbw.oscillator.adjoint import Trajectory
from jbw.oscillator.exact_step import State
from jbw.oscillator.parameters import Scalar

MAX_ITERATIONS = 200
_FORGETS = 0.1  # of the gap left by one period: marching is then cheaper than Newton
_TOLERANCE = 1e-12  # rounding over a long period leaves a few parts in 1e13


def steady_period(
    period: Callable[[State], Trajectory], guess: State, omega_n: Scalar
) -> tuple[Trajectory, Float[Array, ""]]:
    """Trajectory over the period that ends where it starts.

    One period is marched; where that leaves more than a tenth of the gap, Newton's step is tried,
    with the map's exact 3 x 3 derivative, and kept where it is the better of the two. Derivatives
    of the result come from the implicit function.

    Args:
        period: From a state at sample 0 to the states at all samples up to and including the
            first of the next period.
        guess: First guess of the state at sample 0.
        omega_n: Natural frequency, which makes y, v and z comparable [rad/s].

    Returns:
        The trajectory without its repeated last sample, and the residual: what the state still
        changes over the period, relative to the largest value in it.
    """

    def gap(x):
        end = jnp.stack([leaf[-1] for leaf in period(tuple(x / unit))])
        return unit * end - x

    # In units of velocity.
    unit = jax.lax.stop_gradient(jnp.stack([omega_n, jnp.ones_like(omega_n), 1.0 / omega_n]))
    start = jax.lax.custom_root(gap, unit * jnp.stack(guess), _settle, _solve_linear)
    trajectory = jnp.stack(period(tuple(start / unit)))
    scale = jnp.max(jnp.abs(trajectory), axis=1)
    change = jnp.abs(trajectory[:, -1] - trajectory[:, 0])
    residual = jnp.max(change / jnp.where(scale > 0.0, scale, 1.0))
    return tuple(trajectory[:, :-1]), jax.lax.stop_gradient(residual)  # pyright: ignore


def _settle(gap: Callable, x: Float[Array, "3"]) -> Float[Array, "3"]:
    """Root of the gap by marching where a period forgets most, by Newton otherwise."""

    def unsettled(carry):
        x, rest, count = carry
        return (count < MAX_ITERATIONS) & ~(_norm(rest) <= _TOLERANCE * _norm(x))

    def improve(carry):
        x, rest, count = carry
        marched, left = x + rest, gap(x + rest)

        def newton():
            tried = x - jnp.linalg.solve(jax.jacfwd(gap)(x), rest)
            tried_left = gap(tried)
            nearer = _norm(tried_left) < _norm(left)
            return jnp.where(nearer, tried, marched), jnp.where(nearer, tried_left, left)

        forgets = _norm(left) < _FORGETS * _norm(rest)
        x, rest = jax.lax.cond(forgets, lambda: (marched, left), newton)
        return x, rest, count + 1

    return jax.lax.while_loop(unsettled, improve, (x, gap(x), 0))[0]


def _solve_linear(linear: Callable, y: Float[Array, "3"]) -> Float[Array, "3"]:
    """Solution of a linear function of three numbers, its matrix column by column."""
    matrix = jnp.stack([linear(column) for column in jnp.eye(3)], axis=1)
    return jnp.linalg.solve(matrix, y)


def _norm(x: Float[Array, "3"]) -> Float[Array, ""]:
    return jnp.max(jnp.abs(x))
