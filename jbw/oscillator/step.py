r"""One time step of the oscillator: exact for the linear part, predictor-corrector for the laws.

Every law's stiffness at rest K is part of the exactly solved linear part. The laws act only through
the small remainder $r = \sum (F - K y)$, whose rate is continuous if they have no kinks other than
turning points. One step predicts (y, v) from r and its rate, moves the memories, and corrects (y,
v) with the cubic through r and its rate at both ends. An impulse on v and y compensates the error
of that cubic at a kink inside the step. With Bouc-Wen's exact map (nu = 1) the order is 4 through
the kinks at v = 0 and z = 0.
"""

from collections.abc import Iterable
from functools import partial, reduce
from operator import add
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from jbw.oscillator import generic
from jbw.oscillator.kinks import barrier
from jbw.oscillator.law import Law, Memory
from jbw.oscillator.linear import impulse_moments
from jbw.oscillator.oscillator import Oscillator
from jbw.oscillator.parameters import Scalar
from jbw.oscillator.rare import on_one_device, where_rare

NUM_MOMENTS = 6
State = tuple[Scalar, Scalar, tuple[Memory, ...]]
# Contributions of the input to y and v, and the input at the start (with a damper, also at the end)
# of the step.
Push = tuple[Scalar, ...]
# Whether a step treats kinks: only if it meets one, always (for many steps at once), or never.
Kinks = Literal["met", "always", "never"]


class End(NamedTuple):
    """The end of a step before its correction, with the kinks' impulses on v [m/s] and y [m]."""

    y: Scalar
    v: Scalar
    memory: tuple[Memory, ...]
    branches: tuple[Any, ...]
    kick_v: Scalar
    kick_y: Scalar


class ExactStep(eqx.Module):
    """The constants of a time step, computed once per set of parameters.

    `f_*` are the changes of (y, v) in free motion; `r_*`, `s_*` are the effects of r and of h times
    its rate in the predictor; `d_*`, `a_*`, `b_*` are the effects of the change of r and of its two
    rates in the corrector.
    """

    laws: tuple[Law, ...]
    stiffness: Scalar
    damping: Scalar
    dt: Scalar
    f_11: Scalar
    f_12: Scalar
    f_21: Scalar
    f_22: Scalar
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


def exact_step(oscillator: Oscillator, dt: Scalar) -> tuple[ExactStep, Array, Array]:
    """Return the constants of a step dt [s], and the input's moments W_j on y [s^2] and v [s]."""
    stiffness = oscillator.omega_n**2
    damping = 2.0 * oscillator.zeta * oscillator.omega_n
    m = impulse_moments(stiffness, damping, dt, NUM_MOMENTS)
    (y_0, y_1, y_2, y_3), (v_0, v_1, v_2, v_3) = (
        tuple(w[..., j] for j in range(4)) for w in (m.y, m.v)
    )
    # fmt: off
    step = ExactStep(
        oscillator.laws, stiffness, damping, dt,
        m.f_11, m.f_12, m.f_21, m.f_22,
        r_y=y_0, r_v=v_0, s_y=y_1, s_v=v_1,
        d_y=3.0 * y_2 - 2.0 * y_3, d_v=3.0 * v_2 - 2.0 * v_3,
        a_y=y_3 - 2.0 * y_2, a_v=v_3 - 2.0 * v_2, b_y=y_3 - y_2, b_v=v_3 - v_2,
    )
    # fmt: on
    return jax.tree.map(jnp.asarray, step), m.y, m.v


def advance(step: ExactStep, state: State, push: Push, *, kinks: Kinks) -> State:
    r"""Advance the oscillator's state by one time step.

    $$q_1 = E q + p - W_0 r - W_1 h\dot r, \quad m_1 = M(m, y_1 - y), \quad
      q_2 = q_1 - W_2 c_2 - W_3 c_3, \quad m_2 = M(m_1, y_2 - y_1)$$

    with $c_2 = 3d - h(2\dot r + \dot r_1)$, $c_3 = -2d + h(\dot r + \dot r_1)$, $d = r_1 - r$.
    """
    return _advanced(step, state, push, kinks, on_one_device())


