r"""The exact Bouc-Wen force after a move in one direction, for nu = 1, fast enough for each step.

On one branch $dz/dy = \alpha - c z$ with
$c = \gamma\,\mathrm{sgn}\,\dot y + \delta\,\mathrm{sgn}\,z$, so a signed move dy gives
$z + (\alpha - c z)\,dy\,P(c\,dy)$, $P(x) = (1 - e^{-x})/x$: no absolute values, no 0/0, and no
logarithm unless z changes sign.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Bool
from numpy.polynomial import Chebyshev, Polynomial

from jbw.oscillator.kinks import barrier, signed
from jbw.oscillator.parameters import Scalar


def _interpolated(function: Callable, upper: float, degree: int, lower: float = 0.0) -> list[float]:
    """Return the power coefficients of a function's Chebyshev interpolant on [lower, upper]."""
    fit = Chebyshev.interpolate(function, degree, domain=[lower, upper])
    return [float(c) for c in fit.convert(kind=Polynomial).coef]


def _expm1_ratio(x: np.ndarray) -> np.ndarray:
    """Return P(x) = (1 - exp(-x))/x, with its limit 1 at x = 0."""
    return np.where(x == 0.0, 1.0, -np.expm1(-x) / np.where(x == 0.0, 1.0, x))


# P on [-1, 1] with an error of 3e-15. A larger error would shift the stiffness, and the phase error
# would grow along a record.
_P = _interpolated(_expm1_ratio, 1.0, 12, -1.0)
# Derivative of P on the same interval, for gradients only, with an error of 1e-11.
_P_SLOPE = _interpolated(lambda x: (np.expm1(-x) + x * np.exp(-x)) / x**2, 1.0, 9, -1.0)
# atanh(t)/t as a function of t^2, for t up to tanh(1/2), with an error of 1e-13.
_ATANH = _interpolated(lambda s: np.arctanh(np.sqrt(s)) / np.sqrt(s), np.tanh(0.5) ** 2, 9)


def _polynomial(terms: list, x: Scalar) -> Scalar:
    """Return the sum of terms[n] x^n by Estrin's scheme, whose operations run in parallel."""
    while len(terms) > 1:
        odd = terms[-1:] if len(terms) % 2 else []
        terms = [a + b * x for a, b in zip(terms[::2], terms[1::2], strict=False)] + odd
        x = x * x
    return terms[0]


def saturation_slope(x: Scalar) -> Scalar:
    """Return P'(x) for |x| <= 4, by 2 P'(2x) = P'(x) (1 - x P(x)) - P(x)^2/2."""
    x = 0.25 * x
    p, slope = barrier((_polynomial(_P, x), _polynomial(_P_SLOPE, x)))
    slope = 0.5 * slope * (1.0 - x * p) - 0.25 * p**2
    p = p * (1.0 - 0.5 * x * p)
    return barrier(0.5 * slope * (1.0 - 2.0 * x * p) - 0.25 * p**2)


def smooth_move(alpha: Scalar, c: Scalar, z: Scalar, dy: Scalar) -> Scalar:
    r"""Return the force z after a displacement dy along one branch, for $|c\,dy| \le 1$.

    $$z + (\alpha - c z)\,dy\,P(c\,dy)$$
    """
    return z + (alpha - c * z) * dy * _polynomial(_P, c * dy)


def segment(alpha: Scalar, c: Scalar, z: Scalar, dy: Scalar) -> tuple[Scalar, Scalar]:
    r"""Return z_1 and $\phi$: the force z_1 after a move dy along one branch, for $|c\,dy| \le 4$.

    $$z_1 = z + (\alpha - c z)\,\phi, \quad \phi = dy\,P(c\,dy), \qquad
      \partial_{dy} z_1 = \alpha - c z_1, \quad \partial_z z_1 = 1 - c\phi, \quad
      \partial_c z_1 = (\alpha - c z)\,dy^2 P'(c\,dy) - z\phi$$

    P is computed at a quarter of its argument, by $P(2x) = P(x) (1 - x P(x)/2)$.
    """
    x = 0.25 * (c * dy)
    p = barrier(_polynomial(_P, x))
    p = p * (1.0 - 0.5 * x * p)
    phi = dy * barrier(p * (1.0 - x * p))
    return barrier((z + (alpha - c * z) * phi, phi))


@jax.custom_jvp
def distance(c: Scalar, w: Scalar) -> Scalar:
    r"""Return the distance d from z = 0 to $z = \alpha w$ along one branch, $|c d| \le 4$.

    $$d = -\frac{\log(1 - c w)}{c}$$

    With $q = (1 - c w)^{1/4}$ it is $8 w\,\mathrm{atanh}(t)/t / ((1 + q)^2 (1 + q^2))$,
    $t = (1 - q)/(1 + q)$: no cancellation at c w = 0.
    """
    q_2 = jnp.sqrt(1.0 - c * w)
    q = jnp.sqrt(q_2)
    scale = 1.0 / ((1.0 + q) ** 2 * (1.0 + q_2))
    scale = barrier(scale)
    return barrier(8.0 * w * scale * _polynomial(_ATANH, (c * w * scale) ** 2))


@partial(distance.defjvp, symbolic_zeros=True)
def _distance_jvp(primals, tangents):
    c, w = primals
    d = distance(c, w)
    return d, _total(
        d,
        tangents,
        lambda: -(d**2) * saturation_slope(c * d) / (1.0 - c * w),
        lambda: 1.0 / (1.0 - c * w),
    )


def _total(out: Scalar, tangents: tuple, *partials: Callable[[], Scalar]) -> Scalar:
    """Return the total derivative, from only those partial derivatives that are needed."""
    terms = [
        barrier(derivative()) * tangent
        for derivative, tangent in zip(partials, tangents, strict=True)
        if not isinstance(tangent, SymbolicZero)
    ]
    return sum(terms, jnp.zeros_like(out))


