r"""One time step of several modes with joints: free modal motion, then the effect of each joint.

Modes move freely by their own exact propagators. Each joint receives five scalars from them: x and
v at the start, the acceleration there, and the free changes of x and v. It moves its memories as
`jbw.oscillator.step` does, on a path that the forces of all joints have predicted. It returns six
scalars, which every mode receives through its own constants. Kinks of two joints within one step
are not coupled: that changes an impulse by O(h^5) and a memory by O(h^4), so the order stays 4.
"""

from collections.abc import Sequence
from functools import reduce
from operator import sub
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jbw.oscillator.kinks import barrier
from jbw.oscillator.law import Law, Memory
from jbw.oscillator.linear import impulse_moments
from jbw.oscillator.modes.structure import Structure
from jbw.oscillator.parameters import Scalar
from jbw.oscillator.rare import where_rare
from jbw.oscillator.solver import Pushed
from jbw.oscillator.step import (
    NUM_MOMENTS,
    End,
    added,
    bend,
    glided,
    past_cusps,
    remainders,
    shifted,
    through_kinks,
)

Coordinates = tuple[Scalar, ...]
# tuple of all (q_i, ...) and all (q_i', ...), or of their changes
ModalMotion = tuple[Coordinates, Coordinates]
# internal states: one tuple per joint, with an entry per law
Memories = tuple[tuple[Memory, ...], ...]
# the state: (q_i, ...), (q_i', ...), internal states of the joints
ModalState = tuple[Coordinates, Coordinates, Memories]
# Contributions of the input to every q_i and q_i', and the input at the start of the step.
ModalPush = tuple[tuple[Any, ...], tuple[Any, ...], Any]


class ModeStep(eqx.Module):
    """The constants of one mode's time step, with the weights of the joints' forces on this mode.

    For every joint: h, p, and the weights `on_y`, `on_v` of its r, h r', change of r and h r_1'.
    """

    h: tuple[Scalar, ...]
    p: tuple[Scalar, ...]
    stiffness: Scalar
    damping: Scalar
    f_11: Scalar
    f_12: Scalar
    f_21: Scalar
    f_22: Scalar
    on_y: tuple[tuple[Scalar, ...], ...]
    on_v: tuple[tuple[Scalar, ...], ...]


class Coupling(eqx.Module):
    """The effect of one joint's force on another joint's motion within a step, over all modes.

    `bend_*` are the effects of h^2 r''/2, a - b of the corrector's constants.
    """

    mobility: Scalar
    r_y: Scalar
    r_v: Scalar
    s_y: Scalar
    s_v: Scalar
    d_y: Scalar
    a_y: Scalar
    b_y: Scalar
    bend_y: Scalar
    bend_v: Scalar


class JointKernel(eqx.Module):
    """The constants of a joint's time step that are independent of other joints and modes.

    `bend_*` are the effects of h^2 r''/2 of the joint itself on its x and v.
    """

    laws: tuple[Law, ...]
    dt: Scalar
    bend_y: Scalar
    bend_v: Scalar


class JointStep(eqx.Module):
    """The constants of one joint's time step, including the effect of all joints on it.

    `by` contains the effect of every joint's force on this joint, which is number `place` of them.
    """

    laws: tuple[Law, ...]
    dt: Scalar
    by: tuple[Coupling, ...]
    input_gain: Scalar
    place: int = eqx.field(static=True)

    @property
    def kernel(self) -> JointKernel:
        """The constants of the joint's time step that do not depend on other joints or modes."""
        by_itself = self.by[self.place]
        return JointKernel(self.laws, self.dt, by_itself.bend_y, by_itself.bend_v)

    @property
    def by_others(self) -> tuple[Coupling, ...]:
        """The effects of the other joints' forces on this joint's motion."""
        return _without(self.place, self.by)


class ModalStep(eqx.Module):
    """The constants of a time step of all modes and joints."""

    joints: tuple[JointStep, ...]
    modes: tuple[ModeStep, ...]