# This function is traced once for all programs that step a law. The argument `_on_one_device`
# causes a second trace for batches on several devices, for which `where_rare` gives other code.
@partial(jax.jit, static_argnums=(3, 4))
def _advanced(
    step: ExactStep, state: State, push: Push, kinks: Kinks, _on_one_device: bool
) -> State:
    laws = step.laws
    branches, r, rate, y_1, v_1 = _predicted(step, state, push)
    none = jnp.zeros_like(v_1)
    end = End(y_1, v_1, state[2], branches, none, none)
    if any(law.kinked for law in laws):
        if kinks == "always":
            y_1, v_1, r, rate = barrier((y_1, v_1, r, rate))
            end = barrier(_through_kinks((step, state, branches, push[2], y_1, v_1)))
        else:
            memory_1, kinked = glided(laws, state, branches, y_1, v_1)
            smooth = end = end._replace(memory=memory_1)
            if kinks == "met":
                operands = step, state, branches, push[2], y_1, v_1
                end = where_rare(kinked, _through_kinks, operands, smooth)
    end = past_cusps(laws, step.dt, state, end)
    dv = 0.0
    # A velocity-dependent force follows v, which is predicted one order worse than y. Therefore it
    # is corrected twice.
    for _ in range(1 + any(law.feels_rate for law in laws)):
        corrected = end.y, end.v + dv, end.memory
        r_1, rate_1 = _remainder(step, corrected, end.branches, push[-1])
        change = r_1 - r
        if kinks == "always":
            change, rate_1 = barrier((change, rate_1))
        dy = end.kick_y - (step.d_y * change + step.a_y * rate + step.b_y * rate_1)
        if kinks == "always":
            dy = barrier(dy)
        dv = end.kick_v - (step.d_v * change + step.a_v * rate + step.b_v * rate_1)
    return end.y + dy, end.v + dv, shifted(laws, end, dy)


def meets_kink(step: ExactStep, state: State, push: Push) -> Bool[Array, "..."]:
    """Return whether a step contains a reversal or a kink of a law, which need more computation."""
    branches, _, _, y_1, v_1 = _predicted(step, state, push)
    return glided(step.laws, state, branches, y_1, v_1)[1]


def _predicted(step: ExactStep, state: State, push: Push) -> tuple[Any, ...]:
    """Return the laws' branches, their force F - K y with its rate, and the predicted y and v."""
    y, v, memory = state
    branches = tuple(
        law.branch(v, law_memory) for law, law_memory in zip(step.laws, memory, strict=True)
    )
    r, rate = _remainder(step, state, branches, push[2])
    y_1 = y + (step.f_11 * y + step.f_12 * v + push[0] - step.r_y * r - step.s_y * rate)
    v_1 = v + (step.f_21 * y + step.f_22 * v + push[1] - step.r_v * r - step.s_v * rate)
    return branches, r, rate, y_1, v_1


def _remainder(
    step: ExactStep, state: State, branches: tuple[Any, ...], u: Scalar
) -> tuple[Scalar, Scalar]:
    """Return the laws' total r = F - K y, and its rate times the time step h, under an input u.

    Only the rate of a velocity-dependent force, dF/dv times the acceleration, needs the input u.
    """
    y, v, memories = state
    r, rate = remainders(step.laws, step.dt, state, branches)
    for law, memory in zip(step.laws, memories, strict=True):
        if law.feels_rate:
            drag = generic.drag(law, y, v, memory)
            a = u - step.damping * v - step.stiffness * y - r  # acceleration
            rate = rate + step.dt * drag * a
    return r, rate


@jax.jit  # traced once for all programs that step a law, because its trace is long
def _through_kinks(
    start: tuple[ExactStep, State, tuple[Any, ...], Scalar, Scalar, Scalar],
) -> End:
    """Return the end of a step that may contain kinks, minus the kinks' effect predicted before.

    `start` contains the step, its state, branches and input u, and the predicted y and v.
    """
    step, state, branches, u, y_1, v_1 = start
    y, v, _ = state
    r, _ = _remainder(step, state, branches, u)
    a = barrier(u - step.damping * v - step.stiffness * y - r)  # acceleration
    # W_2 is the difference b - a of the corrector's constants.
    weights = step.a_y - step.b_y, step.a_v - step.b_v
    end, (shift_y, shift_v) = through_kinks(
        step.laws, step.dt, (state, branches, a), weights, (y_1, v_1)
    )
    return end._replace(kick_y=end.kick_y - shift_y, kick_v=end.kick_v - shift_v)


# -- the laws without the structure, moved by one mode or by several modes --------------------
def remainders(
    laws: tuple[Law, ...], h: Scalar, state: State, branches: tuple[Any, ...]
) -> tuple[Scalar, Scalar]:
    """Return the laws' total nonlinear force r = F - K y, and its rate times the time step h."""
    y, v, memory = state
    parts = [
        law.remainder(h, y, v, law_memory, at)
        for law, law_memory, at in zip(laws, memory, branches, strict=True)
    ]
    if not parts:
        return jnp.zeros_like(y), jnp.zeros_like(y)
    return added(r for r, _ in parts), added(rate for _, rate in parts)


