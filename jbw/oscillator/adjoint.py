r"""Derivatives of the hysteresis-exact solve: one function for forward and reverse mode.

The primal is the diffrax solve, its states saved at the samples, or at every substep where
derivatives are asked for. The tangent needs no second solve: the derivatives of all steps at the
saved states are independent of each other and are taken for many steps at once; only the
recurrence $\dot x_{n+1} = J_n \dot x_n + b_n$ with its small matrices (3 x 3 with one memory) is
sequential. It is linear in the tangents, so JAX transposes it for `jax.grad`.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jbw.errors import ModelError
from jbw.oscillator import adjoint_stack
from jbw.oscillator.parameters import Scalar
from jbw.oscillator.solver import HysteresisExact, Pushed, Stepping
from jbw.oscillator.step import ExactStep, Push, State, advance

# A `State` with time as the axis of every leaf.
Trajectory = tuple[Float[Array, " time"], Float[Array, " time"], Any]
Columns = tuple[tuple[Scalar, ...], ...]
# Steps that are differentiated at once: the intermediate arrays stay in the cache, and
# the memory of a gradient does not grow with the record.
_CHUNK = 128


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def solve(substeps: int, stepping: Stepping, initial: State) -> Trajectory:
    """States at the samples, differentiable in the stepping and the initial state."""
    return _unpacked(stepping, _states(substeps, substeps, stepping, initial))


def _states(substeps: int, every: int, stepping: Stepping, initial: State) -> Trajectory:
    """States after every `every` substeps, in the layout of the time loop."""
    num_steps = stepping.num_steps
    carried = packed(stepping, initial)
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


def packed(stepping: Stepping, state: State) -> State:
    """A state in the layout of the time loop."""
    y, v, memory = state
    laws = stepping.step.laws
    return y, v, tuple(law.packed(law_memory) for law, law_memory in zip(laws, memory, strict=True))


def _unpacked(stepping: Stepping, trajectory: Trajectory) -> Trajectory:
    """States of scalars from the layout of the time loop."""
    y, v, memory = trajectory
    laws = stepping.step.laws
    return (
        y,
        v,
        tuple(law.unpacked(law_memory) for law, law_memory in zip(laws, memory, strict=True)),
    )


def unused_field(tau, state, stepping):
    """Placeholder: diffrax requires a vector field, but `HysteresisExact` steps by its `args`."""
    return state


@solve.defjvp
def _solve_jvp(substeps, primals, tangents):
    stepping, initial = primals
    if any(jnp.ndim(x) for x in jax.tree.leaves(initial)):
        raise ModelError(
            "A law whose memory is an array, as that of `iwan5`, has no derivatives in time.",
            why="Its elements drop one by one, and each drop's time moves with the parameters.",
            remedy="Take differences, or a law without drops such as `iwan4`.",
        )
    trajectory = _states(substeps, 1, stepping, initial)
    stacks = any(law.stacks for law in stepping.step.laws)
    linearised = jax.vmap(_linearised, in_axes=(None, 0, 0, 0, 0))
    along = adjoint_stack.tangent if stacks else partial(in_chunks, linearised, _recurrence)
    stepping_dot, initial_dot = tangents
    pushed, pushed_dot = jax.jvp(Stepping.pushed, (stepping,), (stepping_dot,))
    trajectory_dot = along(pushed, trajectory, pushed_dot, initial_dot)
    sampled = jax.tree.map(lambda x: x[::substeps], (trajectory, trajectory_dot))
    return _unpacked(stepping, sampled[0]), _unpacked(stepping, sampled[1])


def in_chunks(
    linearised: Callable[..., Any],
    recurrence: Callable[..., Any],
    stepping: Pushed,
    trajectory: Any,
    stepping_dot: Pushed,
    initial_dot: Any,
) -> Any:
    """Tangent of a trajectory: chunks of steps one after another.

    Args:
        linearised: The derivatives of many steps at their constants, starts and pushes, and the
            tangents of constants, one a step, and pushes.
        recurrence: The scan of tangents of states over it.
        stepping: Constants and pushes of all steps.
        trajectory: States before and after them.
        stepping_dot: Tangents of the stepping.
        initial_dot: That of the first state.
    """
    num_steps = jax.tree.leaves(stepping.push)[0].shape[0]
    size = min(_CHUNK, num_steps)

    def chunks(x):
        return jnp.pad(x, (0, -num_steps % size)).reshape(-1, size)

    starts = jax.tree.map(lambda x: chunks(x[:-1]), trajectory)
    push, push_dot = (jax.tree.map(chunks, s.push) for s in (stepping, stepping_dot))
    # One copy a lane: transposed, the lanes are summed once and not in every chunk.
    step_dot = jax.tree.map(lambda x: jnp.broadcast_to(x, (size,)), stepping_dot.step)

    @jax.checkpoint
    def chunk(x_dot, inputs):
        starts, push, push_dot = inputs
        parts = linearised(stepping.step, starts, push, step_dot, push_dot)
        return jax.lax.scan(recurrence, x_dot, parts)

    _, ys = jax.lax.scan(chunk, initial_dot, (starts, push, push_dot))

    def joined(first, following):
        return jnp.concatenate([jnp.asarray(first)[None], following.reshape(-1)[:num_steps]])

    return jax.tree.map(joined, initial_dot, ys)


def _linearised(
    step: ExactStep, start: State, push: Push, step_dot: ExactStep, push_dot: Push
) -> tuple[Columns, tuple[Scalar, ...]]:
    """Columns of the matrix J_n, and the offset b_n, of one step; leaves of the state in order."""
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
    """One step of the tangent recurrence; matrices come column by column."""
    columns, offset = inputs
    leaves, tree = jax.tree.flatten(x_dot)
    after = [
        part + sum(column[i] * x for column, x in zip(columns, leaves, strict=True))
        for i, part in enumerate(offset)
    ]
    x_dot = jax.tree.unflatten(tree, after)
    return x_dot, x_dot
