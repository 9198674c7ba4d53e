r"""Forward and reverse derivatives of a simulation of several modes with joints.

The method is that of `jbw.oscillator.adjoint`, where the Jacobian of a step would have (2N + M)^2
entries with M memories. Here only the joints' kernels are differentiated, each separately;
everything between them is linear and is applied directly:

$$(x, v, m)_j \to (r, h\dot r)_j \;|\; x_1, v_1, a\ \text{of all} \;|\;
  (x, v, m, x_1, v_1, a)_j \to (\Delta r, h\dot r_1, k_y, k_v, m)_j \;|\; \Delta x, q, \dot q$$

so that the cost grows with the number of joints and not with its square. With several joints, the
turning point of one depends on how the forces of the others bend its path: $(x, v, m, a)_j \to
h^2\ddot r_j / 2$ is then a part in between.
"""

from collections.abc import Callable
from functools import partial
from operator import itemgetter
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jbw.oscillator.adjoint import in_chunks
from jbw.oscillator.kinks import barrier
from jbw.oscillator.law import packed, unpacked
from jbw.oscillator.modes.step import (
    Begun,
    JointKernel,
    ModalState,
    ModalStep,
    ModalStepping,
    Passed,
    Remainder,
    all_bent,
    corrections,
    driven,
    freely,
    half_bend,
    modal_advance,
    pass_always,
    predicted,
    remainder,
    seen_by_joints,
)
from jbw.oscillator.parameters import Scalar
from jbw.oscillator.step import End, shifted

# A `ModalState` with the impulses of the previous step's kinks, as arrays over time.
Trajectory = Any


def modal_solve(stepping: ModalStepping, initial: ModalState) -> Trajectory:
    """Return the states at the start and after each substep, with each joint's kink impulses."""
    # Laws that remember load reversals have states too long for one column each.
    if any(law.depth for joint in stepping.step.joints for law in joint.laws):
        return _march(stepping, initial)
    return _solve(stepping, initial)


@jax.custom_jvp
def _solve(stepping: ModalStepping, initial: ModalState) -> Trajectory:
    return _march(stepping, initial)


def _march(stepping: ModalStepping, initial: ModalState) -> Trajectory:
    """Compute the states after every substep, by a loop that XLA compiles to one native call."""
    laws = tuple(joint.laws for joint in stepping.step.joints)

    def onward(state, powers):
        state, kicks = modal_advance(stepping.step, state, stepping.push(powers))
        return state, (state, kicks)

    first = packed(laws, jax.tree.map(jnp.asarray, initial))
    _, following = jax.lax.scan(onward, first, stepping.pieces)
    states, kicks = _joined((first, _no_kicks(stepping.step, first)), following)
    return unpacked(laws, states), kicks


def _no_kicks(step: ModalStep, state: ModalState) -> tuple:
    """Return zero impulses of kinks for the time before the first step."""
    none = jnp.zeros_like(state[0][0])
    return tuple((none, none) for _ in step.joints)


def _joined(first: Any, following: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, following)


@_solve.defjvp
def _solve_jvp(primals, tangents):
    stepping, initial = primals
    stepping_dot, initial_dot = tangents
    trajectory = _solve(stepping, initial)
    recurrence = partial(_recurrence, stepping.step)
    pushed, pushed_dot = jax.jvp(ModalStepping.pushed, (stepping,), (stepping_dot,))
    first_dot = initial_dot, _no_kicks(stepping.step, initial_dot)
    return trajectory, in_chunks(_linearised, recurrence, pushed, trajectory, pushed_dot, first_dot)


class StepSlopes(NamedTuple):
    """The derivatives of one partial result in the time step of a joint.

    Attributes:
        columns: Change of the part per unit of each of its arguments.
        offset: Change of the part due to the tangents of constants and input.
    """

    columns: tuple
    offset: tuple

    def along(self, *arguments: Any) -> tuple:
        """Return the change of the partial result for given changes of its arguments."""
        changes = jax.tree.leaves(arguments)
        return tuple(
            offset + sum(column[i] * x for column, x in zip(self.columns, changes, strict=True))
            for i, offset in enumerate(self.offset)
        )


class JointSlopes(NamedTuple):
    """Derivatives of a joint's time step, and its changes due to changed step constants.

    Attributes:
        start: Derivatives of r and h r' with respect to x, v and the memories.
        path_by: Change of the path due to the constants.
        half_bend: Derivatives of h^2 r''/2 with respect to x, v, a and the memories; None for one
            joint.
        bent_by: Change of the other joints' bending of the path due to the constants.
        turns: 1 where the joint turns, so that this bending moves the end of its path, else 0.
        passing: Derivatives of `Passed` and the memories with respect to x, v, memories and path.
        move_by: Change of the correction of x due to the constants.
        by_move: Derivatives of the memories with respect to the correction of x.
    """

    start: StepSlopes
    path_by: tuple
    half_bend: StepSlopes | None
    bent_by: tuple
    turns: Any
    passing: StepSlopes
    move_by: Any
    by_move: tuple


