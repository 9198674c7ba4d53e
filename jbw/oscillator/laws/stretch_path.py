r"""Large displacement steps and steady loops of the Bouc-Wen law with any exponent.

$$D_c(w) = \int_0^w \frac{dt}{1 - c\,|t / \mathrm{1\,mm}|^\nu}$$

is the displacement (way) after which the spring is stretched by w, where c is d - g for motion
towards w = 0 and d + g for motion away from it. Its inverse is the law's exact map.
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
# The Gauss-Legendre rule on [0, 1], in NumPy because JAX may be switched to float64 later.
UNIT_RULE = 0.5 * (_NODES + 1.0), 0.5 * _WEIGHTS
_UNIT, _UNIT_WEIGHTS = UNIT_RULE
_HALVINGS = 60  # number of bisections in the search for the spring's stretch
# The stretch of a hardening spring is searched up to this multiple of the length of the move.
_FAR = 16.0
# Above this fraction of the limit, the pole of the integrand is integrated analytically.
_POLE = 0.5
# Largest q in w = L (1 - e^-q) up to which a loop is integrated; the rest is negligible.
_DEEP = 40.0


class StretchLaw(Protocol):
    """The parameters of a `BoucWenNu` law, as attributes of the same names."""

    nu_stiffness: Scalar
    nu_softening: Scalar
    nu_opening: Scalar
    nu: Scalar


def _way(c: Scalar, w: Scalar, nu: Scalar, gap: Scalar | None = None) -> Scalar:
    r"""Return the travel that stretches a spring by w: $\int_0^w dt/(1-c|t/\mathrm{1mm}|^\nu)$."""
    return w + _lag(c, w, nu, 0, gap)


def _lag(c: Scalar, w: Scalar, nu: Scalar, m: int = 0, gap: Scalar | None = None) -> Scalar:
    r"""Return the lag $\int_0^w t^m f/(1 - f)\,dt$ with $f = c|t/\mathrm{1\,mm}|^\nu$, for w >= 0.

    Gauss's rule is used. Near the limit L of w, with z = t/L, its pole is separated analytically:

    $$\frac{z^\nu}{1 - z^\nu} = \Bigl[\frac{z^\nu}{1 - z^\nu} - \frac{z}{\nu (1 - z)}\Bigr]
      + \frac{z}{\nu (1 - z)}, \qquad
      \int_0^x \frac{z^{m+1}}{1 - z}\,dz = -\ln(1 - x) - x - \frac{m x^2}{2}$$

    `gap` is 1 - w/L where it is known more accurately than from w. The rule is along s with t = w
    s^p, where p is an integer such that the fractional power is at least of third order at s = 0.
    """
    limit = stretch_limit(c, nu)
    near = w > _POLE * limit
    x = jnp.where(near, w / jnp.where(near, limit, 1.0), 0.5)
    gap = jnp.where(near, 1.0 - x if gap is None else gap, 0.5)
    gap = jnp.maximum(gap, 1e-300)
    p = stop_gradient(jnp.ceil(3.0 / nu))
    unit, log_unit = jnp.asarray(_UNIT), jnp.log(_UNIT)
    s = power(unit, p)
    # Near the pole, 1 - z and 1 - z^nu are computed directly as small numbers.
    log_z = jnp.log1p(-gap) + p * log_unit
    lost = c * power(w * s / REFERENCE, nu)
    lost = jnp.where(near, jnp.exp(nu * log_z), lost)
    rest = jnp.where(near, -jnp.expm1(nu * log_z), 1.0 - lost)
    pole = jnp.where(near, x * s / nu / -jnp.expm1(log_z), 0.0)
    weights = jnp.asarray(_UNIT_WEIGHTS) * p * power(unit, p - 1.0) * s**m
    regular = jnp.sum(weights * (lost / rest - pole))
    pole_part = (-jnp.log(gap) - x - 0.5 * m * x**2) / (nu * x ** (m + 1))
    return w ** (m + 1) * (regular + jnp.where(near, pole_part, 0.0))


def stretch_limit(c: Scalar, nu: Scalar) -> Scalar:
    """Return the limit of the spring's stretch, where 1 - c |w|^nu vanishes; infinite if c <= 0."""
    bounded = c > 0.0
    most = power(1.0 / jnp.where(bounded, c, 1.0), 1.0 / nu)
    return jnp.where(bounded, REFERENCE * most, jnp.inf)


