r"""Forward and reverse derivatives of a simulation whose time step follows the joint's law exactly.

The primal is the diffrax solve. Its states are saved at the samples, or at every substep where
derivatives are needed. The tangent needs no second solve: the derivatives of all steps at the saved
states are independent of each other and are computed for many steps at once; only the recurrence
$\dot x_{n+1} = J_n \dot x_n + b_n$ with its small matrices (3 x 3 with one memory) is sequential.
It is linear in the tangents, so JAX transposes it for `jax.grad`.

For laws whose memory is a stack of reversals, such as Masing's, tangents are carried by y, v, the
memories of the other laws and the reversals; all other quantities of a branch follow from these.
The tangents of all states solve a linear system,

$$\dot x_0 = \dot x(0), \qquad
  \dot x_{n+1} = J_n \dot x_n + K_n \dot\theta + P_n \dot p_n,$$

solved forward in time for `jax.jvp`, and its transpose backward for `jax.grad`: one step's
derivative after another, each at its saved state. A step without a kink leaves the reversals
unchanged, so its derivative is short; the long derivative is used only at a kink.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jbw.errors import ModelError
from jbw.oscillator.law import packed, unpacked
from jbw.oscillator.parameters import Scalar
from jbw.oscillator.solver import HysteresisExact, Pushed, Stepping
from jbw.oscillator.step import ExactStep, Kinks, Push, State, advance, meets_kink

# A `State` whose fields are arrays over time.
Trajectory = tuple[Float[Array, " time"], Float[Array, " time"], Any]
Columns = tuple[tuple[Scalar, ...], ...]
# Number of steps that are differentiated at once. It is so small that the intermediate arrays fit
# into the cache, and that the memory of a gradient does not grow with the record.
_CHUNK = 128
# Laws that remember load reversals have more methods than the protocol `Law`.
Laws = tuple[Any, ...]


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def solve(substeps: int, stepping: Stepping, initial: State) -> Trajectory:
    """Return the states at the samples, differentiable in the parameters and the initial state."""
    return unpacked(stepping.step.laws, _states(substeps, substeps, stepping, initial))


def _states(substeps: int, every: int, stepping: Stepping, initial: State) -> Trajectory:
    """Simulate a record; return the states after every `every` substeps, as arrays over time."""
    num_steps = stepping.num_steps
    carried = packed(stepping.step.laws, initial)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(unused_field),
        HysteresisExact(),
        t0=0.0,
        t1=num_steps / substeps,
        dt0=1.0 / substeps,
        y0=tuple(jax.tree.leaves(carried)),
        args=stepping,
        saveat=diffrax.SaveAt(t0=True, steps=every),
        adjoint=diffrax.ForwardMode(),
        max_steps=num_steps,
        throw=False,
    )
    leaves = [x[: num_steps // every + 1] for x in solution.ys]  # pyright: ignore
    return jax.tree.unflatten(jax.tree.structure(carried), leaves)


def unused_field(tau, state, stepping):
    """Return the state unchanged; diffrax requires a vector field, but the exact step uses none."""
    return state


@solve.defjvp
def _solve_jvp(substeps, primals, tangents):
    stepping, initial = primals
    if any(jnp.ndim(x) for x in jax.tree.leaves(initial)):
        raise ModelError(
            "A law whose internal state is an array, such as `iwan5`, has no derivatives in time.",
            why="The force of the law's elements drops at isolated instants, which change with "
            "the parameters.",
            remedy="Compute derivatives by finite differences, or use a law whose force has no "
            "drops, such as `iwan4`.",
        )
    trajectory = _states(substeps, 1, stepping, initial)
    laws = stepping.step.laws
    stacks = any(law.depth for law in laws)
    linearised = jax.vmap(_linearised, in_axes=(None, 0, 0, 0, 0))
    along = tangent_of_stacks if stacks else partial(in_chunks, linearised, _recurrence)
    stepping_dot, initial_dot = tangents
    pushed, pushed_dot = jax.jvp(Stepping.pushed, (stepping,), (stepping_dot,))
    trajectory_dot = along(pushed, trajectory, pushed_dot, initial_dot)
    sampled = jax.tree.map(lambda x: x[::substeps], (trajectory, trajectory_dot))
    return unpacked(laws, sampled[0]), unpacked(laws, sampled[1])


def in_chunks(
    linearised: Callable[..., Any],
    recurrence: Callable[..., Any],
    pushed: Pushed,
    trajectory: Any,
    pushed_dot: Pushed,
    initial_dot: Any,
) -> Any:
    """Compute the derivative of a trajectory in consecutive chunks of time steps.

    Args:
        linearised: Derivatives of many steps at their constants, starts and pushes, with the
            tangents of the constants (one copy per step) and of the pushes.
        recurrence: Body of the scan that advances the tangent of the state over these derivatives.
        pushed: Constants and pushes of all steps.
        trajectory: States before and after the steps.
        pushed_dot: Tangents of the constants and pushes.
        initial_dot: Tangent of the first state.
    """
    (step, push), (step_dot, push_dot) = pushed, pushed_dot
    num_steps = jax.tree.leaves(push)[0].shape[0]
    size = min(_CHUNK, num_steps)

    def chunks(x):
        return jnp.pad(x, (0, -num_steps % size)).reshape(-1, size)

    starts = jax.tree.map(lambda x: chunks(x[:-1]), trajectory)
    push, push_dot = jax.tree.map(chunks, (push, push_dot))
    # Every step gets its own copy of the constants, so that the transposed program sums their
    # derivatives over all steps once, and not in every step.
    step_dot = jax.tree.map(lambda x: jnp.broadcast_to(x, (size,)), step_dot)

    @jax.checkpoint
    def chunk(x_dot, inputs):
        starts, push, push_dot = inputs
        parts = linearised(step, starts, push, step_dot, push_dot)
        return jax.lax.scan(recurrence, x_dot, parts)

    _, ys = jax.lax.scan(chunk, initial_dot, (starts, push, push_dot))

    def joined(first, following):
        return jnp.concatenate([jnp.asarray(first)[None], following.reshape(-1)[:num_steps]])

    return jax.tree.map(joined, initial_dot, ys)


def _linearised(
    step: ExactStep, start: State, push: Push, step_dot: ExactStep, push_dot: Push
) -> tuple[Columns, tuple[Scalar, ...]]:
    """Return the derivatives of one time step: columns of its Jacobian J_n, and its offset b_n."""
    leaves, tree = jax.tree.flatten(start)

    def stepped(step, leaves, push):
        start = jax.tree.unflatten(tree, leaves)
        return tuple(jax.tree.leaves(advance(step, start, push, kinks="always")))

    none, unit = jnp.zeros_like(leaves[0]), jnp.ones_like(leaves[0])
    _, by_state = jax.linearize(lambda leaves: stepped(step, leaves, push), leaves)
    _, offset = jax.jvp(
        lambda step, push: stepped(step, leaves, push), (step, push), (step_dot, push_dot)
    )
    size = len(leaves)
    columns = (by_state([unit if i == j else none for i in range(size)]) for j in range(size))
    return tuple(columns), offset


def _recurrence(x_dot: State, inputs) -> tuple[State, State]:
    """Advance the derivative of a state by one step, from the columns of the step's Jacobian."""
    columns, offset = inputs
    leaves, tree = jax.tree.flatten(x_dot)
    after = [
        part + sum(column[i] * x for column, x in zip(columns, leaves, strict=True))
        for i, part in enumerate(offset)
    ]
    x_dot = jax.tree.unflatten(tree, after)
    return x_dot, x_dot


