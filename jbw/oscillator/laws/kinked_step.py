r"""The Bouc-Wen force in a time step that contains a turning point, a zero of z, or both.

The residual force $r = z - \alpha y$ has jumps of its second and third derivative: at a turning
point $J_2 = -2\gamma|\dot v|z$, $J_3 = -2\gamma\,\mathrm{sgn}(v_1)\,\ddot v z$; at a zero of z $J_2
= -2\alpha\delta v|v|$, $J_3 = -6\alpha\delta|v|\dot v + 4\alpha\gamma\delta v^3$. Impulses on v and
y compensate them: with J_2 the state is of order 4, and with J_3 its derivatives are too. The
derivatives are written out, because automatic differentiation costs several times as much.
"""

import jax
import jax.numpy as jnp

from jbw.oscillator.kinks import (
    Ends,
    KinkImpulse,
    StepPath,
    barrier,
    hermite_basis,
    kink_impulse,
    signed,
)
from jbw.oscillator.laws.piecewise_map import Moved, two_moves
from jbw.oscillator.parameters import Scalar

# Derivatives with respect to delta, gamma, z, the slopes at start and end, the displacement and the
# quartic term.
Slopes = tuple[Scalar, ...]
Law = tuple[Scalar, Scalar, Scalar]


@jax.custom_jvp
def kinked_step(law: Law, z: Scalar, ends: Ends, quartic: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """Return the force z at the end of a step, and the kinks' effect on v/h and y/h^2 [m/s^2].

    Without the path's quartic term, (h d/dt)^4 y / 24 [m], the turning point would only be of order
    4, and its derivatives of order 3, because they move it within the step.
    """
    return _kinked(law, z, ends, quartic)[0]


@kinked_step.defjvp
def _kinked_step_jvp(primals, tangents):
    (alpha, *_), z, *_ = primals
    (alpha_dot, delta_dot, gamma_dot), z_dot, ends_dot, quartic_dot = tangents
    values, slopes = _kinked(*primals)
    dots = (delta_dot, gamma_dot, z_dot, *ends_dot, quartic_dot)

    def total(value, slopes):
        # All results are proportional to alpha if z is scaled with alpha. This gives their
        # derivatives with respect to alpha.
        by_alpha = barrier((value - z * slopes[2]) / alpha)
        return by_alpha * alpha_dot + sum(s * x for s, x in zip(slopes, dots, strict=True))

    return values, tuple(total(*pair) for pair in zip(values, slopes, strict=True))


def _kinked(
    law: Law, z: Scalar, ends: Ends, quartic: Scalar
) -> tuple[tuple[Scalar, Scalar, Scalar], tuple[Slopes, ...]]:
    """Return z at the step's end, the changes by kinks divided by h and h^2, and all derivatives.

    Under jit the derivatives are computed only if they are used.
    """
    start, end, _ = ends
    path = StepPath.through(ends, quartic)
    directions = jnp.where(start == 0.0, end, start), end
    turned, ended, zero = two_moves(*law, z, (path.before, path.after), directions)
    fraction_slopes, sharpness_slopes, by_path, by_quartic = _turn_slopes(path, start)
    force_slopes = []  # derivatives of z at the turning point and at the end of the step
    for _, (by_delta, by_gamma, by_z, by_first, by_second) in (turned, ended):
        more = by_first - by_second
        by_start, by_end, by_rise = (more * x for x in by_path)
        slopes = by_delta, by_gamma, by_z, by_start, by_end, by_rise + by_second, more * by_quartic
        force_slopes.append(barrier(slopes))
    turn_slopes, end_slopes = force_slopes
    at_turn, turn_impulses = _turn_impulse(
        law, end, path, (turned[0], turn_slopes), sharpness_slopes, fraction_slopes
    )
    at_zero, zero_impulses = _zero_impulse(law, (z, ended[0]), path, zero, end_slopes)
    impulses = (
        barrier(tuple(a + b for a, b in zip(*pair, strict=True)))
        for pair in zip(turn_impulses, zero_impulses, strict=True)
    )
    return (ended[0], at_turn.v + at_zero.v, at_turn.y + at_zero.y), (end_slopes, *impulses)


def _turn_slopes(path: StepPath, start: Scalar) -> tuple[Ends, Ends, Ends, Scalar]:
    """Return derivatives of turning point, curvature and first move with respect to the path.

    Because the cubic is flat there, its move depends only on the path and not on where it turns.
    """
    s = path.fraction
    move, slope, bend = hermite_basis(s)
    per_bend = barrier(jnp.where(path.turns, signed(1.0 / path.sharpness, start), 0.0))
    fraction = barrier(tuple(per_bend * x for x in slope))
    sign = -signed(1.0, start)
    twist = 6.0 * path.cubic.c_3
    sharpness = (sign * (b + twist * f) for b, f in zip(bend, fraction, strict=True))
    weight = s * (1.0 - s)
    shift = 2.0 * path.quartic * weight * (1.0 - 2.0 * s)
    move = (m + shift * f for m, f in zip(move, fraction, strict=True))
    return fraction, barrier(tuple(sharpness)), barrier(tuple(move)), barrier(weight**2)


def _turn_impulse(
    law: Law,
    end: Scalar,
    path: StepPath,
    force: tuple[Scalar, Slopes],
    sharpness_slopes: Ends,
    fraction_slopes: Ends,
) -> tuple[KinkImpulse, tuple[Slopes, Slopes]]:
    """Return how a reversal corrects velocity v and displacement y of a step, with derivatives.

    `force` is z at the turning point, with its derivatives; `end` is the path's slope at its end.
    """
    gamma, (z, z_slopes) = law[2], force
    twice = jnp.where(path.turns, -2.0, 0.0)
    sharpness, twist = path.sharpness, signed(6.0 * path.cubic.c_3, end)
    impulse = kink_impulse(
        1.0 - path.fraction, twice * gamma * sharpness * z, twice * gamma * twist * z
    )
    six = signed(6.0, end)
    twist_slopes = six, six, -2.0 * six

    def by_path(weights):
        by_fraction, by_2, by_3 = weights
        by_z = twice * gamma * (by_2 * sharpness + by_3 * twist)
        by_gamma = twice * z * (by_2 * sharpness + by_3 * twist)
        by_2, by_3 = twice * gamma * z * by_2, twice * gamma * z * by_3
        by_z, by_gamma, by_2, by_3 = barrier((by_z, by_gamma, by_2, by_3))
        delta, gamma_, z_, *path, quartic = (by_z * x for x in z_slopes)
        path = (
            p + by_2 * a + by_3 * b - by_fraction * s
            for p, a, b, s in zip(
                path, sharpness_slopes, twist_slopes, fraction_slopes, strict=True
            )
        )
        return delta, gamma_ + by_gamma, z_, *path, quartic

    return impulse, (by_path(impulse.v_slopes), by_path(impulse.y_slopes))


def _zero_impulse(
    law: Law,
    forces: tuple[Scalar, Scalar],
    step_path: StepPath,
    zero: Moved,
    end_slopes: Slopes,
) -> tuple[KinkImpulse, tuple[Slopes, Slopes]]:
    """Return the changes of v and y in a step due to a zero of the force z, with derivatives.

    `forces` is z at the start and at the end, and `zero` the move from the start to its zero.
    """
    alpha, delta, gamma = law
    (z, z_1), path = forces, step_path.cubic
    move_to_zero, (zero_delta, zero_gamma, zero_z, *_) = zero
    crosses = z * z_1 < 0.0
    steady = crosses & ~step_path.turns
    share = barrier(1.0 / jnp.where(crosses, z - z_1, 1.0))
    # One Newton step from linear interpolation has an error of O(h^3).
    guess: Scalar = z * share
    slope = jnp.where(steady, path.slope(guess), 1.0)
    s = barrier(guess - jnp.where(steady, (path.move(guess) - move_to_zero) / slope, 0.0))
    speed, bend = barrier((path.slope(s), path.bend(s)))
    size = jnp.abs(speed)
    twice = jnp.where(crosses, -2.0 * alpha, 0.0)
    shape_2, shape_3 = speed * size, 3.0 * size * bend - 2.0 * gamma * speed**3
    shape_2, shape_3 = barrier((twice * shape_2, twice * shape_3))
    impulse = kink_impulse(1.0 - s, delta * shape_2, delta * shape_3)

    # Where the path does not turn, the exact map gives the zero of z; elsewhere linear
    # interpolation gives it.
    move_basis, slope_basis, bend_basis = map(barrier, hermite_basis(s))
    per_speed = barrier(jnp.where(steady, 1.0 / jnp.where(steady, speed, 1.0), 0.0))
    chord = jnp.where(steady, 0.0, share**2)
    targets = (zero_delta, zero_gamma, zero_z, *(-x for x in move_basis), 0.0)
    s_slopes = tuple(
        per_speed * a + chord * z * b for a, b in zip(targets, end_slopes, strict=True)
    )
    s_slopes = barrier((*s_slopes[:2], s_slopes[2] - chord * z_1, *s_slopes[3:]))
    scale = twice * delta

    def by_all(weights):
        by_fraction, by_2, by_3 = weights
        by_speed = scale * (
            2.0 * by_2 * size + by_3 * (signed(3.0, speed) * bend - 6.0 * gamma * speed**2)
        )
        by_bend = scale * by_3 * 3.0 * size
        by_s = by_speed * bend + by_bend * 6.0 * path.c_3 - by_fraction
        by_speed, by_bend, by_s = barrier((by_speed, by_bend, by_s))
        by_delta, by_gamma, by_z, *by_path, by_quartic = (by_s * x for x in s_slopes)
        by_path = (
            x + by_speed * a + by_bend * b
            for x, a, b in zip(by_path, slope_basis, bend_basis, strict=True)
        )
        by_delta = by_delta + by_2 * shape_2 + by_3 * shape_3
        by_gamma = by_gamma - 2.0 * scale * by_3 * speed**3
        return by_delta, by_gamma, by_z, *by_path, by_quartic

    return impulse, (by_all(impulse.v_slopes), by_all(impulse.y_slopes))