class FreeMotion(NamedTuple):
    """The motion of a joint due to the modes alone, if no joint force acts during the step."""

    x: Scalar
    v: Scalar
    a: Scalar
    rise: Scalar
    gain: Scalar


class Begun(NamedTuple):
    """A joint at the start of a step: constants, displacement, velocity, and internal states."""

    kernel: JointKernel
    x: Scalar
    v: Scalar
    memory: tuple[Memory, ...]

    @property
    def state(self) -> tuple[Scalar, Scalar, tuple[Memory, ...]]:
        """The displacement, velocity and internal states, as the laws' functions take them."""
        return self.x, self.v, self.memory

    @property
    def branches(self) -> tuple[Any, ...]:
        """The laws' constants at the start of the step, which are valid until the next kink."""
        pairs = zip(self.kernel.laws, self.memory, strict=True)
        return tuple(law.branch(self.v, law_memory) for law, law_memory in pairs)


class Remainder(NamedTuple):
    """The nonlinear force r of a joint's laws at the start of a step, and its rate times h."""

    r: Scalar
    rate: Scalar


class Path(NamedTuple):
    """The predicted path of a joint in a step: x and v at its end, acceleration at its start.

    The prediction contains the cubics of r and h r' of all joints.
    """

    x: Scalar
    v: Scalar
    a: Scalar


class Passed(NamedTuple):
    """The result of a joint's step: nonlinear force and rate at its end, and impulses of kinks.

    Attributes:
        r_1: r at the end.
        rate_1: h r' at the end.
        kick_y: Impulse on y that compensates the error of the cubic of r.
        kick_v: Impulse on v.
        shift: Part of the impulse on x that the path already contains.
    """

    r_1: Scalar
    rate_1: Scalar
    kick_y: Scalar
    kick_v: Scalar
    shift: Scalar


class ModalStepping(eqx.Module):
    """The constants and the input for the time steps of several modes.

    Attributes:
        step: Constants of the step.
        on_q: Effect of each power of the input's polynomial on every q_i in a substep [s^2].
        on_v: Effect of each power on every q_i' [s].
        gain: Gain of the input.
        pieces: Coefficients of the input in every substep, one row per power.
    """

    step: ModalStep
    on_q: tuple[tuple[Scalar, ...], ...]
    on_v: tuple[tuple[Scalar, ...], ...]
    gain: Scalar
    pieces: tuple[Float[Array, " substep"], ...]

    def push(self, powers: tuple[Any, ...]) -> ModalPush:
        """Return the effect of the input on each mode in a substep, from its polynomial there."""
        on_q, on_v = (
            tuple(
                added(weight * power for weight, power in zip(weights, powers, strict=True))
                for weights in modes
            )
            for modes in (self.on_q, self.on_v)
        )
        return on_q, on_v, self.gain * powers[0]

    def onward(self, state: ModalState, powers: tuple[Any, ...]) -> ModalState:
        """Return the state after a substep, from the input's polynomial in the substep."""
        return modal_advance(self.step, state, self.push(powers))[0]

    def pushed(self) -> Pushed:
        """Return the constants of the step, and the effect of the input in every substep."""
        start = self.gain * np.eye(1, len(self.pieces))[0]
        weights = [jnp.stack(moments) for moments in (*self.on_q, *self.on_v)]
        rows = tuple(jnp.stack([*weights, start]) @ jnp.stack(self.pieces))
        count = len(self.on_q)
        return self.step, (rows[:count], rows[count:-1], rows[-1])


