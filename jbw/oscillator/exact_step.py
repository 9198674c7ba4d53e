r"""The hysteresis-exact step: true order 4 through the kinks at v = 0 and z = 0, for nu = 1.

With the stiffness alpha y moved to the exactly solved linear part, the joint acts through the
small residual force $r = z - \alpha y$, whose rate $\dot r = -v z\,(\gamma\,\mathrm{sgn}\,v +
\delta\,\mathrm{sgn}\,z)$ is continuous. One step predicts (y, v) with r and its rate, moves z
exactly, and corrects (y, v) with the cubic through r and its rate at both ends. The jumps of the
second derivative of r at a kink inside the step are paid back as one impulse on v.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from jbw.oscillator.moments import impulse_moments
from jbw.oscillator.parameters import BoucWen, Scalar
from jbw.oscillator.signed_map import distance, kept, move, signed, smooth_move

NUM_MOMENTS = 6
State = tuple[Scalar, Scalar, Scalar]
Pair = tuple[Scalar, Scalar]


class ExactStep(eqx.Module):
    """Constants of the step, made once per set of parameters; all leaves are scalars.

    `e_*` move (y, v) freely; `r_*`, `s_*` are the effect of r and of h times its rate in the
    predictor; `d_*`, `a_*`, `b_*` those of the change of r and of its two rates in the corrector.
    """

    alpha: Scalar
    delta: Scalar
    gamma: Scalar
    dt: Scalar
    e_11: Scalar
    e_12: Scalar
    e_21: Scalar
    e_22: Scalar
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


def exact_step(joint: BoucWen, dt: Scalar) -> tuple[ExactStep, Array, Array]:
    """Constants of the hysteresis-exact step of length dt.

    Args:
        joint: Bouc-Wen parameters, nu = 1.
        dt: Step [s].

    Returns:
        The constants, and the input moments W_j of displacement [s^2] and velocity [s].
    """
    m = impulse_moments(joint.omega_n**2, 2.0 * joint.zeta * joint.omega_n, dt, NUM_MOMENTS)
    (y_0, y_1, y_2, y_3), (v_0, v_1, v_2, v_3) = (
        tuple(w[..., j] for j in range(4)) for w in (m.y, m.v)
    )
    # fmt: off
    step = ExactStep(
        joint.alpha, joint.delta, joint.gamma, dt, m.e_11, m.e_12, m.e_21, m.e_22,
        r_y=y_0, r_v=v_0, s_y=y_1, s_v=v_1,
        d_y=3.0 * y_2 - 2.0 * y_3, d_v=3.0 * v_2 - 2.0 * v_3,
        a_y=y_3 - 2.0 * y_2, a_v=v_3 - 2.0 * v_2, b_y=y_3 - y_2, b_v=v_3 - v_2,
    )
    # fmt: on
    return jax.tree.map(jnp.asarray, step), m.y, m.v


def advance(step: ExactStep, state: State, push: Pair, *, branch: bool) -> State:
    r"""One hysteresis-exact step.

    $$q_1 = E q + p - W_0 r - W_1 h\dot r, \quad z_1 = M(z, y_1 - y), \quad
      q_2 = q_1 - W_2 c_2 - W_3 c_3, \quad z_2 = z_1 + z'(z_1)(y_2 - y_1)$$

    with $c_2 = 3d - h(2\dot r + \dot r_1)$, $c_3 = -2d + h(\dot r + \dot r_1)$, $d = r_1 - r$.

    Args:
        step: Constants of the step.
        state: (y, v, z) at its start.
        push: What the input adds to (y, v) in this step.
        branch: Whether the kinks are handled under `lax.cond` (quick for scalars) or always.

    Returns:
        (y, v, z) at its end.
    """
    y, v, z = state
    c = signed(step.gamma, v) + signed(step.delta, z)
    r = z - step.alpha * y
    rate = -step.dt * c * v * z
    y_1 = step.e_11 * y + step.e_12 * v + push[0] - step.r_y * r - step.s_y * rate
    v_1 = step.e_21 * y + step.e_22 * v + push[1] - step.r_v * r - step.s_v * rate
    if branch:
        dy = y_1 - y
        z_1 = smooth_move(step.alpha, c, z, dy)
        kinked = (v * v_1 <= 0.0) | (z * z_1 <= 0.0) | (jnp.abs(c * dy) > 1.0)
        z_1, c_1, kick = jax.lax.cond(
            kinked,
            lambda: _through_kinks(step, state, y_1, v_1),
            lambda: (z_1, c, jnp.zeros_like(v_1)),
        )
    else:
        y_1, v_1, r, rate = kept((y_1, v_1, r, rate))
        z_1, c_1, kick = kept(_through_kinks(step, state, y_1, v_1))
    change, rate_1 = z_1 - step.alpha * y_1 - r, -step.dt * c_1 * v_1 * z_1
    if not branch:
        change, rate_1 = kept((change, rate_1))
    dy = -(step.d_y * change + step.a_y * rate + step.b_y * rate_1)
    if not branch:
        dy = kept(dy)
    dv = kick - (step.d_v * change + step.a_v * rate + step.b_v * rate_1)
    return y_1 + dy, v_1 + dv, z_1 + (step.alpha - c_1 * z_1) * dy


def _through_kinks(step: ExactStep, state: State, y_1: Scalar, v_1: Scalar) -> State:
    r"""End of a step with a turning point or a zero of z: z, its slope constant, the kick on v.

    A jump J of the second derivative of r when a fraction x of the step remains leaves the cubic
    an error that kicks v by $-(h^3/12)\,J\,x(2x-1)(x-1)$; J is $-2\gamma|\dot v| z$ at a turning
    point and $-2\delta\alpha v|v|$ at a zero of z.
    """
    y, v, z = state
    turns = v * v_1 < 0.0
    fraction, before, after = _turning_point(turns, step.dt * v, step.dt * v_1, y_1 - y)
    fraction, before, after = kept((fraction, before, after))
    z_turn, z_1 = _two_moves(step, z, (before, after), (jnp.where(v == 0.0, v_1, v), v_1))
    h_6 = step.dt**2 / 6.0
    kick = h_6 * step.gamma * jnp.abs(v_1 - v) * z_turn * _kink_weight(1.0 - fraction)
    crosses = z * z_1 < 0.0
    remaining = kept(z_1 / jnp.where(crosses, z_1 - z, 1.0))
    v_zero = kept(v + (v_1 - v) * (1.0 - remaining))
    zero = step.dt * h_6 * step.delta * step.alpha * v_zero * jnp.abs(v_zero)
    kick = jnp.where(turns, kick, 0.0) + jnp.where(crosses, zero * _kink_weight(remaining), 0.0)
    return z_1, signed(step.gamma, v_1) + signed(step.delta, z_1), kick


def _two_moves(step: ExactStep, z: Scalar, moves: Pair, directions: Pair) -> Pair:
    """Force z after each of two monotone moves, of which one may lead through z = 0.

    Three legs: the first move as if z kept its sign; what is left of it after a zero, or else the
    second move; what is left of that after a zero, or else the second move.
    """
    alpha, delta = step.alpha, step.delta
    first, second = (signed(step.gamma, direction) for direction in directions)
    c = first + signed(delta, jnp.where(z == 0.0, directions[0], z))
    z_a = move(alpha, c, z, moves[0])
    early = z * z_a < 0.0
    c_b = jnp.where(early, first + signed(delta, directions[0]), second + signed(delta, z_a))
    # Signed distance from zero to z_a along the first leg's branch, or the second's.
    c_zero = jnp.where(early, c, c_b)
    c_b, c_zero = kept((c_b, c_zero))
    heading_to_zero = early | (z_a * directions[1] < 0.0)
    d = distance(c_zero, jnp.where(heading_to_zero, z_a, 0.0) / alpha)
    z_b = move(alpha, c_b, jnp.where(early, 0.0, z_a), jnp.where(early, d, moves[1]))
    late = ~early & (z_a * z_b < 0.0)
    c_c = second + jnp.where(late, signed(delta, directions[1]), signed(delta, z_b))
    rest = jnp.where(late, moves[1] + d, jnp.where(early, moves[1], 0.0))
    z_c = move(alpha, c_c, jnp.where(late, 0.0, z_b), rest)
    return jnp.where(early, z_b, z_a), z_c


def _kink_weight(x: Scalar) -> Scalar:
    return x * (2.0 * x - 1.0) * (x - 1.0)


def _turning_point(
    turns: Bool[Array, "..."], start: Scalar, end: Scalar, rise: Scalar
) -> tuple[Scalar, Scalar, Scalar]:
    """Extremum of the cubic with given end slopes and rise: its place, the moves on either side.

    The one root in (0, 1) of C + 2 B s + 3 A s^2, where C and the slope at s = 1 differ in sign.
    """
    b = 3.0 * rise - 2.0 * start - end
    a = start + end - 2.0 * rise
    root = kept(jnp.sqrt(jnp.where(turns, jnp.maximum(b**2 - 3.0 * a * start, 1e-300), 1.0)))
    s = kept(start / jnp.where(turns, signed(root, start) - b, 1.0))
    before = jnp.where(turns, s * (start + s * (b + s * a)), rise)
    return jnp.where(turns, s, 1.0), before, rise - before
