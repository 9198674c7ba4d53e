"""Two monotone moves of z, of which one may lead through z = 0, with closed-form slopes."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool

from jbw.oscillator.parameters import Scalar
from jbw.oscillator.signed_map import distance, kept, leg, leg_bend, signed

Pair = tuple[Scalar, Scalar]


class MoveSlopes(NamedTuple):
    """Derivatives of a result of two moves; alpha's follows from the scaling of (alpha, z)."""

    delta: Scalar
    gamma: Scalar
    z: Scalar
    first: Scalar
    second: Scalar


class TwoMoves(NamedTuple):
    """Force after each move, and the move at which z passes zero in the first.

    Attributes:
        turn: z after the first move [N/kg].
        end: z after the second [N/kg].
        zero: Signed move from the start to the zero of z, where the first move crosses it [m].
        turn_slopes: Derivatives of `turn`.
        end_slopes: Derivatives of `end`.
        zero_slopes: Derivatives of `zero`.
    """

    turn: Scalar
    end: Scalar
    zero: Scalar
    turn_slopes: MoveSlopes
    end_slopes: MoveSlopes
    zero_slopes: MoveSlopes


class _Leg(NamedTuple):
    """One monotone leg on one branch: signs of its terms in c, start, length, end and phi."""

    gamma_sign: Scalar
    delta_sign: Scalar
    c: Scalar
    start: Scalar
    length: Scalar
    end: Scalar
    phi: Scalar


class _Legs(NamedTuple):
    """The legs of two moves and which move, if one, crosses z = 0; `past` is its distance."""

    a: _Leg
    b: _Leg
    c: _Leg
    early: Bool[Array, "..."]
    late: Bool[Array, "..."]
    past: Scalar


def two_moves(
    alpha: Scalar, delta: Scalar, gamma: Scalar, z: Scalar, moves: Pair, directions: Pair
) -> TwoMoves:
    """Force z after each of two monotone moves, of which one may lead through z = 0.

    Args:
        alpha: Stiffness of the hysteretic part [1/s^2].
        delta: Softening [1/m].
        gamma: Opening [1/m].
        z: Force before the moves [N/kg].
        moves: Signed moves [m].
        directions: Their signs, also where a move is zero.

    Returns:
        The forces and their slopes; what is not asked for is not computed under jit.
    """
    legs = _legs(alpha, delta, gamma, z, moves, directions)
    a, b, c, early, late, past = legs
    length_a = jnp.where(early, past - moves[0], moves[0])
    length_b = jnp.where(early | late, past, moves[1])
    bend_a, bend_b, bend_c = (
        length**2 * leg_bend(leg.c * length)
        for leg, length in ((a, length_a), (b, length_b), (c, c.length))
    )
    # Slope of the signed distance to zero by the force there: 1/(alpha - c z).
    per_start = kept(1.0 / jnp.where(early, alpha - a.c * z, 1.0))
    per_turn = kept(1.0 / jnp.where(late, alpha - b.c * a.end, 1.0))
    slope_b, slope_c = kept((alpha - b.c * b.end, alpha - c.c * c.end))
    zero_a = alpha * bend_a * per_start
    by_a = kept(jnp.where(early, -slope_b * zero_a, (alpha - a.c * z) * bend_a - z * a.phi))
    by_z = kept(jnp.where(early, slope_b * per_start, 1.0 - a.c * a.phi))
    by_first = kept(jnp.where(early, slope_b, alpha - a.c * a.end))
    own_b = (alpha - b.c * b.start) * bend_b - b.start * b.phi
    turn_b = kept(jnp.where(early, own_b, 0.0))
    after = jnp.where(early, 1.0 - c.c * c.phi, 1.0 - b.c * b.phi)
    after = kept(jnp.where(late, slope_c * per_turn, after))
    end_b = jnp.where(late, -slope_c * alpha * bend_b * per_turn, own_b)
    end_b = kept(jnp.where(early, after * own_b, end_b))
    end_c = kept((alpha - c.c * c.start) * bend_c - c.start * c.phi)
    none = jnp.zeros_like(by_z)
    return TwoMoves(
        jnp.where(early, b.end, a.end),
        c.end,
        -length_a,
        MoveSlopes(*_by_law((a, by_a), (b, turn_b)), by_z, by_first, none),
        MoveSlopes(
            *_by_law((a, after * by_a), (b, end_b), (c, end_c)),
            after * by_z,
            after * by_first,
            slope_c,
        ),
        MoveSlopes(*_by_law((a, zero_a)), -per_start, none, none),
    )


def _by_law(*terms: tuple[_Leg, Scalar]) -> Pair:
    """Derivatives by delta and gamma from those by the constants c of the legs."""
    by_delta = sum((leg.delta_sign * by_c for leg, by_c in terms), 0.0)
    by_gamma = sum((leg.gamma_sign * by_c for leg, by_c in terms), 0.0)
    return kept((by_delta, by_gamma))


def _legs(
    alpha: Scalar, delta: Scalar, gamma: Scalar, z: Scalar, moves: Pair, directions: Pair
) -> _Legs:
    """Three legs: the first move as if z kept its sign; what is left of it after a zero, or else
    the second move; what is left of that after a zero, or else the second move.
    """  # noqa: D205

    def along(gamma_sign, delta_sign, start, length):
        c = kept(gamma_sign * gamma + delta_sign * delta)
        end, phi = leg(alpha, c, start, length)
        return _Leg(gamma_sign, delta_sign, c, start, length, end, phi)

    first, second = (signed(1.0, direction) for direction in directions)
    a = along(first, jnp.where(z == 0.0, first, signed(1.0, z)), z, moves[0])
    early = jnp.asarray(z * a.end < 0.0)
    sign_b = jnp.where(early, first, second), jnp.where(early, first, signed(1.0, a.end))
    # Signed distance from zero to a.end along the first leg's branch, or the second's.
    c_zero = kept(jnp.where(early, a.c, sign_b[0] * gamma + sign_b[1] * delta))
    heading_to_zero = early | (a.end * second < 0.0)
    past = distance(c_zero, jnp.where(heading_to_zero, a.end, 0.0) / alpha)
    b = along(*sign_b, jnp.where(early, 0.0, a.end), jnp.where(early, past, moves[1]))
    late = ~early & jnp.asarray(a.end * b.end < 0.0)
    sign_c = jnp.where(late, second, signed(1.0, b.end))
    rest = jnp.where(late, moves[1] + past, jnp.where(early, moves[1], 0.0))
    c = along(second, sign_c, jnp.where(late, 0.0, b.end), rest)
    return _Legs(a, b, c, early, late, past)