Pair = tuple[Scalar, Scalar]
Meets = Bool[Array, "..."]


# The result of two successive moves, and its derivatives with respect to delta, gamma, the initial
# force z and the two moves. The derivative with respect to alpha follows from proportionality.
Moved = tuple[Scalar, tuple[Scalar, Scalar, Scalar, Scalar, Scalar]]


class _Segment(NamedTuple):
    """A monotone segment of a move in which z does not change its sign."""

    gamma_sign: Scalar
    delta_sign: Scalar
    c: Scalar
    start: Scalar
    length: Scalar
    end: Scalar
    phi: Scalar


def two_moves(
    alpha: Scalar, delta: Scalar, gamma: Scalar, z: Scalar, moves: Pair, directions: Pair
) -> tuple[Moved, Moved, Moved]:
    """Return the force z after each of two monotone moves, and the signed move to a zero of z.

    One of the moves may pass through z = 0; the third result is from the start to that point, if it
    is in the first move. Each result comes with its derivatives.
    """
    (a, b, c), (early, late), past = _segments(alpha, delta, gamma, z, moves, directions)
    length_a = jnp.where(early, past - moves[0], moves[0])
    length_b = jnp.where(early | late, past, moves[1])
    bend_a, bend_b, bend_c = (
        length**2 * saturation_slope(part.c * length)
        for part, length in ((a, length_a), (b, length_b), (c, c.length))
    )
    # Derivative of the distance to the zero of z with respect to the force: 1/(alpha - c z).
    per_start = barrier(1.0 / jnp.where(early, alpha - a.c * z, 1.0))
    per_turn = barrier(1.0 / jnp.where(late, alpha - b.c * a.end, 1.0))
    slope_b, slope_c = barrier((alpha - b.c * b.end, alpha - c.c * c.end))
    zero_a = alpha * bend_a * per_start
    by_a = barrier(jnp.where(early, -slope_b * zero_a, (alpha - a.c * z) * bend_a - z * a.phi))
    by_z = barrier(jnp.where(early, slope_b * per_start, 1.0 - a.c * a.phi))
    by_first = barrier(jnp.where(early, slope_b, alpha - a.c * a.end))
    own_b = (alpha - b.c * b.start) * bend_b - b.start * b.phi
    turn_b = barrier(jnp.where(early, own_b, 0.0))
    after = jnp.where(early, 1.0 - c.c * c.phi, 1.0 - b.c * b.phi)
    after = barrier(jnp.where(late, slope_c * per_turn, after))
    end_b = jnp.where(late, -slope_c * alpha * bend_b * per_turn, own_b)
    end_b = barrier(jnp.where(early, after * own_b, end_b))
    end_c = barrier((alpha - c.c * c.start) * bend_c - c.start * c.phi)
    none = jnp.zeros_like(by_z)
    turn_slopes = *_by_law((a, by_a), (b, turn_b)), by_z, by_first, none
    by_law = _by_law((a, after * by_a), (b, end_b), (c, end_c))
    end_slopes = *by_law, after * by_z, after * by_first, slope_c
    zero_slopes = *_by_law((a, zero_a)), -per_start, none, none
    turn = jnp.where(early, b.end, a.end)
    return (turn, turn_slopes), (c.end, end_slopes), (-length_a, zero_slopes)


def _by_law(*terms: tuple[_Segment, Scalar]) -> Pair:
    by_delta = sum((part.delta_sign * by_c for part, by_c in terms), 0.0)
    by_gamma = sum((part.gamma_sign * by_c for part, by_c in terms), 0.0)
    return barrier((by_delta, by_gamma))


def _segments(
    alpha: Scalar, delta: Scalar, gamma: Scalar, z: Scalar, moves: Pair, directions: Pair
) -> tuple[tuple[_Segment, _Segment, _Segment], tuple[Meets, Meets], Scalar]:
    """Divide two moves into three segments, each of which ends where z vanishes or a move ends.

    The first segment is the first move as if z kept its sign. Each other segment is the part of a
    move after a zero of z, or else the second move. It is also returned whether the first or the
    second move crosses z = 0, and the distance past zero.
    """

    def along(gamma_sign, delta_sign, start, length):
        c = barrier(gamma_sign * gamma + delta_sign * delta)
        end, phi = segment(alpha, c, start, length)
        return _Segment(gamma_sign, delta_sign, c, start, length, end, phi)

    first, second = (signed(1.0, direction) for direction in directions)
    a = along(first, jnp.where(z == 0.0, first, signed(1.0, z)), z, moves[0])
    early = jnp.asarray(z * a.end < 0.0)
    sign_b = jnp.where(early, first, second), jnp.where(early, first, signed(1.0, a.end))
    # Signed distance from zero to a.end along the branch of the first segment, or of the second.
    c_zero = barrier(jnp.where(early, a.c, sign_b[0] * gamma + sign_b[1] * delta))
    heading_to_zero = early | (a.end * second < 0.0)
    past = distance(c_zero, jnp.where(heading_to_zero, a.end, 0.0) / alpha)
    b = along(*sign_b, jnp.where(early, 0.0, a.end), jnp.where(early, past, moves[1]))
    late = ~early & jnp.asarray(a.end * b.end < 0.0)
    sign_c = jnp.where(late, second, signed(1.0, b.end))
    rest = jnp.where(late, moves[1] + past, jnp.where(early, moves[1], 0.0))
    c = along(second, sign_c, jnp.where(late, 0.0, b.end), rest)
    return (a, b, c), (early, late), past
