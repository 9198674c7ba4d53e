r"""The exponential approach of z to its bound, in forms without 0/0 and without lost digits."""

import math
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Real

# atanh(r)/r in r^2; at |s| = 1/2, r^2 <= 1/9 and the first one left out is below 1e-17.
_ATANH = tuple(1 / (2 * n + 1) for n in range(17))
# Terms of E_k; at |s| = 1 the first one left out is below 1e-17.
_NUM_TERMS = 18


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def exponential_remainder(k: int, s: Float[Array, "..."]) -> Float[Array, "..."]:
    r"""Remainder of the exponential after k terms, over its leading power.

    $$E_k(s) = \sum_{n \ge 0} \frac{(-s)^n}{(n+k)!}, \qquad
      E_1 = \frac{1 - e^{-s}}{s}, \quad E_{k+1} = \frac{1/k! - E_k}{s}$$

    Its derivatives are exact too, by E_k' = k E_{k+1} - E_k.

    Args:
        k: Number of terms taken off, at least 1.
        s: Argument, of either sign.

    Returns:
        E_k, positive.
    """
    near = jnp.abs(s) < 1.0
    coefficients = tuple((-1) ** n / math.factorial(n + k) for n in range(_NUM_TERMS))
    # Each side of a `where` sees a safe argument.
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
    r"""What relaxation takes from the move x.

    $$x - \phi(c, x) = s\,x\,E_2(s), \qquad s = c\,x$$

    Holds its relative accuracy down to c x = 0, where x - phi would cancel.

    Args:
        c: Rate of relaxation [1/m], of either sign.
        x: Distance moved [m].

    Returns:
        Lag [m].
    """
    s = jnp.asarray(c * x)
    return s * x * exponential_remainder(2, s)


def phi(c: Real[ArrayLike, "..."], x: Real[ArrayLike, "..."]) -> Float[Array, "..."]:
    r"""Relaxed distance, the solution of phi' = 1 - c phi from zero.

    $$\phi(c, x) = \frac{1 - e^{-c x}}{c} = x\,E_1(c x), \qquad \phi(0, x) = x$$

    Args:
        c: Rate of relaxation [1/m], of either sign.
        x: Distance moved [m].

    Returns:
        Relaxed distance [m].
    """
    return jnp.asarray(x) * exponential_remainder(1, jnp.asarray(c * x))


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