def _linearised(step: ModalStep, start, push, step_dot, push_dot) -> tuple[Any, Any, Any]:
    """Return derivatives of each joint's step, and the modes' change due to step constants.

    Many steps are computed at once, along the first axis of all arguments but the constants.
    """
    (q, v, memories), _ = start

    def before(q, v, push, *dots):
        def seen(step, push):
            change = freely(step, (q, v), push)
            return *change, seen_by_joints(step, (q, v), change, push[2])

        return jax.jvp(seen, (step, push), dots)

    (_, _, seen), free_by = jax.vmap(before)(q, v, push, step_dot, push_dot)
    by_constants = partial(_by_constants, step, step_dot)
    kernels = tuple(
        (joint.kernel, joint_dot.kernel)
        for joint, joint_dot in zip(step.joints, step_dot.joints, strict=True)
    )
    at = [(free.x, free.v, memory) for free, memory in zip(seen, memories, strict=True)]
    starts, by_start = _of_all(partial(_sloped, _start), kernels, at)
    paths, path_by = by_constants(predicted, seen, starts)
    bends = bent_by = ((),) * len(kernels)
    by_bend = (None,) * len(kernels)
    if len(kernels) > 1:
        at_a = [(*joint_state, path.a) for joint_state, path in zip(at, paths, strict=True)]
        halves, by_bend = _of_all(partial(_sloped, _half_bend), kernels, at_a)
        bends, bent_by = by_constants(all_bent, tuple(half for (half,) in halves))
    along = [(*joint_state, path) for joint_state, path in zip(at, paths, strict=True)]
    passed, ends, by_along = _of_all(_passing_slopes, kernels, along, bends)
    turns = tuple(jnp.where(joint.shift != 0.0, 1.0, 0.0) for joint in passed)
    moves, move_by = by_constants(corrections, starts, passed)
    passing, by_move = _of_all(_moved_slopes, kernels, ends, moves, by_along)
    # derivatives of the joints' effect on the modes with respect to the coefficients of a time step
    none = tuple(jnp.zeros_like(part) for part in q)
    _, post = by_constants(driven, (none, none), (none, none), starts, passed)
    parts = by_start, path_by, by_bend, bent_by, turns, passing, move_by, by_move
    return tuple(JointSlopes(*terms) for terms in zip(*parts, strict=True)), free_by, post


def _by_constants(
    step: ModalStep, step_dot: ModalStep, function: Callable[..., Any], *arguments: Any
) -> tuple[Any, Any]:
    def in_step(step_dot: ModalStep, *arguments: Any) -> tuple[Any, Any]:
        return jax.jvp(lambda step: function(step, *arguments), (step,), (step_dot,))

    return jax.vmap(in_step)(step_dot, *arguments)


def _of_all(function: Callable[..., tuple], kernels: tuple, *arguments: Any) -> tuple[tuple, ...]:
    """Apply a function to every joint in many time steps, and group the results by joint.

    Joints with the same laws are stacked in one array: they are compiled once, which saves most of
    the additional compilation for several joints.
    """
    joints = list(zip(kernels, *arguments, strict=True))
    by_structure: dict[Any, list[int]] = {}
    for place, joint in enumerate(joints):
        by_structure.setdefault(jax.tree.structure(joint), []).append(place)

    def of_joint(joint: tuple) -> tuple:
        (kernel, kernel_dot), *rest = joint
        in_step = jax.vmap(partial(function, kernel))
        return in_step(kernel_dot, *rest)

    values: dict[int, tuple] = {}
    for numbers in by_structure.values():
        if len(numbers) == 1:
            values[numbers[0]] = of_joint(joints[numbers[0]])
            continue
        stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(joints[p] for p in numbers))
        together = jax.vmap(of_joint)(stacked)
        values |= {p: jax.tree.map(itemgetter(i), together) for i, p in enumerate(numbers)}
    return tuple(zip(*(values[place] for place in range(len(joints))), strict=True))


def _start(kernel: JointKernel, at: tuple) -> tuple[Scalar, ...]:
    return remainder(Begun(kernel, *at))


def _half_bend(kernel: JointKernel, at: tuple) -> tuple[Scalar, ...]:
    *start, a = at
    return (half_bend(Begun(kernel, *start), a),)


def _passing(kernel: JointKernel, bends: tuple, at: tuple) -> tuple[Passed, End]:
    """Return the result of a joint's step, before its displacement x is corrected.

    Where the joint turns, the bends of the other joints add to x and v at the end of the path, and
    to the shift; the effect of changes of these bends follows from that of changes of the path.
    """
    *start, path = at
    return pass_always(Begun(kernel, *start), path, bends)


def _sloped(
    function: Callable[..., Any], kernel: JointKernel, kernel_dot: JointKernel, at: Any
) -> tuple[Any, StepSlopes]:
    value, by_at = jax.linearize(lambda at: function(kernel, at), at)
    _, offset = jax.jvp(lambda kernel: function(kernel, at), (kernel,), (kernel_dot,))
    return value, StepSlopes(tuple(tuple(by_at(way)) for way in _ways(at)), tuple(offset))