class Carriers(NamedTuple):
    """The variables whose derivatives pass from one time step to the next.

    Attributes:
        heads: y, v and the memories of laws without a stack.
        columns: Displacements and forces of the reversals, one array each.
    """

    heads: tuple[Scalar, ...]
    columns: tuple[Float[Array, " place"], ...]


class _Steps(NamedTuple):
    """The points about which all time steps are linearised: states, inputs and kinks."""

    starts: State
    push: Push
    kinked: Bool[Array, " step"]


class _Tangents(NamedTuple):
    """The unknowns of the linear system for the derivatives, or its right-hand side."""

    x: Carriers  # derivatives of the state at every step
    step: ExactStep
    push: Push


def tangent_of_stacks(
    pushed: Pushed, trajectory: Trajectory, pushed_dot: Pushed, initial_dot: State
) -> Trajectory:
    """Compute the derivative of a simulation whose laws remember load reversals."""
    step, push = pushed
    laws: Laws = step.laws
    before, after = _but_last(trajectory), _but_first(trajectory)
    kinked = jax.vmap(partial(_kinked, step))(before, after, push)
    steps = _Steps(before, push, kinked)
    right_hand_side = _right_hand_side(
        _split(laws, initial_dot), pushed_dot, num_states=trajectory[0].shape[0]
    )
    x_dot = jax.lax.custom_linear_solve(
        partial(_system, step, steps),
        right_hand_side,
        lambda _, b: _lanes_apart(_forward)((step, steps), b),
        lambda _, c: _lanes_apart(_backward)((step, steps), c),
    ).x

    def full_tangent(state, x, x_dot):
        primals, tangents = (laws, x), (pushed_dot[0].laws, x_dot)
        return jax.jvp(lambda laws, x: _joined(laws, state, x), primals, tangents)[1]

    return jax.vmap(full_tangent)(trajectory, jax.vmap(partial(_split, laws))(trajectory), x_dot)


