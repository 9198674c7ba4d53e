r"""States of all modes after every step, and their derivatives in forward and reverse mode.

As in `jbw.oscillator.adjoint`, whose Jacobian of a step would have (2N + 1)^2 entries. Only the
joint's kernel is differentiated, five scalars and its memories; what the modes do before and after
it is linear and is applied as it stands.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from jbw.oscillator.adjoint import in_chunks
from jbw.oscillator.modes.step import (
    FreeMotion,
    JointForces,
    ModalState,
    ModalStep,
    ModalStepping,
    driven,
    freely,
    kernel,
    modal_advance,
    seen_by_joint,
)

# A `ModalState` with time as the axis of every leaf.
Trajectory = Any


def modal_solve(stepping: ModalStepping, initial: ModalState) -> Trajectory:
    """States at the start and after every substep."""
    # Laws with a stack of reversals have memories too long for a column each.
    if any(law.stacks for law in stepping.step.joint.laws):
        return _march(stepping, initial)
    return _solve(stepping, initial)


@jax.custom_jvp
def _solve(stepping: ModalStepping, initial: ModalState) -> Trajectory:
    return _march(stepping, initial)


def _march(stepping: ModalStepping, initial: ModalState) -> Trajectory:
    """States after every substep, by a loop that XLA turns into one native call."""
    laws = stepping.step.joint.laws

    def packed(state: ModalState) -> ModalState:
        q, v, memory = state
        return (
            q,
            v,
            tuple(law.packed(law_memory) for law, law_memory in zip(laws, memory, strict=True)),
        )

    def onward(state, powers):
        state = modal_advance(stepping.step, state, stepping.push(powers), branch=True)
        return state, state

    first = jax.tree.map(jnp.asarray, packed(initial))
    _, following = jax.lax.scan(onward, first, stepping.pieces)
    q, v, memory = _joined(first, following)
    return (
        q,
        v,
        tuple(law.unpacked(law_memory) for law, law_memory in zip(laws, memory, strict=True)),
    )


def _joined(first: Any, following: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, following)


@_solve.defjvp
def _solve_jvp(primals, tangents):
    stepping, initial = primals
    stepping_dot, initial_dot = tangents
    trajectory = _solve(stepping, initial)
    recurrence = partial(_recurrence, stepping.step)
    pushed, pushed_dot = jax.jvp(ModalStepping.pushed, (stepping,), (stepping_dot,))
    return trajectory, in_chunks(
        _linearised, recurrence, pushed, trajectory, pushed_dot, initial_dot
    )


def _linearised(step: ModalStep, start, push, step_dot, push_dot) -> tuple[Any, Any, Any, Any]:
    """Columns of the kernel's Jacobian, and what constants and input add to each of three parts."""
    q, v, memory = start

    def before(step, push):
        rise, gain = freely(step, q, v, push)
        return rise, gain, tuple(seen_by_joint(step, q, v, rise, gain, push[2]))

    (_, _, seen), pre = jax.jvp(before, (step, push), (step_dot, push_dot))
    memories, tree = jax.tree.flatten(memory)
    arguments = (*seen, *memories)

    def joint(constants, arguments):
        joint_forces, after = kernel(
            constants,
            FreeMotion(*arguments[:5]),
            jax.tree.unflatten(tree, arguments[5:]),
            branch=False,
        )
        return (*joint_forces, *jax.tree.leaves(after))

    outputs, by_arguments = jax.linearize(lambda arguments: joint(step.joint, arguments), arguments)
    none, unit = jnp.zeros_like(q[0]), jnp.ones_like(q[0])
    size = len(arguments)
    columns = tuple(
        by_arguments(tuple(unit if i == j else none for i in range(size))) for j in range(size)
    )
    _, offset = jax.jvp(lambda c: joint(c, arguments), (step.joint,), (step_dot.joint,))
    joint_forces = JointForces(*outputs[:6])
    # The step's own change of what the modes do with the joint's force.
    none_each = tuple(none for _ in q)
    _, post = jax.jvp(
        lambda step: driven(step, none_each, none_each, none_each, none_each, joint_forces),
        (step,),
        (step_dot,),
    )
    return columns, pre, offset, post


def _recurrence(step: ModalStep, x_dot, inputs):
    """One step of the tangent recurrence: linear pre, the kernel's columns, linear post."""
    columns, (rise_by, gain_by, seen_by), offset, post = inputs
    q, v, memory = x_dot
    memories, tree = jax.tree.flatten(memory)
    none = tuple(jnp.zeros_like(part) for part in q)
    rise, gain = freely(step, q, v, (none, none, none[0]))
    seen = seen_by_joint(step, q, v, rise, gain, none[0])
    arguments = (*_added(tuple(seen), seen_by), *memories)
    after = [
        part + sum(column[i] * x for column, x in zip(columns, arguments, strict=True))
        for i, part in enumerate(offset)
    ]
    rise, gain = _added(rise, rise_by), _added(gain, gain_by)
    ends = driven(step, q, v, rise, gain, JointForces(*after[:6]))
    q, v = (_added(end, part) for end, part in zip(ends, post, strict=True))
    x_dot = q, v, jax.tree.unflatten(tree, after[6:])
    return x_dot, x_dot


def _added(first: tuple, second: tuple) -> tuple:
    return tuple(a + b for a, b in zip(first, second, strict=True))