def _passing_slopes(
    kernel: JointKernel, kernel_dot: JointKernel, at: tuple, bends: tuple
) -> tuple[Passed, End, StepSlopes]:
    (passed, end), by_at = jax.linearize(partial(_passing, kernel, bends), at)
    _, offset = jax.jvp(lambda kernel: _passing(kernel, bends, at), (kernel,), (kernel_dot,))
    return passed, end, StepSlopes(tuple(by_at(way) for way in _ways(at)), offset)


def _moved_slopes(
    kernel: JointKernel, kernel_dot: JointKernel, end: End, move: Scalar, by_along: StepSlopes
) -> tuple[StepSlopes, tuple]:
    """Return derivatives of a joint's step with respect to the correction of its displacement x."""
    laws, laws_dot = kernel.laws, kernel_dot.laws
    _, by_end = jax.linearize(lambda end: shifted(laws, end, move), end)

    def column(passed_dot: Passed, end_dot: End) -> tuple:
        return (*passed_dot, *jax.tree.leaves(by_end(end_dot)))

    passed_dot, end_dot = by_along.offset
    _, memory_dot = jax.jvp(
        lambda laws, end: shifted(laws, end, move), (laws, end), (laws_dot, end_dot)
    )
    unit = jnp.ones_like(move)
    _, by_move = jax.jvp(lambda move: shifted(laws, end, move), (move,), (unit,))
    columns = tuple(column(*both) for both in by_along.columns)
    offset = (*passed_dot, *jax.tree.leaves(memory_dot))
    return StepSlopes(columns, offset), tuple(jax.tree.leaves(by_move))


def _ways(at: Any) -> list[Any]:
    leaves, tree = jax.tree.flatten(at)
    none, unit = jnp.zeros_like(leaves[0]), jnp.ones_like(leaves[0])
    size = range(len(leaves))
    return [jax.tree.unflatten(tree, [unit if i == j else none for i in size]) for j in size]


def _recurrence(step: ModalStep, state_dot, inputs):
    """Advance the derivative of the state by one step, from derivatives of all joints' steps."""
    slopes, (rise_by, gain_by, seen_by), post = inputs
    (q, v, memories), _ = state_dot
    none = tuple(jnp.zeros_like(part) for part in q)
    change = freely(step, (q, v), (none, none, none[0]))
    seen = barrier(_sum(seen_by_joints(step, (q, v), change, none[0]), seen_by))
    joints = list(zip(slopes, seen, memories, strict=True))
    starts = tuple(
        barrier(Remainder(*by.start.along(free.x, free.v, memory))) for by, free, memory in joints
    )
    paths = [
        _sum(path, by.path_by)
        for path, by in zip(predicted(step, seen, starts), slopes, strict=True)
    ]
    shifts = (0.0,) * len(slopes)
    if len(slopes) > 1:
        paths, shifts = _bent_paths(step, joints, paths)
    ends = [
        barrier(by.passing.along(free.x, free.v, memory, barrier(path)))
        for (by, free, memory), path in zip(joints, paths, strict=True)
    ]
    num = len(Passed._fields)
    passed = tuple(Passed(*end[:num]) for end in ends)
    passed = tuple(
        joint._replace(shift=joint.shift + shift)
        for joint, shift in zip(passed, shifts, strict=True)
    )
    moves = barrier(corrections(step, starts, passed))

    def after(by: JointSlopes, memory: Any, end: tuple, move: Scalar) -> Any:
        change = move + by.move_by
        leaves = [x + slope * change for x, slope in zip(end[num:], by.by_move, strict=True)]
        return jax.tree.unflatten(jax.tree.structure(memory), leaves)

    memories = tuple(after(*terms) for terms in zip(slopes, memories, ends, moves, strict=True))
    change = _sum(change, (rise_by, gain_by))
    q, v = _sum(driven(step, (q, v), change, starts, passed), post)
    state_dot = (q, v, memories), tuple((end.kick_y, end.kick_v) for end in passed)
    return state_dot, state_dot


def _bent_paths(step: ModalStep, joints: list, paths: list) -> tuple[list, tuple]:
    """Return derivatives of reversing joints' paths, including effects of the other joints."""
    halves = tuple(
        by.half_bend.along(free.x, free.v, memory, path.a)[0]
        for (by, free, memory), path in zip(joints, paths, strict=True)
    )
    bends = _sum(all_bent(step, halves), tuple(by.bent_by for by, *_ in joints))
    met = [
        (by.turns * on_x, by.turns * on_v)
        for (by, *_), (on_x, on_v) in zip(joints, bends, strict=True)
    ]
    paths = [
        path._replace(x=path.x + on_x, v=path.v + on_v)
        for path, (on_x, on_v) in zip(paths, met, strict=True)
    ]
    return paths, tuple(on_x for on_x, _ in met)


def _sum(first: Any, second: Any) -> Any:
    return jax.tree.map(jnp.add, first, second)
