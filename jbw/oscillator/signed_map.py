r"""Exact monotone moves of z for nu = 1 in signed form, cheap enough for the inside of a time step.

On one branch $dz/dy = \alpha - c z$ with $c = \gamma\,\mathrm{sgn}\,\dot y + \delta\,\mathrm{sgn}\,z$,
so a signed move dy gives $z + (\alpha - c z)\,dy\,P(c\,dy)$, $P(x) = (1 - e^{-x})/x$: no absolute
values, no 0/0, and no logarithm unless z changes sign.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.polynomial import Chebyshev, Polynomial

from jbw.oscillator.parameters import Scalar

# Chebyshev interpolation of P on [-1, 1]; the error is below 2e-13 (degree 11).
_P = Chebyshev.interpolate(lambda x: -np.expm1(-x) / x, 11).convert(kind=Polynomial).coef
# Below this, -log(1 - x)/x goes by its series (AD of the quotient loses digits there).
_SMALL = 2e-2
_LOG_SERIES = tuple(1.0 / (n + 1.0) for n in range(9))


def signed(magnitude: Scalar, sign: Scalar) -> Float[Array, "..."]:
    """Magnitude with its sign turned where `sign` is negative; zero counts as positive."""
    return jnp.where(sign < 0.0, -magnitude, magnitude)


def saturation(x: Scalar) -> Float[Array, "..."]:
    """P(x) = (1 - exp(-x))/x for |x| <= 1, by Estrin's scheme."""
    terms = [float(c) for c in _P]
    while len(terms) > 1:
        terms = [terms[i] + terms[i + 1] * x for i in range(0, len(terms) - 1, 2)] + (
            terms[-1:] if len(terms) % 2 else []
        )
        x = x * x
    return terms[0]  # pyright: ignore[reportReturnType]


def smooth_move(alpha: Scalar, c: Scalar, z: Scalar, dy: Scalar) -> Float[Array, "..."]:
    r"""z after a move dy along one branch, $|c\,dy| \le 1$.

    $$z + (\alpha - c z)\,dy\,P(c\,dy)$$
    """
    return z + (alpha - c * z) * dy * saturation(c * dy)


def exact_move(
    alpha: Scalar, delta: Scalar, gamma: Scalar, z: Scalar, dy: Scalar, direction: Scalar
) -> Float[Array, "..."]:
    """z after any monotone move dy, through z = 0 where it lies on the way.

    Args:
        alpha: Stiffness [1/s^2].
        delta: Softening [1/m].
        gamma: Opening [1/m].
        z: Hysteretic force [N/kg].
        dy: Move [m].
        direction: Anything with the sign of dy.

    Returns:
        z after the move [N/kg].
    """
    along = signed(gamma, direction)
    away = along + signed(delta, direction)
    c = along + jnp.where(z == 0.0, signed(delta, direction), signed(delta, z))
    z_1 = z + (alpha - c * z) * _distance(c, dy)
    return jnp.where(z * z_1 < 0.0, cross(alpha, c, away, z * z_1 < 0.0, z_1), z_1)


def cross(
    alpha: Scalar, c: Scalar, away: Scalar, crosses: Scalar, z_1: Scalar
) -> Float[Array, "..."]:
    r"""z after a move that crossed zero, from the value z_1 that the branch before would reach.

    What is left of the move beyond zero is $d = -\log(1 - c z_1/\alpha)/c$; the branch after zero
    gives $\alpha\,d\,P(c' d)$.
    """
    w = z_1 / jnp.where(crosses, alpha, 1.0)
    x = jnp.where(crosses, c * w, 0.0)
    small = jnp.abs(x) < _SMALL
    x_large, x_small = jnp.where(small, 0.5, x), jnp.where(small, x, 0.0)
    series = sum(term * x_small**n for n, term in enumerate(_LOG_SERIES))
    left = w * jnp.where(small, series, -jnp.log1p(-x_large) / x_large)
    return alpha * _distance(away, jnp.where(crosses, left, 0.0))


def _distance(c: Scalar, dy: Scalar) -> Float[Array, "..."]:
    """(1 - exp(-c dy))/c for any c dy."""
    x = c * dy
    small = jnp.abs(x) <= 1.0
    large = jnp.where(small, 2.0, x)
    return dy * jnp.where(small, saturation(jnp.where(small, x, 0.0)), -jnp.expm1(-large) / large)
