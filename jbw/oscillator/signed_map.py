r"""Exact monotone moves of z for nu = 1 in signed form, cheap enough for a time step.

On one branch $dz/dy = \alpha - c z$ with
$c = \gamma\,\mathrm{sgn}\,\dot y + \delta\,\mathrm{sgn}\,z$, so a signed move dy gives
$z + (\alpha - c z)\,dy\,P(c\,dy)$, $P(x) = (1 - e^{-x})/x$: no absolute values, no 0/0, and no
logarithm unless z changes sign.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float
from numpy.polynomial import Chebyshev, Polynomial

from jbw.oscillator.parameters import Scalar


def _interpolated(function: Callable, upper: float, degree: int, lower: float = 0.0) -> list[float]:
    """Power coefficients of the Chebyshev interpolant of a function on [lower, upper]."""
    fit = Chebyshev.interpolate(function, degree, domain=[lower, upper])
    return [float(c) for c in fit.convert(kind=Polynomial).coef]


def _expm1_ratio(x: np.ndarray) -> np.ndarray:
    """P(x), with its limit at 0."""
    return np.where(x == 0.0, 1.0, -np.expm1(-x) / np.where(x == 0.0, 1.0, x))


# P on [-1, 1]; error 3e-15: a bias here shifts the stiffness, and the phase adds it up.
_P = _interpolated(_expm1_ratio, 1.0, 12, -1.0)
# Its derivative on the same interval, in gradients only; error 1e-11.
_P_SLOPE = _interpolated(lambda x: (np.expm1(-x) + x * np.exp(-x)) / x**2, 1.0, 9, -1.0)
# atanh(t)/t as a function of t^2, t up to tanh(1/2); error 1e-13.
_ATANH = _interpolated(lambda s: np.arctanh(np.sqrt(s)) / np.sqrt(s), np.tanh(0.5) ** 2, 9)


def signed(magnitude: Scalar, sign: Scalar) -> Float[Array, "..."]:
    """Magnitude with its sign turned where `sign` is negative; zero counts as positive."""
    return jnp.where(sign < 0.0, -magnitude, magnitude)


def kept(values: Any) -> Any:
    """The values, computed once: XLA would fuse and recompute them in each of their uses."""
    # One by one: a barrier over several values cannot be transposed when not all are linear.
    return jax.tree.map(jax.lax.optimization_barrier, values)


def _polynomial(terms: list, x: Scalar) -> Scalar:
    """Sum of terms[n] x^n by Estrin's scheme: few dependent operations."""
    while len(terms) > 1:
        odd = terms[-1:] if len(terms) % 2 else []
        terms = [a + b * x for a, b in zip(terms[::2], terms[1::2], strict=False)] + odd
        x = x * x
    return terms[0]


def saturation(x: Scalar) -> Scalar:
    """P(x) = (1 - exp(-x))/x for |x| <= 1."""
    return _polynomial(_P, x)


def _far_saturation(x: Scalar) -> Scalar:
    """P(x) for |x| <= 4, through P(2x) = P(x) (1 - x P(x)/2)."""
    x = 0.25 * x
    p = kept(saturation(x))
    p = p * (1.0 - 0.5 * x * p)
    return kept(p * (1.0 - x * p))


def leg_bend(x: Scalar) -> Scalar:
    """P'(x) for |x| <= 4, through 2 P'(2x) = P'(x) (1 - x P(x)) - P(x)^2/2."""
    x = 0.25 * x
    p, slope = kept((saturation(x), _polynomial(_P_SLOPE, x)))
    slope = 0.5 * slope * (1.0 - x * p) - 0.25 * p**2
    p = p * (1.0 - 0.5 * x * p)
    return kept(0.5 * slope * (1.0 - 2.0 * x * p) - 0.25 * p**2)


def smooth_move(alpha: Scalar, c: Scalar, z: Scalar, dy: Scalar) -> Scalar:
    r"""Force z after a move dy along one branch, $|c\,dy| \le 1$.

    $$z + (\alpha - c z)\,dy\,P(c\,dy)$$
    """
    return z + (alpha - c * z) * dy * saturation(c * dy)


def leg(alpha: Scalar, c: Scalar, z: Scalar, dy: Scalar) -> tuple[Scalar, Scalar]:
    r"""Force z after a move dy along one branch, $|c\,dy| \le 4$, and $\phi$.

    $$z_1 = z + (\alpha - c z)\,\phi, \quad \phi = dy\,P(c\,dy), \qquad
      \partial_{dy} z_1 = \alpha - c z_1, \quad \partial_z z_1 = 1 - c\phi, \quad
      \partial_c z_1 = (\alpha - c z)\,dy^2 P'(c\,dy) - z\phi$$
    """
    phi = dy * _far_saturation(c * dy)
    return kept((z + (alpha - c * z) * phi, phi))


@jax.custom_jvp
def distance(c: Scalar, w: Scalar) -> Scalar:
    r"""Distance d from z = 0 to $z = \alpha w$ along one branch, $|c d| \le 4$.

    $$d = -\frac{\log(1 - c w)}{c}$$

    With $q = (1 - c w)^{1/4}$ it is $8 w\,\mathrm{atanh}(t)/t / ((1 + q)^2 (1 + q^2))$,
    $t = (1 - q)/(1 + q)$: no cancellation at c w = 0.
    """
    q_2 = jnp.sqrt(1.0 - c * w)
    q = jnp.sqrt(q_2)
    scale = 1.0 / ((1.0 + q) ** 2 * (1.0 + q_2))
    scale = kept(scale)
    return kept(8.0 * w * scale * _polynomial(_ATANH, (c * w * scale) ** 2))


@partial(distance.defjvp, symbolic_zeros=True)
def _distance_jvp(primals, tangents):
    c, w = primals
    d = distance(c, w)
    return d, _total(
        d,
        tangents,
        lambda: -(d**2) * leg_bend(c * d) / (1.0 - c * w),
        lambda: 1.0 / (1.0 - c * w),
    )


def _total(out: Scalar, tangents: tuple, *partials: Callable[[], Scalar]) -> Scalar:
    """Total derivative: only the partial derivatives that are asked for are computed."""
    terms = [
        kept(derivative()) * tangent
        for derivative, tangent in zip(partials, tangents, strict=True)
        if not isinstance(tangent, SymbolicZero)
    ]
    return sum(terms, jnp.zeros_like(out))
