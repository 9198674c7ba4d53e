r"""Masing laws along a periodic motion with two turning points per period.

$$F_\downarrow(y) = F_b(Y) - 2 F_b\!\left(\tfrac{Y - y}{2}\right), \qquad
  F_\uparrow(y) = -F_\downarrow(-y)$$

Written in lags $\ell(x) = K x - F_b(x)$, the elastic force is a separate term and cancels nowhere.
"""

from functools import partial
from typing import Any

import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Complex, Float

from jbw.oscillator.parameters import Scalar
from jbw.oscillator.steady.waveform import (
    angle_of,
    crest,
    gauss_legendre,
    over_half_period,
    synthesis,
)

Masing = Any  # a `jbw.oscillator.laws.masing.Masing`; its methods call the functions of this module

# The force lost to slip begins like x^(1 + q), so near the tip the integrand is no polynomial.
_NODES, _NODES_PER_HARMONIC = 48, 2


def steady_loop(law: Masing, y_peak: Scalar) -> tuple[Scalar, Scalar]:
    """Return a Masing law's equivalent stiffness and damping; for Y = 0 those at rest."""
    at_zero = y_peak == 0.0
    peak = jnp.where(at_zero, 1.0, y_peak)
    kink = law.kink()
    # The angle at which x reaches the kink; pi if the loop does not reach it.
    share = 1.0 if kink is None else jnp.minimum(stop_gradient(kink.y / peak), 1.0)
    inner = 2.0 * jnp.arcsin(jnp.sqrt(share))
    theta, weights = gauss_legendre(_NODES, 0.0, inner, jnp.pi)
    lag, _ = law.lag(peak * jnp.sin(0.5 * theta) ** 2)
    real = 4.0 / jnp.pi * jnp.sum(weights * lag * jnp.cos(theta)) / peak
    tip, _ = law.lag(peak)
    losses = 4.0 / jnp.pi * (peak * tip - 2.0 * law.lag_integral(peak)) / peak**2
    return law.stiffness() + jnp.where(at_zero, 0.0, real), jnp.where(at_zero, 0.0, losses)


def steady_harmonics(law: Masing, q: Complex[Array, " harmonic"]) -> Complex[Array, " harmonic"]:
    """Return the odd harmonics of F - K y, integrated piecewise between turning points and kink."""
    start = crest(q)
    peak = synthesis(q, start)
    kink = law.kink()
    place = peak if kink is None else peak - 2.0 * kink.y
    begin, inner = stop_gradient((start, angle_of(q, start, place)))
    num_nodes = _NODES + _NODES_PER_HARMONIC * q.shape[0]
    unloading = partial(_unloading, law, peak)
    return over_half_period(unloading, q, num_nodes, begin, inner, begin + jnp.pi)


def steady_force(
    law: Masing, q: Complex[Array, " harmonic"], theta: Float[Array, " time"]
) -> Float[Array, " time"]:
    """Return a Masing law's steady force at angles of the period [N/kg]."""
    peak = synthesis(q, crest(q))
    side = jnp.where(synthesis(q, theta, 1) > 0.0, -1.0, 1.0)
    y = side * synthesis(q, theta)
    return side * (law.stiffness() * y + _unloading(law, peak, y))


def _unloading(law: Masing, peak: Scalar, y: Scalar) -> Scalar:
    """Return F - K y on unloading from the peak, 2 l((Y - y)/2) - l(Y), with the law's `lag` l."""
    down, _ = law.lag(0.5 * jnp.maximum(peak - y, 0.0))
    tip, _ = law.lag(peak)
    return 2.0 * down - tip
