r"""Steady response to a periodic record: the fixed point of one period's map, by Newton.

Marching until nothing changes is a trap: the hysteresis forgets only by a few per cent a period
at small amplitude. The map's derivative is at hand from the solve, so Newton settles it.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jbw.oscillator.adjoint import Trajectory
from jbw.oscillator.exact_step import State
from jbw.oscillator.parameters import Scalar

MAX_ITERATIONS = 200
_TOLERANCE = 1e-13


def steady_period(
    period: Callable[[State], Trajectory], guess: State, omega_n: Scalar
) -> tuple[Trajectory, Float[Array, ""]]:
    """Trajectory over the period that ends where it starts.

    Newton with the map's exact 3 x 3 derivative; a step that does not bring the state nearer to
    itself is replaced by marching one period, which always contracts. Derivatives of the result
    come from the implicit function, to first order.

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
    settled = _newton(_detached(gap, unit * jnp.stack(guess)), unit * jnp.stack(guess))
    # A Newton step from the root moves nothing, but carries the implicit function's derivative.
    matrix = jax.lax.stop_gradient(jax.jacfwd(gap)(settled))
    start = settled - jnp.linalg.solve(matrix, gap(settled))
    trajectory = jnp.stack(period(tuple(start / unit)))
    scale = jnp.max(jnp.abs(trajectory), axis=1)
    change = jnp.abs(trajectory[:, -1] - trajectory[:, 0])
    residual = jnp.max(change / jnp.where(scale > 0.0, scale, 1.0))
    return tuple(trajectory[:, :-1]), jax.lax.stop_gradient(residual)  # pyright: ignore


def _newton(gap: Callable, x: Float[Array, "3"]) -> Float[Array, "3"]:
    """Root of the gap by Newton, safeguarded by marching."""

    def unsettled(carry):
        x, rest, count = carry
        return (count < MAX_ITERATIONS) & ~(_norm(rest) <= _TOLERANCE * _norm(x))

    def improve(carry):
        x, rest, count = carry
        newton = x - jnp.linalg.solve(jax.jacfwd(gap)(x), rest)
        newton_rest = gap(newton)
        marched = x + rest
        nearer = _norm(newton_rest) < _norm(rest)
        return jax.lax.cond(
            nearer,
            lambda: (newton, newton_rest, count + 1),
            lambda: (marched, gap(marched), count + 1),
        )

    return jax.lax.while_loop(unsettled, improve, (x, gap(x), 0))[0]


def _norm(x: Float[Array, "3"]) -> Float[Array, ""]:
    return jnp.max(jnp.abs(x))


def _detached(gap: Callable, x: Float[Array, "3"]) -> Callable:
    """The gap without derivatives in what it closes over: a while loop cannot transpose."""
    converted, constants = jax.closure_convert(gap, x)
    constants = jax.lax.stop_gradient(constants)
    return lambda x: converted(x, *constants)
