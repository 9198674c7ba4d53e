r"""The exponential approach of z to its bound, in forms without 0/0 and without lost digits."""

import math

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Real

# Taylor coefficients of (exp(-s) - 1 + s)/s^2; the first one left out is below 1e-17 at |s| = 1.
_LAG = tuple((-1) ** n / math.factorial(n + 2) for n in range(18))
# atanh(r)/r in r^2; at |s| = 1/2, r^2 <= 1/9 and the first one left out is below 1e-17.
_ATANH = tuple(1 / (2 * n + 1) for n in range(17))


def lag(c: Real[ArrayLike, "..."], x: Real[ArrayLike, "..."]) -> Float[Array, "..."]:
    r"""What relaxation takes from the move x.

    $$x - \phi(c, x) = c\,x^2\,\frac{e^{-s} - 1 + s}{s^2}, \qquad s = c\,x$$

    Holds its relative accuracy down to c x = 0, where x - phi would cancel.

    Args:
        c: Rate of relaxation [1/m], of either sign.
        x: Distance moved [m].

    Returns:
        Lag [m].
    """
    s = jnp.asarray(c * x)
    near = jnp.abs(s) < 1.0
    # Each side of a `where` sees a safe argument, so that no derivative is 0 * inf.
    far_s = jnp.where(near, 1.0, s)
    series = _horner(jnp.where(near, s, 0.0), _LAG)
    return s * x * jnp.where(near, series, (jnp.expm1(-far_s) + far_s) / far_s**2)


def phi(c: Real[ArrayLike, "..."], x: Real[ArrayLike, "..."]) -> Float[Array, "..."]:
    r"""Relaxed distance, the solution of phi' = 1 - c phi from zero.

    $$\phi(c, x) = \frac{1 - e^{-c x}}{c}, \qquad \phi(0, x) = x$$

    Args:
        c: Rate of relaxation [1/m], of either sign.
        x: Distance moved [m].

    Returns:
        Relaxed distance [m].
    """
    s, x = jnp.asarray(c * x), jnp.asarray(x)
    near = jnp.abs(s) < 1.0
    far_s = jnp.where(near, 1.0, s)
    series = 1.0 - s * _horner(jnp.where(near, s, 0.0), _LAG)
    return x * jnp.where(near, series, -jnp.expm1(-far_s) / far_s)


def psi(c: Real[ArrayLike, "..."], x: Real[ArrayLike, "..."]) -> Float[Array, "..."]:
    r"""Distance that relaxes to x, the inverse of `phi`.

    $$\psi(c, x) = -\frac{\ln(1 - c x)}{c}, \qquad \psi(0, x) = x$$

    Args:
        c: Rate of relaxation [1/m], of either sign.
        x: Relaxed distance [m].

    Returns:
        Distance [m]; infinite, of x's sign, where c x >= 1: no finite move relaxes to x.
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
    """Polynomial with the given coefficients, lowest order first."""
    total = jnp.full_like(s, coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        total = total * s + coefficient
    return total
