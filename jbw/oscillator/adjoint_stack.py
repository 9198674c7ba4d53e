r"""Derivatives of the solve where a law remembers a stack of its past, as Masing's laws do.

A step makes at most one new entry of a stack and only moves the old ones. So of its Jacobian four
rows are found, for y, v and the two numbers of the newest entry; all others are a shuffle.
The rows are found by reverse mode, for many steps at once; the recurrence that multiplies them is
linear in the tangents, so that JAX transposes it for `jax.grad`.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jbw.oscillator.kinks import kept
from jbw.oscillator.parameters import Scalar
from jbw.oscillator.solver import Stepping
from jbw.oscillator.step import ExactStep, Push, State, advance

Laws = tuple[Any, ...]  # those that stack say more than a `Law`
Trajectory = tuple[Float[Array, " time"], Float[Array, " time"], Any]
# y, v, other laws' memories, and the columns of the laws' stacks, an array each.
Heads = tuple[Scalar, ...]
Columns = tuple[Float[Array, " place"], ...]
_CHUNK = 128


def tangent(
    stepping: Stepping, trajectory: Trajectory, stepping_dot: Stepping, initial_dot: State
) -> Trajectory:
    """Tangent of the trajectory: chunks of steps one after another."""
    laws: Laws = stepping.step.laws
    num_steps = trajectory[0].shape[0] - 1
    size = min(_CHUNK, num_steps)

    def chunks(x):
        return jnp.pad(x, (0, -num_steps % size)).reshape(-1, size)

    before, after = (
        jax.tree.map(lambda x, part=part: x[part], trajectory[2])
        for part in (slice(None, -1), slice(1, None))
    )
    moves = tuple(
        law.stack_move(a, b) for law, a, b in zip(laws, before, after, strict=True) if law.stacks
    )
    starts = jax.tree.map(lambda x: chunks(x[:-1]), trajectory)
    push, push_dot = (tuple(chunks(p) for p in s.push) for s in (stepping, stepping_dot))
    step_dot = jax.tree.map(lambda x: jnp.broadcast_to(x, (size,)), stepping_dot.step)

    @jax.checkpoint
    def chunk(x_dot, inputs):
        starts, push, push_dot, moves = inputs
        linearised = jax.vmap(partial(_linearised, stepping.step))
        rows, offset = linearised(starts, push, step_dot, push_dot)
        return jax.lax.scan(_recurrence, x_dot, (rows, offset, moves))

    first = _split(laws, initial_dot)
    _, following = jax.lax.scan(chunk, first, (starts, push, push_dot, jax.tree.map(chunks, moves)))
    x_dot = jax.tree.map(
        lambda a, b: jnp.concatenate([a[None], b.reshape(-1, *a.shape)[:num_steps]]),
        first,
        following,
    )

    def whole(laws, state, x):
        return _joined(laws, state, x)

    laws_dot = stepping_dot.step.laws
    return jax.vmap(
        lambda state, x, x_dot: jax.jvp(
            lambda laws, x: whole(laws, state, x), (laws, x), (laws_dot, x_dot)
        )[1]
    )(trajectory, jax.vmap(partial(_split, laws))(trajectory), x_dot)


def _split(laws: Laws, state: State) -> tuple[Heads, Columns]:
    """What derivatives travel by: scalars, and the stacks' columns."""
    y, v, memory = state
    heads, columns = [jnp.asarray(y), jnp.asarray(v)], []
    for law, own in zip(laws, memory, strict=True):
        if law.stacks:
            columns.extend(jnp.stack(column) for column in law.stack_columns(own))
        else:
            heads.extend(jax.tree.leaves(own))
    return tuple(heads), tuple(columns)


def _joined(laws: Laws, state: State, x: tuple[Heads, Columns]) -> State:
    """A state with these derivatives' carriers, all else found from them."""
    (y, v, *heads), columns = x[0], list(x[1])
    memory = []
    for law, own in zip(laws, state[2], strict=True):
        if law.stacks:
            pair = tuple(tuple(columns.pop(0)) for _ in law.stack_columns(own))
            memory.append(law.with_columns(y, own, pair))
        else:
            leaves, tree = jax.tree.flatten(own)
            memory.append(jax.tree.unflatten(tree, [heads.pop(0) for _ in leaves]))
    return y, v, tuple(memory)


def _linearised(
    step: ExactStep, start: State, push: Push, step_dot: ExactStep, push_dot: Push
) -> tuple[Any, Any]:
    """Rows of the Jacobian of what a step makes anew, and their offsets."""
    carriers = _split(step.laws, start)

    def stepped(step, x, push):
        state = advance(step, _joined(step.laws, start, x), push, branch=False)
        heads, columns = _split(step.laws, state)
        return heads, tuple(column[0] for column in columns)

    found, pull = jax.vjp(lambda x: stepped(step, x, push), carriers)
    made, tree = jax.tree.flatten(found)
    none = [jnp.zeros_like(x) for x in made]
    rows = [
        kept(pull(jax.tree.unflatten(tree, [*none[:i], jnp.ones_like(x), *none[i + 1 :]]))[0])
        for i, x in enumerate(made)
    ]
    _, offset = jax.jvp(
        lambda step, push: stepped(step, carriers, push), (step, push), (step_dot, push_dot)
    )
    return jax.tree.unflatten(tree, rows), offset


def _recurrence(x_dot: tuple[Heads, Columns], inputs: Any) -> tuple[Any, Any]:
    """One step of the tangents: the rows' products, and the stacks' entries moved."""
    (head_rows, top_rows), (head_offsets, top_offsets), moves = inputs
    heads, columns = x_dot

    def product(row, offset):
        ahead = sum(a * x for a, x in zip(row[0], heads, strict=True))
        return offset + ahead + sum(jnp.dot(a, x) for a, x in zip(row[1], columns, strict=True))

    after = tuple(product(*pair) for pair in zip(head_rows, head_offsets, strict=True))
    tops = [product(*pair) for pair in zip(top_rows, top_offsets, strict=True)]
    shuffled = tuple(
        _shuffled(column, top, *moves[i // 2])
        for i, (column, top) in enumerate(zip(columns, tops, strict=True))
    )
    x_dot = after, shuffled
    return x_dot, x_dot


def _shuffled(
    column: Float[Array, " place"], top: Scalar, places: Scalar, full: Scalar
) -> Float[Array, " place"]:
    """Entries moved to the front by a number of places, which may be -1, below the newest one."""
    size = column.shape[0]

    def moved():
        entries = jnp.concatenate([jnp.zeros(1), column])
        left = places + 1.0
        step = 2 ** size.bit_length()
        while step:
            if step < size + 1:
                far = left > step - 0.5
                ahead = jnp.concatenate([entries[step:], jnp.zeros(step)])
                entries = jnp.where(far, ahead, entries)
                left = left - jnp.where(far, float(step), 0.0)
            step //= 2
        none = jnp.zeros(1)
        short = jnp.concatenate([none, column[: size - 4], column[size - 2 :], none])
        return jnp.where(full > 0.5, short, entries[:size])

    rest = jax.lax.cond(places != 0.0, moved, lambda: column)
    return jnp.concatenate([jnp.asarray(top)[None], rest[1:]])