def modal_stepping(
    structure: Structure, rate: Scalar, gain: Scalar, pieces: tuple[Any, ...]
) -> ModalStepping:
    """Return the constants of time steps, `rate` per second, of a structure with several joints.

    The input is the gain times polynomials with the coefficients `pieces`, one row per power.
    """
    dt = 1.0 / rate
    h, p, b = (jnp.asarray(x) for x in (structure.h, structure.p, structure.b))
    # The constants of all modes are computed as arrays, because a separate sum for each of so many
    # numbers compiles slowly.
    stiffness, damping = structure.omega_n**2, 2.0 * structure.zeta * structure.omega_n
    m = barrier(impulse_moments(stiffness, damping, dt, NUM_MOMENTS))
    (r_y, s_y, d_y, a_y, b_y), (r_v, s_v, d_v, a_v, b_v) = (
        (w_0, w_1, 3.0 * w_2 - 2.0 * w_3, w_3 - 2.0 * w_2, w_3 - w_2)
        for w_0, w_1, w_2, w_3 in (w.T[:4] for w in (m.y, m.v))
    )
    seen = jnp.stack([jnp.ones_like(r_y), r_y, r_v, s_y, s_v, d_y, a_y, b_y, a_y - b_y, a_v - b_v])
    couplings = barrier(jnp.einsum("ji,il,wi->jlw", h, p, seen))
    on_y, on_v = (
        -p[..., None] * jnp.stack(parts, axis=-1)[:, None]
        for parts in ((r_y, s_y + a_y, d_y, b_y), (r_v, s_v + a_v, d_v, b_v))
    )
    free = jnp.stack([stiffness, damping, m.f_11, m.f_12, m.f_21, m.f_22], axis=-1)
    modes = tuple(
        ModeStep(
            tuple(h_i), tuple(p_i), *tuple(free_i),
            on_y=tuple(map(tuple, on_q)), on_v=tuple(map(tuple, on_dq)),
        )
        for h_i, p_i, free_i, on_q, on_dq in zip(h.T, p, free, on_y, on_v, strict=True)
    )  # fmt: skip
    all_laws: Any = structure.laws
    steps = tuple(
        JointStep(laws, dt, tuple(Coupling(*row) for row in by), jnp.sum(h[j] * b), j)
        for j, (laws, by) in enumerate(zip(all_laws, map(tuple, couplings), strict=True))
    )
    step = jax.tree.map(jnp.asarray, ModalStep(steps, modes))
    on_q, on_v = (tuple(map(tuple, gain * b[:, None] * w[:, : len(pieces)])) for w in (m.y, m.v))
    return ModalStepping(step, on_q, on_v, gain, pieces)


def modal_advance(
    step: ModalStep, state: ModalState, push: ModalPush
) -> tuple[ModalState, tuple[tuple[Scalar, Scalar], ...]]:
    """Advance all modes and joints by one step; return each joint's kink impulses as well."""
    q, v, memories = state
    change = freely(step, (q, v), push)
    seen = seen_by_joints(step, (q, v), change, push[2])
    begun = tuple(
        Begun(joint.kernel, at.x, at.v, memory)
        for joint, at, memory in zip(step.joints, seen, memories, strict=True)
    )
    starts = tuple(remainder(at) for at in begun)
    paths = predicted(step, seen, starts)
    bends = tuple((at, path.a) for at, path in zip(begun, paths, strict=True))
    passed, ends = zip(
        *(
            pass_where_met(joint, at, path, _without(joint.place, bends))
            for joint, at, path in zip(step.joints, begun, paths, strict=True)
        ),
        strict=True,
    )
    moves = corrections(step, starts, passed)
    memories = tuple(
        shifted(joint.laws, end, dx)
        for joint, end, dx in zip(step.joints, ends, moves, strict=True)
    )
    q, v = driven(step, (q, v), change, starts, passed)
    return (q, v, memories), tuple((end.kick_y, end.kick_v) for end in passed)


def freely(step: ModalStep, motion: ModalMotion, push: ModalPush) -> ModalMotion:
    """Return the change of each mode in a step without the forces of the joints."""
    modes = list(zip(step.modes, *motion, push[0], push[1], strict=True))
    rise = tuple(m.f_11 * y + m.f_12 * dy + on_y for m, y, dy, on_y, _ in modes)
    gain = tuple(m.f_21 * y + m.f_22 * dy + on_v for m, y, dy, _, on_v in modes)
    return rise, gain


