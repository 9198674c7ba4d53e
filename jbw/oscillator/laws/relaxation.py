r"""The exponential approach of z to its bound, in forms that keep all digits."""

import math
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Complex, Float, Real

from jbw.oscillator.steady.waveform import gauss_legendre

# Coefficients of atanh(r)/r in r^2; at |s| = 1/2, r^2 <= 1/9 and the first omitted term is below
# 1e-17.
_ATANH = tuple(1 / (2 * n + 1) for n in range(17))
# Number of terms of E_k; at |s| = 1 the first omitted term is below 1e-17.
_NUM_TERMS = 18


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def exponential_remainder(k: int, s: Float[Array, "..."]) -> Float[Array, "..."]:
    r"""Return the remainder of exp(-s) after k series terms, divided by its leading power.

    $$E_k(s) = \sum_{n \ge 0} \frac{(-s)^n}{(n+k)!}, \qquad
      E_1 = \frac{1 - e^{-s}}{s}, \quad E_{k+1} = \frac{1/k! - E_k}{s}$$

    Its derivatives are exact too, by E_k' = k E_{k+1} - E_k.
    """
    near = jnp.abs(s) < 1.0
    coefficients = tuple((-1) ** n / math.factorial(n + k) for n in range(_NUM_TERMS))
    # In each branch of a `where`, the argument is replaced where the branch would not be finite.
    far_s = jnp.where(near, 1.0, s)
    far = -jnp.expm1(-far_s) / far_s
    for j in range(1, k):
        far = (1.0 / math.factorial(j) - far) / far_s
    return jnp.where(near, _horner(jnp.where(near, s, 0.0), coefficients), far)


