r"""One step of several modes with one joint: linear pre, the joint's kernel, linear post.

Modes move freely by their own exact propagators. The joint sees five scalars of them, x and v at
the start, the acceleration there and what x and v change by freely; it moves the memories as
`jbw.oscillator.step` does, with the modes' constants summed by h_i p_i, and gives back six scalars,
which every mode takes by constants of its own.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jbw.oscillator.hold import HeldInput
from jbw.oscillator.kinks import barrier
from jbw.oscillator.law import Law, Memory
from jbw.oscillator.linear import impulse_moments
from jbw.oscillator.modes.structure import Structure
from jbw.oscillator.parameters import Scalar
from jbw.oscillator.rare import where_rare
from jbw.oscillator.solver import Pushed, weighted
from jbw.oscillator.step import (
    NUM_MOMENTS,
    End,
    added,
    glided,
    past_cusps,
    remainders,
    shifted,
    through_kinks,
)

Coordinates = tuple[Scalar, ...]
# (q_i, ...), (q_i', ...), memories
ModalState = tuple[Coordinates, Coordinates, tuple[Memory, ...]]
# What the input adds to every q_i and q_i', and the input at the start.
ModalPush = tuple[tuple[Any, ...], tuple[Any, ...], Any]


class ModeStep(eqx.Module):
    """Constants of one mode's step; `on_y`, `on_v` weigh r, h r', the change of r and h r_1'."""

    h: Scalar
    p: Scalar
    stiffness: Scalar
    damping: Scalar
    f_11: Scalar
    f_12: Scalar
    f_21: Scalar
    f_22: Scalar
    on_y: tuple[Scalar, ...]
    on_v: tuple[Scalar, ...]


class JointStep(eqx.Module):
    """Constants of the joint's kernel: those of `ExactStep`, summed over modes by h_i p_i."""

    laws: tuple[Law, ...]
    dt: Scalar
    mobility: Scalar
    r_y: Scalar
    r_v: Scalar
    s_y: Scalar
    s_v: Scalar
    d_y: Scalar
    d_v: Scalar
    a_y: Scalar
    a_v: Scalar
    b_y: Scalar
    b_v: Scalar


class ModalStep(eqx.Module):
    """Constants of a step of all modes; all leaves are scalars."""

    joint: JointStep
    modes: tuple[ModeStep, ...]
    input_gain: Scalar


class FreeMotion(NamedTuple):
    """Motion of the joint by the modes alone, without its own force in this step."""

    x: Scalar
    v: Scalar
    a: Scalar
    rise: Scalar
    gain: Scalar


class JointForces(NamedTuple):
    """What the joint does to the modes: r, h r', the change of r, h r_1', and two impulses."""

    r: Scalar
    rate: Scalar
    change: Scalar
    rate_1: Scalar
    kick_y: Scalar
    kick_v: Scalar


class ModalStepping(eqx.Module):
    """All that the stepping of a record needs, as `jbw.oscillator.solver.Stepping` of one mode.

    Attributes:
        step: Constants of the step.
        on_q: What each power of the input's polynomial adds to every q_i in a substep [s^2].
        on_v: What it adds to every q_i' [s].
        gain: Gain of the input.
        pieces: Coefficients of the input in every substep, a row a power.
    """

    step: ModalStep
    on_q: tuple[tuple[Scalar, ...], ...]
    on_v: tuple[tuple[Scalar, ...], ...]
    gain: Scalar
    pieces: tuple[Float[Array, " substep"], ...]

    def push(self, powers: tuple[Any, ...]) -> ModalPush:
        """Change of every mode by the input's coefficients, of one substep or of all."""
        on_q, on_v = (
            tuple(weighted(weights, powers) for weights in modes)
            for modes in (self.on_q, self.on_v)
        )
        return on_q, on_v, self.gain * powers[0]

    def pushed(self) -> Pushed:
        """Constants of the step, and what the input adds in every substep, by one product."""
        start = self.gain * np.eye(1, len(self.pieces))[0]
        weights = [jnp.stack(moments) for moments in (*self.on_q, *self.on_v)]
        rows = tuple(jnp.stack([*weights, start]) @ jnp.stack(self.pieces))
        count = len(self.on_q)
        return Pushed(self.step, (rows[:count], rows[count:-1], rows[-1]))