def seen_by_joints(
    step: ModalStep, motion: ModalMotion, change: ModalMotion, u: Scalar
) -> tuple[FreeMotion, ...]:
    """Return each joint's motion, and its change in a step without the forces of the joints."""
    q, v = motion
    pulls = tuple(
        m.damping * dy + m.stiffness * y for m, y, dy in zip(step.modes, q, v, strict=True)
    )

    def seen(j: int, joint: JointStep) -> FreeMotion:
        x, dx, pull, up, faster = (
            added(m.h[j] * part for m, part in zip(step.modes, parts, strict=True))
            for parts in (q, v, pulls, *change)
        )
        return FreeMotion(x, dx, joint.input_gain * u - pull, up, faster)

    return tuple(seen(j, joint) for j, joint in enumerate(step.joints))


def remainder(at: Begun) -> Remainder:
    """Return a joint's nonlinear force r = F - K x, and its rate times the time step h."""
    return Remainder(*remainders(at.kernel.laws, at.kernel.dt, at.state, at.branches))


def half_bend(at: Begun, a: Scalar) -> Scalar:
    """Return h^2/2 times the second time derivative of a joint's nonlinear force, for a step h."""
    if not at.kernel.laws:
        return jnp.zeros_like(a)
    return bend(at.kernel.laws, at.kernel.dt, at.state, at.branches, a)


def bent(joint: JointStep, half_bends: Sequence[Scalar]) -> tuple[Scalar, ...]:
    """Return the changes of a joint's x and v by second derivatives of other joints' forces."""
    if not half_bends:
        return ()
    pairs = list(zip(joint.by_others, half_bends, strict=True))
    return added(w.bend_y * half for w, half in pairs), added(w.bend_v * half for w, half in pairs)


def all_bent(step: ModalStep, half_bends: tuple[Scalar, ...]) -> tuple[tuple[Scalar, ...], ...]:
    """Return the changes of each joint's x and v due to other joints' second force derivatives."""
    return tuple(bent(joint, _without(joint.place, half_bends)) for joint in step.joints)


def _without(place: int, values: tuple[Any, ...]) -> tuple[Any, ...]:
    return values[:place] + values[place + 1 :]


def predicted(
    step: ModalStep, seen: Sequence[FreeMotion], starts: Sequence[Remainder]
) -> tuple[Path, ...]:
    """Return each joint's path, predicted from the forces r of all joints and their rates."""

    def path(joint: JointStep, at: FreeMotion) -> Path:
        pairs = list(zip(joint.by, starts, strict=True))
        rise = _less(at.rise, (w.r_y * s.r for w, s in pairs), (w.s_y * s.rate for w, s in pairs))
        gain = _less(at.gain, (w.r_v * s.r for w, s in pairs), (w.s_v * s.rate for w, s in pairs))
        return Path(at.x + rise, at.v + gain, _less(at.a, (w.mobility * s.r for w, s in pairs)))

    return tuple(path(joint, at) for joint, at in zip(step.joints, seen, strict=True))


def _less(total: Scalar, *parts: Any) -> Scalar:
    return reduce(sub, (part for group in parts for part in group), total)


def pass_where_met(
    joint: JointStep, at: Begun, path: Path, others: tuple[tuple[Begun, Scalar], ...]
) -> tuple[Passed, End]:
    """Advance a joint along its path; treat kinks of its force only if the step meets one.

    This is `jbw.oscillator.step.advance` without the motion of the modes. `others` are the other
    joints at the start, with their accelerations there.
    """
    end, shift = _smooth(at, path), jnp.zeros_like(path.x)
    if at.kernel.laws and any(law.kinked for law in at.kernel.laws):
        memory_1, kinked = glided(at.kernel.laws, at.state, at.branches, path.x, path.v)

        def kinks(operands: Any) -> tuple[End, Scalar]:
            joint, at, path, others = operands
            halves = [half_bend(*other) for other in others]
            return _through_kinks(at, path, bent(joint, halves))

        smooth = end._replace(memory=memory_1), shift
        end, shift = where_rare(kinked, kinks, (joint, at, path, others), smooth)
    return _passed(at, end, shift)


