r"""The Bouc-Wen force in a time step that contains a turning point, a zero of z, or both.

The residual force $r = z - \alpha y$ has jumps of its second and third derivative: at a turning
point $J_2 = -2\gamma|\dot v|z$, $J_3 = -2\gamma\,\mathrm{sgn}(v_1)\,\ddot v z$; at a zero of z $J_2
= -2\alpha\delta v|v|$, $J_3 = -6\alpha\delta|v|\dot v + 4\alpha\gamma\delta v^3$. Impulses on v and
y compensate them: with J_2 the state is of order 4, and with J_3 its derivatives are too. The
derivatives are written out, because automatic differentiation costs several times as much.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from jbw.oscillator.kinks import (
    CubicPath,
    Ends,
    KinkImpulse,
    PathSlopes,
    barrier,
    hermite,
    hermite_basis,
    kink_impulse,
    passage,
    signed,
    turning_point,
)
from jbw.oscillator.laws.piecewise_map import MoveSlopes, TwoMoves, two_moves
from jbw.oscillator.parameters import Scalar

# Derivatives with respect to delta, gamma, z, the slopes at start and end, the displacement and the
# quartic term.
Slopes = tuple[Scalar, ...]
Law = tuple[Scalar, Scalar, Scalar]


class _Motion(NamedTuple):
    """The path of a step: turning point, curvature there, and the moves before and after it."""

    path: CubicPath
    turns: Bool[Array, "..."]
    fraction: Scalar
    sharpness: Scalar
    moves: TwoMoves


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
    """Return z at the end of a step, the changes by kinks over h and h^2, and all derivatives.

    Under jit the derivatives are computed only if they are used.
    """
    motion = _motion(law, z, ends, quartic)
    fraction_slopes, sharpness_slopes, by_path, by_quartic = _turn_slopes(motion, ends, quartic)
    z_1 = motion.moves.end
    turn_slopes = _along(motion.moves.turn_slopes, by_path, by_quartic)
    end_slopes = _along(motion.moves.end_slopes, by_path, by_quartic)
    turn, turn_impulses = _turn_impulse(
        law, ends, motion, turn_slopes, sharpness_slopes, fraction_slopes
    )
    zero, zero_impulses = _zero_impulse(law, z, motion, end_slopes)
    impulses = (barrier(_sum(*pair)) for pair in zip(turn_impulses, zero_impulses, strict=True))
    return (z_1, turn.v + zero.v, turn.y + zero.y), (end_slopes, *impulses)


def _motion(law: Law, z: Scalar, ends: Ends, quartic: Scalar) -> _Motion:
    """Return the path of a step, its turning point, and the hysteretic force z along it."""
    start, end, rise = ends
    turns = jnp.asarray(start * end < 0.0)
    path = barrier(hermite(*ends))
    fraction, sharpness = turning_point(turns, path)
    weight = (fraction * (1.0 - fraction)) ** 2
    before = barrier(jnp.where(turns, path.move(fraction) + quartic * weight, rise))
    directions = jnp.where(start == 0.0, end, start), end
    moves = two_moves(*law, z, (before, rise - before), directions)
    return _Motion(path, turns, fraction, sharpness, moves)


def _turn_slopes(
    motion: _Motion, ends: Ends, quartic: Scalar
) -> tuple[PathSlopes, PathSlopes, PathSlopes, Scalar]:
    """Return derivatives of turning point, curvature and first move with respect to the path.

    Because the cubic is flat there, its move depends only on the path and not on where it turns.
    """
    move, slope, bend = hermite_basis(motion.fraction)
    per_bend = barrier(jnp.where(motion.turns, signed(1.0 / motion.sharpness, ends[0]), 0.0))
    fraction = PathSlopes(*barrier(tuple(per_bend * x for x in slope)))
    sign = -signed(1.0, ends[0])
    twist = 6.0 * motion.path.c_3
    sharpness = (sign * (b + twist * f) for b, f in zip(bend, fraction, strict=True))
    s = motion.fraction
    weight = s * (1.0 - s)
    shift = 2.0 * quartic * weight * (1.0 - 2.0 * s)
    move = (m + shift * f for m, f in zip(move, fraction, strict=True))
    return (
        fraction,
        PathSlopes(*barrier(tuple(sharpness))),
        PathSlopes(*barrier(tuple(move))),
        barrier(weight**2),
    )


def _along(moves: MoveSlopes, by_path: PathSlopes, by_quartic: Scalar) -> Slopes:
    delta, gamma, z, first, second = moves
    more = first - second
    start, end, rise = (more * x for x in by_path)
    return barrier((delta, gamma, z, start, end, rise + second, more * by_quartic))


def _turn_impulse(
    law: Law,
    ends: Ends,
    motion: _Motion,
    z_slopes: Slopes,
    sharpness_slopes: PathSlopes,
    fraction_slopes: PathSlopes,
) -> tuple[KinkImpulse, tuple[Slopes, Slopes]]:
    """Return how a reversal corrects velocity v and displacement y of a step, with derivatives."""
    gamma, z = law[2], motion.moves.turn
    twice = jnp.where(motion.turns, -2.0, 0.0)
    sharpness, twist = motion.sharpness, signed(6.0 * motion.path.c_3, ends[1])
    impulse = kink_impulse(
        1.0 - motion.fraction, twice * gamma * sharpness * z, twice * gamma * twist * z
    )
    six = signed(6.0, ends[1])
    twist_slopes = PathSlopes(six, six, -2.0 * six)

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
    law: Law, z: Scalar, motion: _Motion, end_slopes: Slopes
) -> tuple[KinkImpulse, tuple[Slopes, Slopes]]:
    """Return how the zero of the force z changes v and y of a step, with derivatives."""
    alpha, delta, gamma = law
    path, z_1 = motion.path, motion.moves.end
    crosses = z * z_1 < 0.0
    steady = crosses & ~motion.turns
    share = barrier(1.0 / jnp.where(crosses, z - z_1, 1.0))
    s = passage(steady, path, z * share, motion.moves.zero)  # pyright: ignore[reportArgumentType]
    speed, bend = barrier((path.slope(s), path.bend(s)))
    size = jnp.abs(speed)
    twice = jnp.where(crosses, -2.0 * alpha, 0.0)
    shape_2, shape_3 = speed * size, 3.0 * size * bend - 2.0 * gamma * speed**3
    shape_2, shape_3 = barrier((twice * shape_2, twice * shape_3))
    impulse = kink_impulse(1.0 - s, delta * shape_2, delta * shape_3)

    # Where the path does not turn, the exact map gives the zero of z; elsewhere linear
    # interpolation gives it.
    move_basis, slope_basis, bend_basis = (barrier(tuple(b)) for b in hermite_basis(s))
    per_speed = barrier(jnp.where(steady, 1.0 / jnp.where(steady, speed, 1.0), 0.0))
    chord = jnp.where(steady, 0.0, share**2)
    zero = motion.moves.zero_slopes
    targets = (zero.delta, zero.gamma, zero.z, *(-x for x in move_basis), 0.0)
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


def _sum(first: Sequence[Scalar], second: Sequence[Scalar]) -> Slopes:
    return tuple(a + b for a, b in zip(first, second, strict=True))
