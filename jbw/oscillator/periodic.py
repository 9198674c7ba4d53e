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
from jbw.oscillator.step import State

MAX_ITERATIONS = 200
_FORGETS = 0.1  # of the gap left by one period: marching is then cheaper than Newton
_TOLERANCE = 1e-12  # rounding over a long period leaves a few parts in 1e13


def steady_period(
    period: Callable[[State], Trajectory], guess: State, unit: State
) -> tuple[Trajectory, Float[Array, ""]]:
    """Trajectory over the period that ends where it starts.

    One period is marched; where that leaves more than a tenth of the gap, Newton's step is tried,
    with the map's exact derivative, and kept where it is the better of the two. Derivatives
    of the result come from the implicit function. `unit` makes the leaves of the state comparable
    with a velocity; the residual is what the state still changes, relative to its largest value.
    """
    _, tree = jax.tree.flatten(guess)
    units = jax.lax.stop_gradient(jnp.stack([jnp.asarray(x) for x in jax.tree.leaves(unit)]))

    def state(x):
        return jax.tree.unflatten(tree, list(x / units))

    def packed(state):
        return units * jnp.stack([jnp.asarray(leaf) for leaf in jax.tree.leaves(state)])

    def gap(x):
        return packed(jax.tree.map(lambda leaf: leaf[-1], period(state(x)))) - x

    start = jax.lax.custom_root(gap, packed(guess), _settle, _solve_linear)
    trajectory = period(state(start))
    leaves = jnp.stack(jax.tree.leaves(trajectory))
    scale = jnp.max(jnp.abs(leaves), axis=1)
    change = jnp.abs(leaves[:, -1] - leaves[:, 0])
    residual = jnp.max(change / jnp.where(scale > 0.0, scale, 1.0))
    return jax.tree.map(lambda x: x[:-1], trajectory), jax.lax.stop_gradient(residual)


def _settle(gap: Callable, x: Float[Array, " state"]) -> Float[Array, " state"]:
    """Root of the gap by marching where a period forgets most, by Newton otherwise."""

    def unsettled(carry):
        x, rest, count = carry
        return (count < MAX_ITERATIONS) & ~(_norm(rest) <= _TOLERANCE * _norm(x))

    def improve(carry):
        x, rest, count = carry
        marched, left = x + rest, gap(x + rest)

        def newton():
            tried = x - _solved(jax.jacfwd(gap)(x), rest)
            tried_left = gap(tried)
            nearer = _norm(tried_left) < _norm(left)
            return jnp.where(nearer, tried, marched), jnp.where(nearer, tried_left, left)

        forgets = _norm(left) < _FORGETS * _norm(rest)
        x, rest = jax.lax.cond(forgets, lambda: (marched, left), newton)
        return x, rest, count + 1

    return jax.lax.while_loop(unsettled, improve, (x, gap(x), 0))[0]


def _solve_linear(linear: Callable, y: Float[Array, " state"]) -> Float[Array, " state"]:
    """Solution of a linear function of a few numbers, its matrix column by column."""
    matrix = jnp.stack([linear(column) for column in jnp.eye(y.size)], axis=1)
    return _solved(matrix, y)


def _solved(
    matrix: Float[Array, "state state"], y: Float[Array, " state"]
) -> Float[Array, " state"]:
    """Solution of a small system; the shortest where memories that never change make it singular.

    One memory, of a law that always relaxes, leaves a regular system.
    """
    return jnp.linalg.solve(matrix, y) if y.size <= 3 else jnp.linalg.pinv(matrix) @ y


def _norm(x: Float[Array, " state"]) -> Float[Array, ""]:
    return jnp.max(jnp.abs(x))
