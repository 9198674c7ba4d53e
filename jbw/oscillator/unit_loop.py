"""The steady loop in units of its peak Y, where only delta Y and gamma Y are left (nu = 1)."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

from jbw.oscillator.branches import unloading_lag
from jbw.oscillator.quadrature import gauss_legendre
from jbw.oscillator.relaxation import phi

_NUM_NODES = 64
_NUM_NODES_HARMONICS = 48
_NUM_NEWTON = 8


def opening_and_area(
    x: Float[Array, "..."], b: Float[Array, "..."], g: Float[Array, "..."]
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    r"""Opening and area of the loop of half-width x.

    $$\frac{|y_0|}{Y} = g \int_0^x \frac{\phi(b,t)}{e^{-bt} + 2 g \phi(b,t)}\,dt, \qquad
      \frac{|E|}{\alpha Y^2} = 4 g \int_0^x \frac{\phi(b,t)^2}{e^{-bt} + 2 g \phi(b,t)}\,dt$$

    Args:
        x: Half-width 1 + |y_0|/Y [-].
        b: (delta + |gamma|) Y [-].
        g: |gamma| Y [-].

    Returns:
        |y_0|/Y and |E|/(alpha Y^2) [-].
    """
    nodes, weights = gauss_legendre(_NUM_NODES, 0.0, x)
    b, g = b[..., None], g[..., None]
    relaxed = phi(b, nodes)
    density = g * relaxed / (jnp.exp(-b * nodes) + 2.0 * g * relaxed)
    return jnp.sum(weights * density, -1), 4.0 * jnp.sum(weights * density * relaxed, -1)


@jax.custom_jvp
def half_width(d: Float[Array, "..."], g: Float[Array, "..."]) -> Float[Array, "..."]:
    r"""Half-width x = 1 + |y_0|/Y, the root of x - 1 - opening(x).

    The residual is concave and increasing, so Newton's iteration from x = 1 is monotone; its
    slope lies in [1/2, 1]. Derivatives follow from the root's equation, not from the iteration.

    Args:
        d: delta Y [-].
        g: |gamma| Y [-].

    Returns:
        Half-width [-].
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
    """Slope of x - 1 - opening(x)."""
    relaxed = phi(b, x)
    return 1.0 - g * relaxed / (jnp.exp(-b * x) + 2.0 * g * relaxed)


def loop_harmonics(
    d: Float[Array, "..."],
    gamma: Float[Array, "..."],
    opening: Float[Array, "..."],
    area: Float[Array, "..."],
) -> tuple[Complex[Array, "..."], Complex[Array, "..."], Complex[Array, "..."]]:
    r"""Harmonics 1, 3 and 5 of z/(alpha Y) for y = Y cos(theta).

    On unloading, 0 < theta < pi, z/(alpha Y) = cos(theta) - opening - lag. The first two terms are
    integrated by hand, so that the harmonics stay accurate where the lag is small; the imaginary
    part of the first one is the area over pi.

    Args:
        d: delta Y [-].
        gamma: gamma Y, signed [-].
        opening: y_0/Y, signed [-].
        area: E/(alpha Y^2), signed [-].

    Returns:
        Complex peak amplitudes [-].
    """
    turn = jnp.arccos(opening)
    segments = (
        gauss_legendre(_NUM_NODES_HARMONICS, 0.0, turn),
        gauss_legendre(_NUM_NODES_HARMONICS, turn, jnp.pi),
    )
    theta, weights = (jnp.concatenate(part, -1) for part in zip(*segments, strict=True))
    shape = (x[..., None] for x in (opening, d, gamma))
    lost = 2.0 / jnp.pi * weights * unloading_lag(jnp.cos(theta), *shape)

    def harmonic(n: int) -> Array:
        sine = jnp.sum(lost * jnp.sin(n * theta), -1) + 4.0 / (n * jnp.pi) * opening
        return jax.lax.complex(-jnp.sum(lost * jnp.cos(n * theta), -1), sine)

    first = jax.lax.complex(1.0 + harmonic(1).real, area / jnp.pi)
    return first, harmonic(3), harmonic(5)