def _gap(q: Scalar, c: Scalar, nu: Scalar, most: Scalar) -> Scalar:
    r"""Return the relative distance, 1 - w/L, of a stretch $w = L_m (1 - e^{-q})$ from its limit L.

    $$1 - w/L = (1 - L_m/L) + e^{-q} L_m/L$$

    `most` is the factor c of the limit L_m, which is the nearer one.
    """
    bounded = (c > 0.0) & (most > 0.0)
    log_ratio = jnp.log(jnp.where(bounded, c, 1.0) / jnp.where(bounded, most, 1.0)) / nu
    return jnp.where(bounded, -jnp.expm1(log_ratio) + jnp.exp(log_ratio - q), 1.0)


def _scale(most: Scalar, nu: Scalar, way: Scalar) -> tuple[Scalar, Scalar]:
    r"""Return L of $w = L (1 - e^{-q})$, and the largest q that a displacement `way` may need.

    The way is at least L q for an exponent below one, and $L q / \nu$ above: near the limit its
    e-folds distinguish two stretches. Without a limit, the limit of the search is used.
    """
    limit = stretch_limit(most, nu)
    bounded = most > 0.0
    scale = jnp.where(bounded, limit, 2.0 * _FAR * way)
    largest = jnp.where(bounded, way * jnp.maximum(nu, 1.0) / scale, jnp.log(2.0))
    return scale, largest


