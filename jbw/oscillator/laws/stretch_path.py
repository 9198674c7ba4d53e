r"""Long moves, tips and loops of Bouc-Wen's law of any exponent, by the way that a stretch takes.

$$D_c(w) = \int_0^w \frac{dt}{1 - c\,|t / \mathrm{1\,mm}|^\nu}$$

is the displacement after which the spring is stretched by w, c being d - g on the way to w = 0 and
d + g away from it. Its inverse is the law's exact map.
"""

from collections.abc import Callable
from typing import Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient
from jaxtyping import Array

from jbw.oscillator.kinks import signed
from jbw.oscillator.laws.powers import REFERENCE, power
from jbw.oscillator.parameters import Scalar

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(48)
# Gauss and Legendre's rule on [0, 1]; NumPy's, for JAX may be switched to float64 after this.
UNIT_RULE = 0.5 * (_NODES + 1.0), 0.5 * _WEIGHTS
_UNIT, _UNIT_WEIGHTS = UNIT_RULE
_HALVINGS, _FAR = 60, 16.0  # of the search for the tip's stretch, up to so many amplitudes


class StretchLaw(Protocol):
    """Parameters of `BoucWenNu`, by their names there."""

    nu_stiffness: Scalar
    nu_softening: Scalar
    nu_opening: Scalar
    nu: Scalar


def _way(c: Scalar, w: Scalar, nu: Scalar, weight: int = 0) -> Scalar:
    r"""$\int_0^w t^m / (1 - c|t/\mathrm{1\,mm}|^\nu)\,dt$ for w >= 0, m the `weight`.

    With t = w s^p, p such that the broken power is at least of second order at s = 0.
    """
    p = jnp.maximum(1.0, 2.0 / nu)
    unit = jnp.asarray(_UNIT)
    t = w * power(unit, p)
    bracket = 1.0 - c * power(t / REFERENCE, nu)
    return jnp.sum(_UNIT_WEIGHTS * p * power(unit, p - 1.0) * w * t**weight / bracket)


def _limit(c: Scalar, nu: Scalar) -> Scalar:
    """The stretch at which 1 - c |w|^nu vanishes, that nothing passes."""
    bounded = c > 0.0
    most = power(1.0 / jnp.where(bounded, c, 1.0), 1.0 / nu)
    return jnp.where(bounded, REFERENCE * most, jnp.inf)


def _root(
    left: Callable[[Scalar], Scalar], high: Scalar, slope: Callable[[Scalar], Scalar]
) -> Scalar:
    """Root of a rising function between 0 and `high`, with the derivatives of one Newton's step."""

    def halved(_, pair: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = pair
        middle = 0.5 * (low + high)
        above = left(middle) > 0.0
        return jnp.where(above, low, middle), jnp.where(above, middle, high)

    high = stop_gradient(high)
    low, high = jax.lax.fori_loop(0, _HALVINGS, halved, (0.0 * high, high))
    w = stop_gradient(0.5 * (low + high))
    return w - left(w) / stop_gradient(slope(w))


def moved(law: StretchLaw, memory: Scalar, dy: Scalar) -> Scalar:
    """The stretch after a move: down to zero where it goes against it, and up on the other side."""
    w, nu = jnp.asarray(memory, float), law.nu
    against = w * dy < 0.0
    less, more = law.nu_softening - law.nu_opening, law.nu_softening + law.nu_opening
    way, size = jnp.abs(dy), jnp.abs(w)
    to_zero = _way(less, size, nu)
    falls = against & (way < to_zero)
    c = jnp.where(falls, less, more)
    begun = jnp.where(against, 0.0, _way(more, size, nu))
    target = jnp.where(falls, to_zero - way, jnp.where(against, way - to_zero, begun + way))
    high = jnp.minimum(_FAR * target, _limit(c, nu) * (1.0 - 1e-15))
    found = _root(
        lambda one: _way(c, one, nu) - target,
        high,
        lambda one: 1.0 / (1.0 - c * power(one / REFERENCE, nu)),
    )
    sense = jnp.where(falls, signed(1.0, w), signed(1.0, dy))
    return jnp.where(dy == 0.0, w, sense * found)


def tip(law: StretchLaw, y_peak: Scalar) -> Scalar:
    r"""Stretch at the tip, $D_{d-g}(w) + D_{d+g}(w) = 2Y$, with D the way from w = 0."""
    peak = jnp.abs(jnp.asarray(y_peak, float))
    less, more = law.nu_softening - law.nu_opening, law.nu_softening + law.nu_opening
    high = jnp.minimum(_FAR * peak, _limit(more, law.nu) * (1.0 - 1e-12))
    found = _root(
        lambda w: _way(less, w, law.nu) + _way(more, w, law.nu) - 2.0 * peak,
        high,
        lambda w: sum(1.0 / (1.0 - c * power(w / REFERENCE, law.nu)) for c in (less, more)),
    )
    return signed(found, jnp.asarray(y_peak, float))


def loop(law: StretchLaw, y_peak: Scalar) -> tuple[Scalar, Scalar]:
    r"""Equivalent stiffness and damping of one law; those of rest at Y = 0.

    $$\mathrm{Re}\,\kappa = \frac{2\alpha}{\pi Y}
      \int_{-w_m}^{w_m} \sqrt{1 - (y(w)/Y)^2}\,dw, \qquad
      \mathrm{Im}\,\kappa = \frac{2\alpha}{\pi Y^2} \left(\int_0^{w_m} \frac{t\,dt}{1 - b\,t^\nu}
      - \int_0^{w_m} \frac{t\,dt}{1 - a\,t^\nu}\right)$$

    along the way down from the tip, a = d - g above w = 0 and b = d + g below.
    """
    at_zero = y_peak == 0.0
    peak = jnp.where(at_zero, REFERENCE, y_peak)
    w, own = tip(law, peak), law.nu_stiffness
    less, more = law.nu_softening - law.nu_opening, law.nu_softening + law.nu_opening
    zero = peak - _way(less, w, law.nu)
    # w_m sin t, with t graded towards the zero of w, where y has a broken power of it.
    t, weights = 0.5 * jnp.pi * _UNIT**3, 1.5 * jnp.pi * _UNIT**2 * _UNIT_WEIGHTS
    stretch = w * jnp.sin(t)
    y = jnp.stack([
        zero + jax.vmap(lambda one: _way(less, one, law.nu))(stretch),
        zero - jax.vmap(lambda one: _way(more, one, law.nu))(stretch),
    ])  # fmt: skip
    height = jnp.sqrt(jnp.maximum(1.0 - (y / peak) ** 2, 1e-300))
    real = 2.0 * own / (jnp.pi * peak) * jnp.sum(weights * w * jnp.cos(t) * height)
    lost = _way(more, w, law.nu, 1) - _way(less, w, law.nu, 1)
    imaginary = 2.0 * own / (jnp.pi * peak**2) * lost
    return jnp.where(at_zero, own, real), jnp.where(at_zero, 0.0, imaginary)
