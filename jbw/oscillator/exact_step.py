r"""The hysteresis-exact step: true order 4 through the kinks at v = 0 and z = 0, for nu = 1.

With the stiffness alpha y moved to the exactly solved linear part, the joint acts through the
small residual force $r = z - \alpha y$, whose rate $\dot r = -v z\,(\gamma\,\mathrm{sgn}\,v +
\delta\,\mathrm{sgn}\,z)$ is continuous; a smooth restoring force f beside z adds f(y) to r and
$f'(y)\,v$ to its rate, and no kink. One step predicts (y, v) with r and its rate, moves z
exactly, and corrects (y, v) with the cubic through r and its rate at both ends. What that cubic
misses of a kink inside the step is paid back as a kick on v and y.
"""

from typing import cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from jbw.oscillator.kinked_step import kinked_step
from jbw.oscillator.moments import impulse_moments
from jbw.oscillator.parameters import BoucWen, Restoring, Scalar
from jbw.oscillator.signed_map import kept, signed, smooth_move

NUM_MOMENTS = 6
State = tuple[Scalar, Scalar, Scalar]
Push = tuple[Scalar, Scalar, Scalar]


class ExactStep(eqx.Module):
    """Constants of the step, made once per set of parameters; all leaves are scalars.

    Without a restoring force beside the hysteretic one nothing is computed for it.

    `f_*` are what (y, v) change by freely; `r_*`, `s_*` are the effect of r and of h times its
    rate in the predictor; `d_*`, `a_*`, `b_*` those of the change of r and of its two rates in
    the corrector.
    """

    alpha: Scalar
    delta: Scalar
    gamma: Scalar
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
    restoring: Restoring | None


def exact_step(joint: BoucWen, dt: Scalar) -> tuple[ExactStep, Array, Array]:
    """Constants of the hysteresis-exact step of length dt.

    Args:
        joint: Bouc-Wen parameters, nu = 1.
        dt: Step [s].

    Returns:
        The constants, and the input moments W_j of displacement [s^2] and velocity [s].
    """
    stiffness, damping = joint.omega_n**2, 2.0 * joint.zeta * joint.omega_n
    m = impulse_moments(stiffness, damping, dt, NUM_MOMENTS)
    (y_0, y_1, y_2, y_3), (v_0, v_1, v_2, v_3) = (
        tuple(w[..., j] for j in range(4)) for w in (m.y, m.v)
    )
    # fmt: off
    step = ExactStep(
        joint.alpha, joint.delta, joint.gamma, stiffness, damping, dt,
        m.f_11, m.f_12, m.f_21, m.f_22,
        r_y=y_0, r_v=v_0, s_y=y_1, s_v=v_1,
        d_y=3.0 * y_2 - 2.0 * y_3, d_v=3.0 * v_2 - 2.0 * v_3,
        a_y=y_3 - 2.0 * y_2, a_v=v_3 - 2.0 * v_2, b_y=y_3 - y_2, b_v=v_3 - v_2,
        restoring=joint.restoring,
    )
    # fmt: on
    return jax.tree.map(jnp.asarray, step), m.y, m.v


