r"""Derivatives of the solve for laws whose memory is a stack of reversals, such as Masing's.

Tangents are carried by y, v, the memories of other laws and the reversals; the rest of a branch
follows from these. The tangents of all states solve a linear system,

$$\dot x_0 = \dot x(0), \qquad
  \dot x_{n+1} = J_n \dot x_n + K_n \dot\theta + P_n \dot p_n,$$

forward in time for `jax.jvp`, its transpose backward for `jax.grad`: the derivative of one step
after the other, each at the state that the solve has saved. A step without a kink leaves the
reversals as they are, so that its derivative is short; the long one is taken where there is a kink.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jbw.oscillator.parameters import Scalar
from jbw.oscillator.solver import Pushed
from jbw.oscillator.step import ExactStep, Kinks, Push, State, advance, meets_kink

Laws = tuple[Any, ...]  # those that stack say more than a `Law`
Trajectory = tuple[Float[Array, " time"], Float[Array, " time"], Any]


class Carriers(NamedTuple):
    """The variables whose tangents are carried from step to step.

    Attributes:
        heads: y, v and the memories of laws without a stack.
        columns: Displacements and forces of the reversals, an array each.
    """

    heads: tuple[Scalar, ...]
    columns: tuple[Float[Array, " place"], ...]


class _Steps(NamedTuple):
    """Linearisation points of all steps: states, pushes and kinks."""

    starts: State
    push: Push
    kinked: Bool[Array, " step"]


class _Tangents(NamedTuple):
    """Unknowns of the linear system, and its right-hand side."""

    x: Carriers  # at every state
    step: ExactStep
    push: Push


def tangent(
    stepping: Pushed, trajectory: Trajectory, stepping_dot: Pushed, initial_dot: State
) -> Trajectory:
    """Tangent of the trajectory, by the constants and pushes of its steps."""
    laws: Laws = stepping.step.laws
    before, after = _but_last(trajectory), _but_first(trajectory)
    kinked = jax.vmap(partial(_kinked, stepping.step))(before, after, stepping.push)
    steps = _Steps(before, stepping.push, kinked)
    right_hand_side = _right_hand_side(
        _split(laws, initial_dot), stepping_dot, num_states=trajectory[0].shape[0]
    )
    x_dot = jax.lax.custom_linear_solve(
        partial(_system, stepping.step, steps),
        right_hand_side,
        lambda _, b: _lanes_apart(_forward)((stepping.step, steps), b),
        lambda _, c: _lanes_apart(_backward)((stepping.step, steps), c),
    ).x

    def full_tangent(state, x, x_dot):
        primals, tangents = (laws, x), (stepping_dot.step.laws, x_dot)
        return jax.jvp(lambda laws, x: _joined(laws, state, x), primals, tangents)[1]

    return jax.vmap(full_tangent)(trajectory, jax.vmap(partial(_split, laws))(trajectory), x_dot)


def _kinked(step: ExactStep, before: State, after: State, push: Push) -> Bool[Array, ""]:
    """Whether the solve has taken a step through a kink."""
    kinked = meets_kink(step, before, push)
    laws: Laws = step.laws
    for law, a, b in zip(laws, before[2], after[2], strict=True):
        if law.stacks:  # to rounding `meets_kink` may see another side of a kink
            kinked = kinked | law.turned_or_closed(a, b)
    return kinked


# -- the linear system -----------------------------------------------------------------------------
def _right_hand_side(first: Carriers, stepping_dot: Pushed, num_states: int) -> _Tangents:
    """Tangents of the start, of the step's constants and of the pushes."""
    step, push = stepping_dot.step, stepping_dot.push
    # JAX transposes a linear solve where all of its right-hand side depends on what is transposed.
    leaves = jax.tree.leaves((first, step, tuple(p[0] for p in push)))
    none = 0.0 * sum(jnp.sum(x) for x in leaves)
    return _Tangents(
        jax.tree.map(lambda x: jnp.zeros((num_states, *x.shape)).at[0].set(x + none), first),
        jax.tree.map(lambda x: x + none, step),
        tuple(p.at[0].add(none) for p in push),
    )


def _system(step: ExactStep, steps: _Steps, unknown: _Tangents) -> _Tangents:
    """The system's left-hand side."""
    advanced = jax.vmap(partial(_after, step), (0, 0, None, 0))(
        steps, _but_last(unknown.x), unknown.step, unknown.push
    )
    return unknown._replace(x=jax.tree.map(lambda x, y: x.at[1:].add(-y), unknown.x, advanced))