def pass_always(at: Begun, path: Path, bends: tuple[Scalar, ...]) -> tuple[Passed, End]:
    """Advance a joint along its path; treat kinks in every step, so that it is differentiable.

    `bends` are the effects of h^2 r''/2 of the other joints on this joint's x and v.
    """
    end, shift = _smooth(at, path), jnp.zeros_like(path.x)
    if at.kernel.laws and any(law.kinked for law in at.kernel.laws):
        x_1, v_1 = barrier((path.x, path.v))
        end, shift = barrier(_through_kinks(at, Path(x_1, v_1, path.a), bends))
    passed, end = _passed(at, end, shift)
    r_1, rate_1 = barrier((passed.r_1, passed.rate_1))
    return passed._replace(r_1=r_1, rate_1=rate_1), end


def _smooth(at: Begun, path: Path) -> End:
    none = jnp.zeros_like(path.x)
    return End(path.x, path.v, at.memory, at.branches, none, none)


def _passed(at: Begun, end: End, shift: Scalar) -> tuple[Passed, End]:
    """Return a joint's effect on the modes and the end of its step, both corrected for cusps."""
    laws, none = at.kernel.laws, jnp.zeros_like(shift)
    if not laws:
        return Passed(none, none, none, none, none), end
    end = past_cusps(laws, at.kernel.dt, at.state, end)
    r_1, rate_1 = remainders(laws, at.kernel.dt, (end.y, end.v, end.memory), end.branches)
    return Passed(r_1, rate_1, end.kick_y, end.kick_v, shift), end


def _through_kinks(at: Begun, path: Path, bends: tuple[Scalar, ...]) -> tuple[End, Scalar]:
    kernel, start = at.kernel, (at.state, at.branches, path.a)
    weights = kernel.bend_y, kernel.bend_v
    end, shifts = through_kinks(kernel.laws, kernel.dt, start, weights, (path.x, path.v), bends)
    return end, shifts[0]


def corrections(
    step: ModalStep, starts: Sequence[Remainder], passed: Sequence[Passed]
) -> tuple[Scalar, ...]:
    """Return the correction of each joint's displacement x at the end of a step."""

    def correction(joint: JointStep) -> Scalar:
        by_joint = list(zip(joint.by, starts, passed, strict=True))
        kicks = added(w.mobility * end.kick_y for w, _, end in by_joint) - passed[joint.place].shift
        forces = added(
            w.d_y * (end.r_1 - start.r) + w.a_y * start.rate + w.b_y * end.rate_1
            for w, start, end in by_joint
        )
        return kicks - forces

    return tuple(correction(joint) for joint in step.joints)


def driven(
    step: ModalStep,
    motion: ModalMotion,
    change: ModalMotion,
    starts: Sequence[Remainder],
    passed: Sequence[Passed],
) -> ModalMotion:
    """Return the modes after a step: their change without joint forces, plus the forces' effect."""
    (q, v), (rise, gain) = motion, change
    forces = [
        (start.r, start.rate, end.r_1 - start.r, end.rate_1)
        for start, end in zip(starts, passed, strict=True)
    ]

    def after(begun, free, p, kicks, weights):
        parts = [
            p_j * kick + added(w * f for w, f in zip(of_joint, force, strict=True))
            for p_j, kick, of_joint, force in zip(p, kicks, weights, forces, strict=True)
        ]
        return begun + (free + added(parts))

    kicks_y, kicks_v = [x.kick_y for x in passed], [x.kick_v for x in passed]
    modes = step.modes
    return (
        tuple(
            after(y, free, m.p, kicks_y, m.on_y) for m, y, free in zip(modes, q, rise, strict=True)
        ),
        tuple(
            after(dy, free, m.p, kicks_v, m.on_v)
            for m, dy, free in zip(modes, v, gain, strict=True)
        ),
    )
