r"""Steady response to a periodic record: the fixed point of one period's map, by Newton.

A period of many cycles forgets nearly all of its start, and is marched. A short one is a trap: its
hysteresis forgets only by a few per cent a period at small amplitude. Newton settles it, with the
map's slope by differences: a few runs of the solve that is compiled anyway, where exact tangents
are a second program, four times as long to compile.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

MAX_ITERATIONS = 400
_PATIENCE, _PROGRESS = 20, 0.9  # rounds in which the gap falls by a tenth, or no end is in sight
_DIFFERENCE = 1e-7  # of the state, for its slope; less than this the slope does not know
_SLOW = 1e-2  # m/s, of which the difference is the part at rest
_NOTHING = 1e-14  # of the largest of the state
_TOLERANCE = 1e-12  # rounding over a long period leaves a few parts in 1e13
_NEWTON_STEPS = 4  # that a steady state takes, about


def steady_period(
    period: Callable[[Any], Any], guess: Any, unit: Any, *, one_by_one: bool = False
) -> tuple[Any, Float[Array, ""]]:
    """Trajectory over the period that ends where it starts.

    States are pytrees of scalars, of one mode or several.
    Newton's step is tried and taken where it leaves less of the gap; else one period is marched.
    Derivatives of the result come from the implicit function, exact.
    `unit` makes the leaves of the state comparable with a velocity, and is zero for what counts up
    for ever and need not come back; the residual is what the state still changes, relative to its
    largest value. Under vmap, states settle `one_by_one` where that is asked for.
    """
    _, tree = jax.tree.flatten(guess)
    units = jax.lax.stop_gradient(jnp.stack([jnp.asarray(x) for x in jax.tree.leaves(unit)]))

    def state(x):
        return jax.tree.unflatten(tree, list(x / jnp.where(units > 0.0, units, 1.0)))

    def packed(state):
        return units * jnp.stack([jnp.asarray(leaf) for leaf in jax.tree.leaves(state)])

    def gap(x):
        return packed(jax.tree.map(lambda leaf: leaf[-1], period(state(x)))) - x

    settle = _settle_one_by_one if one_by_one else _settle
    start = jax.lax.custom_root(gap, packed(guess), settle, _solve_linear)
    trajectory = period(state(start))
    leaves = jnp.stack(jax.tree.leaves(trajectory))
    scale = units * jnp.max(jnp.abs(leaves), axis=1)
    change = units * jnp.abs(leaves[:, -1] - leaves[:, 0])
    # Unused entries of a memory hold round-off, all of which may change.
    nothing = change <= _NOTHING * jnp.max(scale)
    residual = jnp.max(jnp.where(nothing, 0.0, change) / jnp.where(nothing, 1.0, scale))
    return jax.tree.map(lambda x: x[:-1], trajectory), jax.lax.stop_gradient(residual)


def _settle_one_by_one(gap: Callable, x: Float[Array, " state"]) -> Float[Array, " state"]:
    """The same, under vmap one point after another.

    Side by side all are solved again until the last has settled.
    """
    of_all, hidden = jax.closure_convert(gap, x)  # vmap must see every value that differs by lane

    @jax.custom_batching.sequential_vmap
    def settled(x, *hidden):
        return _settle(lambda x: of_all(x, *hidden), x)

    return settled(x, *hidden)


def _settle(gap: Callable, x: Float[Array, " state"]) -> Float[Array, " state"]:
    r"""Root of the gap: by marching while that pays, then by Newton's steps, where these lead.

    Each period marched multiplies the gap by some $\rho$, and costs 1; a Newton step of n numbers
    costs n + 1, and four of them do: marching costs less where $\rho^{4(n + 1)}$ is the tolerance.
    The map stands in the loop once: a solver in time is long to compile. A motion that comes to no
    period, as laws have that feed it, is given up.
    """
    pays = _TOLERANCE ** (1.0 / (_NEWTON_STEPS * (x.size + 1)))

    def unsettled(carry):
        x, rest, *_, idle, count = carry
        done = (_norm(rest) <= _TOLERANCE * _norm(x)) | jnp.isnan(_norm(rest))
        return (count < MAX_ITERATIONS) & (idle < _PATIENCE) & ~done

    def improve(carry):
        x, rest, tried, sloped, is_newton, least, idle, count = carry
        tried_gap, slope = _value_and_slope(gap, tried, sloped)
        accepted = ~is_newton | (_norm(tried_gap) < _norm(rest))
        marching = ~sloped & (_norm(tried_gap) <= pays * _norm(rest))
        x, rest = jnp.where(accepted, tried, x), jnp.where(accepted, tried_gap, rest)
        is_newton = accepted & sloped
        step = jax.lax.cond(is_newton, lambda: -_solved(slope, tried_gap), lambda: rest)
        nearer = _norm(rest) < _PROGRESS * least
        least, idle = jnp.where(nearer, _norm(rest), least), jnp.where(nearer, 0, idle + 1)
        return x, rest, x + step, ~marching, is_newton, least, idle, count + 1

    nowhere, no = jnp.full_like(x, jnp.inf), jnp.asarray(False)
    begun = x, nowhere, x, no, no, jnp.inf, 0, 0
    return jax.lax.while_loop(unsettled, improve, begun)[0]


def _value_and_slope(
    gap: Callable, x: Float[Array, " state"], sloped: Bool[Array, ""]
) -> tuple[Float[Array, " state"], Float[Array, "state state"]]:
    """The gap and, where `sloped`, its slope by differences, one column after another.

    Newton's steps outdo the slope's error in the next round.
    """
    size = _DIFFERENCE * (_norm(x) + _SLOW)
    points = jnp.concatenate([x[None], x + size * jnp.eye(x.size)])

    def more(i, values):
        return values.at[i].set(gap(points[i]))

    values = jax.lax.fori_loop(0, jnp.where(sloped, len(points), 1), more, jnp.zeros_like(points))
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