def modal_stepping(
    structure: Structure, held: HeldInput, fs: Scalar, substeps: int
) -> ModalStepping:
    """Constants of the step, every mode's moments times its gain, and the input's coefficients."""
    step, moments_y, moments_v = _constants(structure, 1.0 / (fs * substeps))
    pieces = held.pieces(substeps)
    on_q, on_v = (
        tuple(
            tuple(held.gain * b * w[j] for j in range(len(pieces)))
            for b, w in zip(structure.b, moments, strict=True)  # pyright: ignore[reportArgumentType]
        )
        for moments in (moments_y, moments_v)
    )
    return ModalStepping(step, on_q, on_v, held.gain, pieces)


def _constants(structure: Structure, dt: Scalar) -> tuple[ModalStep, list[Array], list[Array]]:
    """Constants of the step of length dt [s], and every mode's moments of a unit input."""
    modes, sums, moments_y, moments_v = [], [], [], []
    for omega_n, zeta, h, p in zip(
        structure.omega_n, structure.zeta, structure.h, structure.p, strict=True  # pyright: ignore[reportArgumentType]
    ):  # fmt: skip
        stiffness, damping = omega_n**2, 2.0 * zeta * omega_n
        m = impulse_moments(stiffness, damping, dt, NUM_MOMENTS)
        (r_y, s_y, d_y, a_y, b_y), (r_v, s_v, d_v, a_v, b_v) = (
            (w[0], w[1], 3.0 * w[2] - 2.0 * w[3], w[3] - 2.0 * w[2], w[3] - w[2])
            for w in (m.y, m.v)
        )
        on_y, on_v = (
            tuple(-p * w for w in (r, s + a, d, b))
            for r, s, d, a, b in ((r_y, s_y, d_y, a_y, b_y), (r_v, s_v, d_v, a_v, b_v))
        )
        modes.append(ModeStep(h, p, stiffness, damping, m.f_11, m.f_12, m.f_21, m.f_22, on_y, on_v))
        weights = (1.0, r_y, r_v, s_y, s_v, d_y, d_v, a_y, a_v, b_y, b_v)
        sums.append([h * p * w for w in weights])
        moments_y.append(m.y)
        moments_v.append(m.v)
    joint = JointStep(structure.laws, dt, *(added(column) for column in zip(*sums, strict=True)))
    gain = added(h * b for h, b in zip(structure.h, structure.b, strict=True))  # pyright: ignore[reportArgumentType]
    step = ModalStep(joint, tuple(modes), gain)
    return jax.tree.map(jnp.asarray, step), moments_y, moments_v


def modal_advance(
    step: ModalStep, state: ModalState, push: ModalPush, *, branch: bool
) -> ModalState:
    """One step of all modes and of the joint."""
    q, v, memory = state
    rise, gain = freely(step, q, v, push)
    seen = seen_by_joint(step, q, v, rise, gain, push[2])
    joint_forces, memory = kernel(step.joint, seen, memory, branch=branch)
    return *driven(step, q, v, rise, gain, joint_forces), memory


def freely(
    step: ModalStep, q: Coordinates, v: Coordinates, push: ModalPush
) -> tuple[Coordinates, Coordinates]:
    """Change of every mode without the joint's force."""
    modes = list(zip(step.modes, q, v, push[0], push[1], strict=True))
    rise = tuple(m.f_11 * y + m.f_12 * dy + on_y for m, y, dy, on_y, _ in modes)
    gain = tuple(m.f_21 * y + m.f_22 * dy + on_v for m, y, dy, _, on_v in modes)
    return rise, gain