def _kinked(step: ExactStep, before: State, after: State, push: Push) -> Bool[Array, ""]:
    """Return whether the simulation met a kink of a law in a given time step."""
    kinked = meets_kink(step, before, push)
    laws: Laws = step.laws
    for law, a, b in zip(laws, before[2], after[2], strict=True):
        # Because of rounding, `meets_kink` may place a motion just after a kink that it has not
        # reached yet.
        if law.depth:
            kinked = kinked | law.turned_or_closed(a, b)
    return kinked


# -- the linear system -----------------------------------------------------------------------------
def _right_hand_side(first: Carriers, pushed_dot: Pushed, num_states: int) -> _Tangents:
    """Return the right-hand side of the linear system for the derivatives."""
    step, push = pushed_dot
    # JAX transposes a linear solve only if its whole right-hand side depends on the input that is
    # transposed.
    leaves = jax.tree.leaves((first, step, tuple(p[0] for p in push)))
    none = 0.0 * sum(jnp.sum(x) for x in leaves)
    return _Tangents(
        jax.tree.map(lambda x: jnp.zeros((num_states, *x.shape)).at[0].set(x + none), first),
        jax.tree.map(lambda x: x + none, step),
        tuple(p.at[0].add(none) for p in push),
    )


def _system(step: ExactStep, steps: _Steps, unknown: _Tangents) -> _Tangents:
    """Return the left-hand side of the linear system for the derivatives."""
    advanced = jax.vmap(partial(_after, step), (0, 0, None, 0))(
        steps, _but_last(unknown.x), unknown.step, unknown.push
    )
    return unknown._replace(x=jax.tree.map(lambda x, y: x.at[1:].add(-y), unknown.x, advanced))


def _forward(at: tuple[ExactStep, _Steps], b: _Tangents) -> _Tangents:
    """Solve the linear system for the derivatives forward in time."""
    step, steps = at

    def onward(x, inputs):
        point, push_dot, more = inputs
        x = _sum(_after(step, point, x, b.step, push_dot), more)
        return x, x

    first = jax.tree.map(lambda x: x[0], b.x)
    _, following = jax.lax.scan(onward, first, (steps, b.push, _but_first(b.x)))
    return b._replace(x=jax.tree.map(lambda a, x: jnp.concatenate([a[None], x]), first, following))


def _backward(at: tuple[ExactStep, _Steps], c: _Tangents) -> _Tangents:
    """Solve the transposed linear system for the derivatives backward in time."""
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
    """Return a linear solver that takes a batch's oscillators in turn, each with all its loads.

    If the oscillators of a batch were solved side by side, the long derivative of a kink would be
    computed in every step of each.
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
    """Return the derivative of the state after a time step, from its derivative before the step."""
    primals, tangents = (step, _split(step.laws, at.starts), at.push), (step_dot, x_dot, push_dot)

    def by(kinks: Kinks):
        return jax.jvp(partial(_stepped, kinks, at.starts), primals, tangents)[1]

    return jax.lax.cond(at.kinked, lambda: by("always"), lambda: by("never"))


def _before(step: ExactStep, at: Any, x_bar: Carriers) -> tuple[Carriers, ExactStep, Push]:
    """Return reverse derivatives with respect to a step's initial state, constants and input."""
    primals = step, _split(step.laws, at.starts), at.push

    def by(kinks: Kinks):
        by_step, by_x, by_push = jax.vjp(partial(_stepped, kinks, at.starts), *primals)[1](x_bar)
        return by_x, by_step, by_push

    return jax.lax.cond(at.kinked, lambda: by("always"), lambda: by("never"))


def _stepped(kinks: Kinks, start: State, step: ExactStep, x: Carriers, push: Push) -> Carriers:
    """Advance by one time step the variables whose derivatives pass from step to step."""
    return _split(step.laws, advance(step, _joined(step.laws, start, x), push, kinks=kinks))


def _split(laws: Laws, state: State) -> Carriers:
    """Return those variables of a state whose derivatives pass from one time step to the next."""
    y, v, memory = state
    heads, columns = [jnp.asarray(y), jnp.asarray(v)], []
    for law, law_memory in zip(laws, memory, strict=True):
        if law.depth:
            columns.extend(jnp.asarray(column) for column in law.stack_columns(law_memory))
        else:
            heads.extend(jax.tree.leaves(law_memory))
    return Carriers(tuple(heads), tuple(columns))


def _joined(laws: Laws, state: State, x: Carriers) -> State:
    """Return the full state, from the variables that pass from one time step to the next."""
    (y, v, *heads), columns = x.heads, list(x.columns)
    memory = []
    for law, law_memory in zip(laws, state[2], strict=True):
        if law.depth:
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