def glided(
    laws: tuple[Law, ...], state: State, branches: tuple[Any, ...], y_1: Scalar, v_1: Scalar
) -> tuple[tuple[Memory, ...], Bool[Array, "..."]]:
    """Return the laws' internal states after a step, and True if one of the laws met a kink."""
    y, v, memory = state
    moves = [
        law.glide(y, law_memory, y_1 - y, at)
        for law, law_memory, at in zip(laws, memory, branches, strict=True)
    ]
    kinked = reduce(jnp.logical_or, (met for _, met in moves), jnp.asarray(v * v_1 <= 0.0))
    return tuple(law_memory for law_memory, _ in moves), kinked


def bend(
    laws: tuple[Law, ...], h: Scalar, state: State, branches: tuple[Any, ...], a: Scalar
) -> Scalar:
    """Return h^2/2 times the second time derivative of the laws' total force F - K y."""
    y, v, memory = state
    return added(
        law.bend(h, y, v, a, law_memory, at)
        for law, law_memory, at in zip(laws, memory, branches, strict=True)
    )


def through_kinks(
    laws: tuple[Law, ...],
    h: Scalar,
    start: tuple[State, tuple[Any, ...], Scalar],
    weights: tuple[Scalar, Scalar],
    predicted: tuple[Scalar, Scalar],
    others: tuple[Scalar, ...] = (),
) -> tuple[End, tuple[Scalar, Scalar]]:
    r"""Return the state after a step that may contain a turning point, a kink of a law, or both.

    A turning point depends on the motion before it. Therefore $\ddot r$ on the branch of the start,
    times its weights on y and v, is added to the prediction.

    Args:
        laws: The laws.
        h: Length of the step [s].
        start: State, branches and acceleration [m/s^2] at the start.
        weights: Effects of half of $h^2 \ddot r$ at the start on y and on v.
        predicted: y and v at the end, from r and its rate alone.
        others: Effects on y and v of half of $h^2 \ddot r$ of forces elsewhere, if there are any.

    Returns:
        The end, and the part of the impulses that its y and v already contain.
    """
    (y, v, memory), branches, a = start
    y_1, v_1 = predicted
    half = bend(laws, h, (y, v, memory), branches, a)
    shifts = tuple(weight * half for weight in weights)
    if others:
        shifts = tuple(shift + other for shift, other in zip(shifts, others, strict=True))
    shifts = barrier(shifts)
    turns = (v * v_1 < 0.0) & (v * (v_1 + shifts[1]) < 0.0)
    shift_y, shift_v = (jnp.where(turns, x, 0.0) for x in shifts)
    y_1, v_1 = barrier((y_1 + shift_y, v_1 + shift_v))
    ends = h * v, h * v_1, y_1 - y
    quartic = barrier(
        jnp.where(turns, 0.5 * h**2 * a - (3.0 * ends[2] - 2.0 * ends[0] - ends[1]), 0.0)
    )
    moved = [
        law.turn(h, y, law_memory, ends, quartic)
        for law, law_memory in zip(laws, memory, strict=True)
        if law.kinked
    ]
    kick_v, kick_y = added(on_v for _, on_v, _ in moved), added(on_y for _, _, on_y in moved)
    after = iter(law_memory for law_memory, _, _ in moved)
    memory_1 = tuple(
        next(after) if law.kinked else law_memory
        for law, law_memory in zip(laws, memory, strict=True)
    )
    branches_1 = tuple(
        law.branch(v_1, law_memory) for law, law_memory in zip(laws, memory_1, strict=True)
    )
    return End(y_1, v_1, memory_1, branches_1, h * kick_v, h**2 * kick_y), (shift_y, shift_v)


def past_cusps(laws: tuple[Law, ...], h: Scalar, state: State, end: End) -> End:
    """Add the effect of cusps in the rates of the laws, which the corrector's cubic omits."""
    _, v, memory = state
    for law, law_memory, end_memory in zip(laws, memory, end.memory, strict=True):
        if hasattr(law, "missed"):
            cusp = law.missed(h, (v, law_memory), (end.v, end_memory))  # pyright: ignore
            end = end._replace(kick_v=end.kick_v + h * cusp[0], kick_y=end.kick_y + h**2 * cusp[1])
    return end


def shifted(laws: tuple[Law, ...], end: End, dy: Scalar) -> tuple[Memory, ...]:
    """Return the laws' internal states at the end of a step, after the correction of y."""
    return tuple(
        law.shift(end.y, law_memory, dy, at)
        for law, law_memory, at in zip(laws, end.memory, end.branches, strict=True)
    )


def added(parts: Iterable[Any]) -> Any:
    """Return the sum of several terms, without the starting zero that XLA would add."""
    return reduce(add, parts)
