r"""Steady response to a periodic record: the fixed point of one period's map, by Newton.

Marching until nothing changes is a trap: the hysteresis forgets only by a few per cent a period
at small amplitude. Newton settles it, with the map's slope by differences: a few lanes of the solve
that is compiled anyway, where exact tangents are a second program, four times as long to compile.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

MAX_ITERATIONS = 400
_DIFFERENCE = 1e-7  # of the state, for its slope; less than this the slope does not know
_SLOW = 1e-2  # m/s, of which the difference is the part at rest
_NOTHING = 1e-14  # of the largest of the state
_TOLERANCE = 1e-12  # rounding over a long period leaves a few parts in 1e13


def steady_period(
    period: Callable[[Any], Any], guess: Any, unit: Any
) -> tuple[Any, Float[Array, ""]]:
    """Trajectory over the period that ends where it starts.

    States are pytrees of scalars, of one mode or several.
    Newton's step is tried and taken where it leaves less of the gap; else one period is marched.
    Derivatives of the result come from the implicit function, exact.
    `unit` makes the leaves of the state comparable with a velocity; the residual is what the state
    still changes, relative to its largest value.
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
    scale = units * jnp.max(jnp.abs(leaves), axis=1)
    change = units * jnp.abs(leaves[:, -1] - leaves[:, 0])
    # What a memory holds in places that it does not use is round-off, of which all may change.
    scale = jnp.maximum(scale, _NOTHING * jnp.max(scale))
    residual = jnp.max(change / jnp.where(scale > 0.0, scale, 1.0))
    return jax.tree.map(lambda x: x[:-1], trajectory), jax.lax.stop_gradient(residual)


def _settle(gap: Callable, x: Float[Array, " state"]) -> Float[Array, " state"]:
    """Root of the gap by Newton's steps, and by marching where one leads no nearer.

    The map stands in the loop once: a solver in time is long to compile.
    """

    def unsettled(carry):
        x, rest, *_, count = carry
        return (count < MAX_ITERATIONS) & ~(_norm(rest) <= _TOLERANCE * _norm(x))

    def improve(carry):
        x, rest, tried, is_newton, count = carry
        left, slope = _value_and_slope(gap, tried)
        taken = ~is_newton | (_norm(left) < _norm(rest))
        x, rest = jnp.where(taken, tried, x), jnp.where(taken, left, rest)
        following = jnp.where(taken, tried - _solved(slope, left), x + rest)
        return x, rest, following, taken, count + 1

    nowhere = jnp.full_like(x, jnp.inf)
    return jax.lax.while_loop(unsettled, improve, (x, nowhere, x, jnp.asarray(False), 0))[0]


def _value_and_slope(
    gap: Callable, x: Float[Array, " state"]
) -> tuple[Float[Array, " state"], Float[Array, "state state"]]:
    """The gap and its slope by differences, which Newton's steps outdo in the next round."""
    size = _DIFFERENCE * (_norm(x) + _SLOW)
    values = jax.vmap(gap)(jnp.concatenate([x[None], x + size * jnp.eye(x.size)]))
    return values[0], (values[1:] - values[0]).T / size


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
    if y.size <= 3:
        return jnp.linalg.solve(matrix, y)
    return jnp.linalg.pinv(matrix, rtol=_DIFFERENCE) @ y


def _norm(x: Float[Array, " state"]) -> Float[Array, ""]:
    return jnp.max(jnp.abs(x))