def _root(
    excess: Callable[[Scalar], Scalar], high: Scalar, slope: Callable[[Scalar], Scalar]
) -> Scalar:
    """Return the root of a rising function between 0 and `high`, differentiable once."""

    def halved(_, pair: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = pair
        middle = 0.5 * (low + high)
        above = excess(middle) > 0.0
        return jnp.where(above, low, middle), jnp.where(above, middle, high)

    high = stop_gradient(high)
    low, high = jax.lax.fori_loop(0, _HALVINGS, halved, (0.0 * high, high))
    w = stop_gradient(0.5 * (low + high))
    return w - excess(w) / stop_gradient(slope(w))


def moved(law: StretchLaw, memory: Scalar, dy: Scalar) -> Scalar:
    """Return the spring's stretch after a move: unload it to zero, then load the other side."""
    w, nu = jnp.asarray(memory, float), law.nu
    against = w * dy < 0.0
    less, more = law.nu_softening - law.nu_opening, law.nu_softening + law.nu_opening
    way, size = jnp.abs(dy), jnp.abs(w)
    to_zero = _way(less, size, nu)
    falls = against & (way < to_zero)
    c = jnp.where(falls, less, more)
    begun = jnp.where(against, 0.0, _way(more, size, nu))
    target = jnp.where(falls, to_zero - way, jnp.where(against, way - to_zero, begun + way))
    scale, largest = _scale(c, nu, target)

    def excess(q: Scalar) -> Scalar:
        return _way(c, -scale * jnp.expm1(-q), nu, _gap(q, c, nu, c)) - target

    q = _root(excess, largest, lambda q: _slope(q, c, nu, c, scale))
    sense = jnp.where(falls, signed(1.0, w), signed(1.0, dy))
    return jnp.where(dy == 0.0, w, -sense * scale * jnp.expm1(-q))


def _slope(q: Scalar, c: Scalar, nu: Scalar, most: Scalar, scale: Scalar) -> Scalar:
    """Return d(displacement) / dq for w = L (1 - e^-q); it is finite even near the limit L."""
    gap = jnp.maximum(_gap(q, c, nu, most), 1e-300)
    lost = c * power(-scale * jnp.expm1(-q) / REFERENCE, nu)
    near = gap < _POLE
    rest = jnp.where(near, -jnp.expm1(nu * jnp.log1p(-jnp.where(near, gap, 0.5))), 1.0 - lost)
    return scale * jnp.exp(-jnp.minimum(q, 690.0)) / jnp.maximum(rest, 1e-300)


def _tip(law: StretchLaw, peak: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """Return q and L of the stretch w = L (1 - e^-q) at a loop's tip, and the factor c of L."""
    less, more = law.nu_softening - law.nu_opening, law.nu_softening + law.nu_opening
    most, nu = jnp.maximum(less, more), law.nu
    scale, largest = _scale(most, nu, 2.0 * peak)

    def excess(q: Scalar) -> Scalar:
        w = -scale * jnp.expm1(-q)
        ways = (_way(c, w, nu, _gap(q, c, nu, most)) for c in (less, more))
        return sum(ways) - 2.0 * peak

    def slope(q: Scalar) -> Scalar:
        return sum(_slope(q, c, nu, most, scale) for c in (less, more))

    return _root(excess, largest, slope), scale, most


def tip(law: StretchLaw, y_peak: Scalar) -> Scalar:
    r"""Return the spring's stretch w at the tip of a loop, where $D_{d-g}(w) + D_{d+g}(w) = 2Y$."""
    peak = jnp.abs(jnp.asarray(y_peak, float))
    q, scale, _ = _tip(law, peak)
    return signed(-scale * jnp.expm1(-q), jnp.asarray(y_peak, float))


def loop(law: StretchLaw, y_peak: Scalar) -> tuple[Scalar, Scalar]:
    r"""Return the equivalent stiffness and damping of one law; for Y = 0 those at rest.

    $$\mathrm{Re}\,\kappa = \frac{2\alpha}{\pi Y}
      \int_{-w_m}^{w_m} \sqrt{1 - (y(w)/Y)^2}\,dw, \qquad
      \mathrm{Im}\,\kappa = \frac{2\alpha}{\pi Y^2} \left(\int_0^{w_m} \frac{t\,dt}{1 - b\,t^\nu}
      - \int_0^{w_m} \frac{t\,dt}{1 - a\,t^\nu}\right)$$

    on unloading from the tip, with a = d - g above w = 0 and b = d + g below. The first integral is
    over q of $w = L (1 - e^{-q})$, because near the limit most of the motion changes w only little.
    """
    at_zero = y_peak == 0.0
    peak = jnp.where(at_zero, REFERENCE, y_peak)
    alpha, nu = law.nu_stiffness, law.nu
    less, more = law.nu_softening - law.nu_opening, law.nu_softening + law.nu_opening
    end, scale, most = _tip(law, peak)

    def way(c: Scalar, q: Scalar) -> Scalar:
        return _way(c, -scale * jnp.expm1(-q), nu, _gap(q, c, nu, most))

    def moment(c: Scalar) -> Scalar:
        return _lag(c, -scale * jnp.expm1(-end), nu, 1, _gap(end, c, nu, most))

    zero = peak - way(less, end)
    # The substitution q = q_m sin t removes the square-root singularity at the end. The points t
    # are dense near w = 0, because y has a fractional power there.
    t, weights = 0.5 * jnp.pi * _UNIT**3, 1.5 * jnp.pi * _UNIT**2 * _UNIT_WEIGHTS
    reach = jnp.minimum(end, _DEEP)
    q = reach * jnp.sin(t)
    y = jnp.stack([
        zero + jax.vmap(lambda q_i: way(less, q_i))(q),
        zero - jax.vmap(lambda q_i: way(more, q_i))(q),
    ])  # fmt: skip
    height = jnp.sqrt(jnp.maximum(1.0 - (y / peak) ** 2, 1e-300))
    weights = weights * reach * jnp.cos(t) * scale * jnp.exp(-q)
    real = 2.0 * alpha / (jnp.pi * peak) * jnp.sum(weights * height)
    imaginary = 2.0 * alpha / (jnp.pi * peak**2) * (moment(more) - moment(less))
    return jnp.where(at_zero, alpha, real), jnp.where(at_zero, 0.0, imaginary)