@exponential_remainder.defjvp
def _remainder_jvp(k: int, primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    (s,), (s_dot,) = primals, tangents
    value = exponential_remainder(k, s)
    return value, (k * exponential_remainder(k + 1, s) - value) * s_dot


def lag(c: Real[ArrayLike, "..."], x: Real[ArrayLike, "..."]) -> Float[Array, "..."]:
    r"""Return the distance that relaxation at the rate c per length removes from a move x.

    $$x - \phi(c, x) = s\,x\,E_2(s), \qquad s = c\,x$$

    The relative accuracy holds down to c x = 0, where x - phi would cancel.
    """
    s = jnp.asarray(c * x)
    return s * x * exponential_remainder(2, s)


def phi(c: Real[ArrayLike, "..."], x: Real[ArrayLike, "..."]) -> Float[Array, "..."]:
    r"""Return the relaxed distance $\phi$, the solution of phi' = 1 - c phi from zero.

    $$\phi(c, x) = \frac{1 - e^{-c x}}{c} = x\,E_1(c x), \qquad \phi(0, x) = x$$
    """
    return jnp.asarray(x) * exponential_remainder(1, jnp.asarray(c * x))


def psi(c: Real[ArrayLike, "..."], x: Real[ArrayLike, "..."]) -> Float[Array, "..."]:
    r"""Return the move psi that relaxes to the distance x at the rate c: phi(c, psi) = x.

    $$\psi(c, x) = -\frac{\ln(1 - c x)}{c}, \qquad \psi(0, x) = x$$
    """
    s = jnp.asarray(c * x)
    near = jnp.abs(s) < 0.5
    near_s = jnp.where(near, s, 0.0)
    far_s = jnp.where(near | (s >= 1.0), -1.0, s)
    # -log(1 - s) = 2 atanh(s/(2 - s)), whose series converges four times as fast.
    series = 2.0 / (2.0 - near_s) * _horner((near_s / (2.0 - near_s)) ** 2, _ATANH)
    ratio = jnp.where(near, series, -jnp.log1p(-far_s) / far_s)
    return jnp.where(s >= 1.0, jnp.copysign(jnp.inf, x), x * ratio)


def _horner(s: Float[Array, "..."], coefficients: tuple[float, ...]) -> Float[Array, "..."]:
    """Evaluate the polynomial with the given coefficients, lowest order first."""
    total = jnp.full_like(s, coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        total = total * s + coefficient
    return total


_NUM_NODES = 64
_NUM_NODES_HARMONICS = 48
_NUM_NEWTON = 8
# A loop of more relaxation lengths than this is integrated in closed form.
_LONG = 20.0
# Smallest opening, relative to the half-width, for which the closed form is accurate.
_OPEN = 0.01


def opening_and_area(
    x: Float[Array, "..."], b: Float[Array, "..."], g: Float[Array, "..."]
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    r"""Return the dimensionless opening and area of a Bouc-Wen loop of half-width x.

    $$\frac{|y_0|}{Y} = g \int_0^x \frac{\phi(b,t)}{e^{-bt} + 2 g \phi(b,t)}\,dt, \qquad
      \frac{|E|}{\alpha Y^2} = 4 g \int_0^x \frac{\phi(b,t)^2}{e^{-bt} + 2 g \phi(b,t)}\,dt$$

    If x spans many relaxations, the quadrature rule no longer fits the integrand. There $\psi(a,
    \phi(b, x))$, the distance that unloads the tip, and its moment are used in closed form, with a
    = b - 2g,

    $$\frac{|y_0|}{Y} = \frac{x - \psi(a, w)}{2}, \qquad
      \frac{|E|}{\alpha Y^2} = 2\Bigl[\frac{x - w}{b} - \frac{\psi(a, w) - w}{a}\Bigr],
      \qquad w = \phi(b, x)$$
    """
    nodes, weights = gauss_legendre(_NUM_NODES, 0.0, x)
    relaxed = phi(b[..., None], nodes)
    rest = jnp.exp(-b[..., None] * nodes) + 2.0 * g[..., None] * relaxed
    density = g[..., None] * relaxed / rest
    opening = jnp.sum(weights * density, -1)
    area = 4.0 * jnp.sum(weights * density * relaxed, -1)
    long = (b * x > _LONG) & (opening > _OPEN * x)
    closed = _long_opening_and_area(*(jnp.where(long, value, 1.0) for value in (x, b, g)))
    return jnp.where(long, closed[0], opening), jnp.where(long, closed[1], area)


def _long_opening_and_area(
    x: Float[Array, "..."], b: Float[Array, "..."], g: Float[Array, "..."]
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Return `opening_and_area` in closed form, for loops of many relaxation lengths."""
    w, a = phi(b, x), b - 2.0 * g
    rest = jnp.exp(-b * x) + 2.0 * g * w  # 1 - a w
    near = jnp.abs(a * w) < 0.5
    far_a = jnp.where(near, 1.0, a)
    near_a = jnp.where(near, a, 0.0)
    back = jnp.where(near, psi(near_a, w), -jnp.log(rest) / far_a)
    nodes, weights = gauss_legendre(_NUM_NODES, 0.0, w)
    moment = jnp.sum(weights * nodes / (1.0 - near_a[..., None] * nodes), -1)
    moment = jnp.where(near, moment, (back - w) / far_a)
    return 0.5 * (x - back), 2.0 * ((x - w) / b - moment)


@jax.custom_jvp
def half_width(d: Float[Array, "..."], g: Float[Array, "..."]) -> Float[Array, "..."]:
    r"""Return the half-width x = 1 + |y_0|/Y of the loop, the root of x - 1 - opening(x).

    The residual is concave and increasing, so Newton's iteration from x = 1 is monotone; its slope
    lies in [1/2, 1]. Derivatives follow from the root's equation, not from the iteration.
    """

    def newton(_: int, x: Array) -> Array:
        opening, _area = opening_and_area(x, d + g, g)
        return x - (x - 1.0 - opening) / _slope(x, d + g, g)

    return jax.lax.fori_loop(0, _NUM_NEWTON, newton, jnp.ones_like(d))


@half_width.defjvp
def _half_width_jvp(
    primals: tuple[Array, Array], tangents: tuple[Array, Array]
) -> tuple[Array, Array]:
    (d, g), (d_dot, g_dot) = primals, tangents
    x = half_width(d, g)
    _, opening_dot = jax.jvp(
        lambda b, g: opening_and_area(x, b, g)[0], (d + g, g), (d_dot + g_dot, g_dot)
    )
    return x, opening_dot / _slope(x, d + g, g)


def _slope(x: Array, b: Array, g: Array) -> Array:
    """Return the derivative of x - 1 - opening(x), the residual of a loop's half-width x."""
    relaxed = phi(b, x)
    return 1.0 - g * relaxed / (jnp.exp(-b * x) + 2.0 * g * relaxed)


def loop_harmonics(
    d: Float[Array, "..."],
    gamma: Float[Array, "..."],
    opening: Float[Array, "..."],
    area: Float[Array, "..."],
) -> tuple[Complex[Array, "..."], Complex[Array, "..."], Complex[Array, "..."]]:
    r"""Return the harmonics 1, 3 and 5 of z/(alpha Y) in a steady loop with y = Y cos(theta).

    On unloading, 0 < theta < pi, z/(alpha Y) = cos(theta) - opening - lag. The first two terms are
    integrated analytically, so that the harmonics stay accurate where the lag is small; the
    imaginary part of the first harmonic is the area divided by pi.
    """
    theta, weights = gauss_legendre(_NUM_NODES_HARMONICS, 0.0, jnp.arccos(opening), jnp.pi)
    shape = (x[..., None] for x in (opening, d, gamma))
    lost = 2.0 / jnp.pi * weights * unloading_lag(jnp.cos(theta), *shape)

    def harmonic(n: int) -> Array:
        sine = jnp.sum(lost * jnp.sin(n * theta), -1) + 4.0 / (n * jnp.pi) * opening
        return jax.lax.complex(-jnp.sum(lost * jnp.cos(n * theta), -1), sine)

    first = jax.lax.complex(1.0 + harmonic(1).real, area / jnp.pi)
    return first, harmonic(3), harmonic(5)


def unloading_lag(
    y: Float[Array, "..."],
    y_open: Float[Array, "..."],
    delta: Float[Array, "..."],
    gamma: Float[Array, "..."],
) -> Float[Array, "..."]:
    r"""Return the elastic line minus the unloading branch of the Bouc-Wen loop.

    $$y - y_0 - Z/\alpha, \qquad Z = Z_1 \text{ for } y > y_0, \quad Z_2 \text{ for } y < y_0$$

    Reference:
        Eqs. (3), (4).
    """
    x = y - y_open
    positive = x > 0.0
    return jnp.where(
        positive,
        lag(delta - gamma, jnp.where(positive, x, 0.0)),
        -lag(delta + gamma, jnp.where(positive, 0.0, -x)),
    )