def advance(step: ExactStep, state: State, push: Push, *, branch: bool) -> State:
    r"""One hysteresis-exact step.

    $$q_1 = E q + p - W_0 r - W_1 h\dot r, \quad z_1 = M(z, y_1 - y), \quad
      q_2 = q_1 - W_2 c_2 - W_3 c_3, \quad z_2 = z_1 + z'(z_1)(y_2 - y_1)$$

    with $c_2 = 3d - h(2\dot r + \dot r_1)$, $c_3 = -2d + h(\dot r + \dot r_1)$, $d = r_1 - r$.

    Args:
        step: Constants of the step.
        state: (y, v, z) at its start.
        push: What the input adds to (y, v) in this step, and the input at its start.
        branch: Whether the kinks are handled under `lax.cond` (quick for scalars) or always.

    Returns:
        (y, v, z) at its end.
    """
    y, v, z = state
    c = signed(step.gamma, v) + signed(step.delta, z)
    r = z - step.alpha * y
    rate = -step.dt * c * v * z
    if step.restoring is not None:
        f, f_rate = kept(_smooth(step, y, v))
        r, rate = r + f, rate + f_rate
    y_1 = y + (step.f_11 * y + step.f_12 * v + push[0] - step.r_y * r - step.s_y * rate)
    v_1 = v + (step.f_21 * y + step.f_22 * v + push[1] - step.r_v * r - step.s_v * rate)
    if branch:
        dy = y_1 - y
        z_1 = smooth_move(step.alpha, c, z, dy)
        kinked = (v * v_1 <= 0.0) | (z * z_1 <= 0.0) | (jnp.abs(c * dy) > 1.0)
        y_1, v_1, z_1, c_1, kick_v, kick_y = jax.lax.cond(
            kinked,
            lambda: _through_kinks(step, state, push[2], y_1, v_1),
            lambda: (y_1, v_1, z_1, c, jnp.zeros_like(v_1), jnp.zeros_like(v_1)),
        )
    else:
        y_1, v_1, r, rate = kept((y_1, v_1, r, rate))
        y_1, v_1, z_1, c_1, kick_v, kick_y = kept(_through_kinks(step, state, push[2], y_1, v_1))
    change, rate_1 = z_1 - step.alpha * y_1 - r, -step.dt * c_1 * v_1 * z_1
    if step.restoring is not None:
        f, f_rate = _smooth(step, y_1, v_1)
        change, rate_1 = change + f, rate_1 + f_rate
    if not branch:
        change, rate_1 = kept((change, rate_1))
    dy = kick_y - (step.d_y * change + step.a_y * rate + step.b_y * rate_1)
    if not branch:
        dy = kept(dy)
    dv = kick_v - (step.d_v * change + step.a_v * rate + step.b_v * rate_1)
    return y_1 + dy, v_1 + dv, z_1 + (step.alpha - c_1 * z_1) * dy


def _through_kinks(
    step: ExactStep, state: State, u: Scalar, y_1: Scalar, v_1: Scalar
) -> tuple[Scalar, ...]:
    """End of a step that may hold a turning point, a zero of z, or both.

    Returns:
        Predicted y and v at the end, z there, its slope constant c, and what is still to be added
        to the predicted v and y: the kicks, less what the predictor already holds.
    """
    y, v, z = state
    h = step.dt
    shift_y, shift_v, a = _second_order(step, state, u)
    turns = (v * v_1 < 0.0) & (v * (v_1 + shift_v) < 0.0)
    shift_y, shift_v = (jnp.where(turns, x, 0.0) for x in (shift_y, shift_v))
    y_1, v_1 = kept((y_1 + shift_y, v_1 + shift_v))
    start, end, rise = h * v, h * v_1, y_1 - y
    lift = kept(jnp.where(turns, 0.5 * h**2 * a - (3.0 * rise - 2.0 * start - end), 0.0))
    law = (step.alpha, step.delta, step.gamma)
    z_1, kick_v, kick_y = kinked_step(law, z, (start, end, rise), lift)
    c_1 = signed(step.gamma, v_1) + signed(step.delta, z_1)
    return y_1, v_1, z_1, c_1, h * kick_v - shift_v, h**2 * kick_y - shift_y


def _second_order(step: ExactStep, state: State, u: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    r"""What $\ddot r$ on the branch of the start adds to y and v, and the acceleration there.

    A turning point is of the motion before it, so that this predicts it.
    """
    y, v, z = state
    c = signed(step.gamma, v) + signed(step.delta, z)
    a = u - step.damping * v - step.stiffness * y - (z - step.alpha * y)
    if step.restoring is not None:
        a = a - step.restoring(y)
    half = -0.5 * step.dt**2 * c * (a * z + v**2 * (step.alpha - c * z))
    if step.restoring is not None:
        _, bend = jax.jvp(lambda y, v: _smooth(step, y, v)[1], (y, v), (v, a))
        half = half + 0.5 * step.dt * bend
    # W_2 = b - a of the corrector's constants.
    return kept(((step.a_y - step.b_y) * half, (step.a_v - step.b_v) * half, a))


def _smooth(step: ExactStep, y: Scalar, v: Scalar) -> tuple[Scalar, Scalar]:
    """The restoring force f(y), and h times its rate f'(y) v."""
    force = cast(Restoring, step.restoring)
    return jax.jvp(force, (y,), (step.dt * v,))