def seen_by_joint(step: ModalStep, q, v, rise, gain, u: Scalar) -> FreeMotion:
    """Motion of the joint by the modes alone: five scalars."""
    modes = step.modes
    pull = added(
        m.h * (m.damping * dy + m.stiffness * y) for m, y, dy in zip(modes, q, v, strict=True)
    )
    x, dx, up, faster = (
        added(m.h * part for m, part in zip(modes, parts, strict=True))
        for parts in (q, v, rise, gain)
    )
    return FreeMotion(x, dx, step.input_gain * u - pull, up, faster)


def driven(
    step: ModalStep, q, v, rise, gain, joint_forces: JointForces
) -> tuple[Coordinates, Coordinates]:
    """The modes at the end of the step, the joint's force included."""
    forces = joint_forces[:4]

    def after(start, free, kick, weights, p):
        return start + (
            free + p * kick + added(w * f for w, f in zip(weights, forces, strict=True))
        )

    modes = step.modes
    return (
        tuple(
            after(y, free, joint_forces.kick_y, m.on_y, m.p)
            for m, y, free in zip(modes, q, rise, strict=True)
        ),
        tuple(
            after(dy, free, joint_forces.kick_v, m.on_v, m.p)
            for m, dy, free in zip(modes, v, gain, strict=True)
        ),
    )


def kernel(
    joint: JointStep, seen: FreeMotion, memory: tuple[Memory, ...], *, branch: bool
) -> tuple[JointForces, tuple[Memory, ...]]:
    """The joint's step: `jbw.oscillator.step.advance` without the motion of the modes."""
    laws = joint.laws
    x, v = seen.x, seen.v
    none = jnp.zeros_like(v)
    if not laws:
        return JointForces(none, none, none, none, none, none), memory
    state = x, v, memory
    branches = tuple(
        law.branch(v, law_memory) for law, law_memory in zip(laws, memory, strict=True)
    )
    r, rate = remainders(laws, joint.dt, state, branches)
    x_1 = x + (seen.rise - joint.r_y * r - joint.s_y * rate)
    v_1 = v + (seen.gain - joint.r_v * r - joint.s_v * rate)
    end, shift = End(x_1, v_1, memory, branches, none, none), none
    if any(law.kinked for law in laws):
        a = seen.a - joint.mobility * r
        if branch:
            memory_1, kinked = glided(laws, state, branches, x_1, v_1)
            smooth = end._replace(memory=memory_1), none
            operands = joint, (state, branches, a), (x_1, v_1)
            end, shift = where_rare(kinked, lambda at: _through_kinks(*at), operands, smooth)
        else:
            x_1, v_1, r, rate = barrier((x_1, v_1, r, rate))
            end, shift = barrier(_through_kinks(joint, (state, branches, a), (x_1, v_1)))
    end = past_cusps(laws, joint.dt, state, end)
    r_1, rate_1 = remainders(laws, joint.dt, (end.y, end.v, end.memory), end.branches)
    change = r_1 - r
    if not branch:
        change, rate_1 = barrier((change, rate_1))
    weighted = joint.d_y * change + joint.a_y * rate + joint.b_y * rate_1
    dx = (joint.mobility * end.kick_y - shift) - weighted
    joint_forces = JointForces(r, rate, change, rate_1, end.kick_y, end.kick_v)
    return joint_forces, shifted(laws, end, dx)


def _through_kinks(joint: JointStep, start: tuple, predicted: tuple) -> tuple[End, Scalar]:
    """End of a step that may hold kinks, and what x already holds of the kicks."""
    # W_2 = b - a of the corrector's constants.
    weights = joint.a_y - joint.b_y, joint.a_v - joint.b_v
    end, shifts = through_kinks(joint.laws, joint.dt, start, weights, predicted)
    return end, shifts[0]