def _forward(at: tuple[ExactStep, _Steps], b: _Tangents) -> _Tangents:
    """Solution of the system, forward in time."""
    step, steps = at

    def onward(x, inputs):
        point, push_dot, more = inputs
        x = _sum(_after(step, point, x, b.step, push_dot), more)
        return x, x

    first = jax.tree.map(lambda x: x[0], b.x)
    _, following = jax.lax.scan(onward, first, (steps, b.push, _but_first(b.x)))
    return b._replace(x=jax.tree.map(lambda a, x: jnp.concatenate([a[None], x]), first, following))


def _backward(at: tuple[ExactStep, _Steps], c: _Tangents) -> _Tangents:
    """Solution of the transposed system, backward in time."""
    step, steps = at

    def back(carried, inputs):
        x, step_bar = carried
        point, push_bar, more = inputs
        x, by_step, by_push = _before(step, point, x)
        x = _sum(x, more)
        return (x, _sum(step_bar, by_step)), (x, _sum(push_bar, by_push))

    last = jax.tree.map(lambda x: x[-1], c.x)
    (_, step_bar), (earlier, push_bar) = jax.lax.scan(
        back, (last, c.step), (steps, c.push, _but_last(c.x)), reverse=True
    )
    x = jax.tree.map(lambda a, x: jnp.concatenate([x, a[None]]), last, earlier)
    return _Tangents(x, step_bar, push_bar)


def _lanes_apart(solve: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """The same solve; under vmap one lane after another, but many right-hand sides at once.

    Lanes side by side take the long derivative of a kink always.
    """
    sequential = jax.custom_batching.custom_vmap(solve)

    @sequential.def_vmap
    def _(size, batched, at, b):
        if not any(jax.tree.leaves(batched[0])):
            axes = jax.tree.map(lambda is_batched: 0 if is_batched else None, batched[1])
            solved = _lanes_apart(jax.vmap(solve, (None, axes)))(at, b)
        else:
            spread = jax.tree.map(
                lambda x, is_batched: x if is_batched else jnp.broadcast_to(x, (size, *x.shape)),
                (at, b), tuple(batched),
            )  # fmt: skip
            solved = jax.lax.map(lambda lane: _lanes_apart(solve)(*lane), spread)
        return solved, jax.tree.map(lambda _: True, solved)

    return sequential


# -- one step --------------------------------------------------------------------------------------
def _after(
    step: ExactStep, at: Any, x_dot: Carriers, step_dot: ExactStep, push_dot: Push
) -> Carriers:
    """Tangent of the state after a step."""
    primals, tangents = (step, _split(step.laws, at.starts), at.push), (step_dot, x_dot, push_dot)

    def by(kinks: Kinks):
        return jax.jvp(partial(_stepped, kinks, at.starts), primals, tangents)[1]

    return jax.lax.cond(at.kinked, lambda: by("always"), lambda: by("never"))


def _before(step: ExactStep, at: Any, x_bar: Carriers) -> tuple[Carriers, ExactStep, Push]:
    """Cotangents of the state before a step, of its constants and of its push."""
    primals = step, _split(step.laws, at.starts), at.push

    def by(kinks: Kinks):
        by_step, by_x, by_push = jax.vjp(partial(_stepped, kinks, at.starts), *primals)[1](x_bar)
        return by_x, by_step, by_push

    return jax.lax.cond(at.kinked, lambda: by("always"), lambda: by("never"))


def _stepped(kinks: Kinks, start: State, step: ExactStep, x: Carriers, push: Push) -> Carriers:
    """The carriers after a step."""
    return _split(step.laws, advance(step, _joined(step.laws, start, x), push, kinks=kinks))


def _split(laws: Laws, state: State) -> Carriers:
    """The carriers of a state."""
    y, v, memory = state
    heads, columns = [jnp.asarray(y), jnp.asarray(v)], []
    for law, law_memory in zip(laws, memory, strict=True):
        if law.stacks:
            columns.extend(jnp.asarray(column) for column in law.stack_columns(law_memory))
        else:
            heads.extend(jax.tree.leaves(law_memory))
    return Carriers(tuple(heads), tuple(columns))


def _joined(laws: Laws, state: State, x: Carriers) -> State:
    """A state with these carriers; everything else follows from them."""
    (y, v, *heads), columns = x.heads, list(x.columns)
    memory = []
    for law, law_memory in zip(laws, state[2], strict=True):
        if law.stacks:
            pair = tuple(columns.pop(0) for _ in law.stack_columns(law_memory))
            memory.append(law.with_columns(y, law_memory, pair))
        else:
            leaves, tree = jax.tree.flatten(law_memory)
            memory.append(jax.tree.unflatten(tree, [heads.pop(0) for _ in leaves]))
    return y, v, tuple(memory)


def _but_last(states: Any) -> Any:
    return jax.tree.map(lambda x: x[:-1], states)


def _but_first(states: Any) -> Any:
    return jax.tree.map(lambda x: x[1:], states)


def _sum(a: Any, b: Any) -> Any:
    return jax.tree.map(jnp.add, a, b)
