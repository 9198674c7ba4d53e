r"""The Volterra kernels of the polynomial oscillator in time, in closed form, Eqs. (17), (18).

The impulse response is a sum over the two poles, $h_1(\tau) = \sum_a c_a e^{p_a\tau}$, so that the
nested integrals of the higher kernels are sums of exponentials too. All kernels are causal: zero
unless every delay is positive. They require an underdamped oscillator with some damping.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Complex, Float

from jbw.errors import ModelError
from jbw.oscillator.checks import is_concrete
from jbw.oscillator.parameters import Scalar
from jbw.paper.polynomial import PolynomialOscillator

Delay = Float[ArrayLike, "..."]


def impulse_1(system: PolynomialOscillator, tau: Delay) -> Float[Array, "..."]:
    r"""Return the impulse response of a polynomial oscillator's linear part.

    $$h_1(\tau) = \frac{1}{\omega_d}e^{-\zeta\omega_n\tau}\sin\omega_d\tau, \qquad
      \omega_d^2 = \omega_0^2 - (\zeta\omega_n)^2$$

    Args:
        system: Polynomial oscillator, underdamped.
        tau: Delay [s].

    Returns:
        Kernel [s], zero for negative delays.

    Raises:
        ModelError: The oscillator is not underdamped.

    Reference:
        Eq. (18), as printed; the inverse transform of H_1.
    """
    tau = jnp.maximum(jnp.asarray(tau), 0.0)
    omega_d = _damped(system)
    return jnp.asarray(jnp.exp(-system.damping / 2.0 * tau) * jnp.sin(omega_d * tau) / omega_d)


def impulse_2(system: PolynomialOscillator, tau_1: Delay, tau_2: Delay) -> Float[Array, "..."]:
    r"""Return the second-order Volterra kernel of a polynomial oscillator in time.

    $$h_2(\tau_1,\tau_2) = -\rho\int_0^{\min\tau} h_1(s)\,h_1(\tau_1-s)\,h_1(\tau_2-s)\,ds$$

    Args:
        system: Polynomial oscillator, underdamped.
        tau_1: First delay [s].
        tau_2: Second delay [s].

    Returns:
        Kernel [m^-1 s^2], zero if a delay is negative.

    Raises:
        ModelError: The oscillator is not underdamped.

    Reference:
        Eq. (18), as printed; the inverse transform of H_2.
    """
    p_0, p_1, p_2 = _poles(system, 3)
    tau_1, tau_2 = _spread(tau_1, 3), _spread(tau_2, 3)
    at_delay = jnp.exp(p_1 * tau_1 + p_2 * tau_2)
    terms = at_delay * _ramp(p_0 - p_1 - p_2, jnp.minimum(tau_1, tau_2))
    return jnp.asarray(-system.rho * _summed(system, terms, 3))


def impulse_3(
    system: PolynomialOscillator, tau_1: Delay, tau_2: Delay, tau_3: Delay
) -> Float[Array, "..."]:
    r"""Return the third-order kernel of a polynomial oscillator in time, symmetric in its delays.

    $$h_3 = -\int_0^{\min\tau} h_1(s)\Bigl[\lambda_3 \prod_i h_1(\tau_i-s)
      + \tfrac{2}{3}\rho\sum_{i} h_1(\tau_i-s)\,h_2(\tau_k-s,\tau_l-s)\Bigr]ds$$

    with (k, l) the two delays other than i.

    Args:
        system: Polynomial oscillator, underdamped.
        tau_1: First delay [s].
        tau_2: Second delay [s].
        tau_3: Third delay [s].

    Returns:
        Kernel [m^-2 s^3], zero if a delay is negative.

    Raises:
        ModelError: The oscillator is not underdamped.

    Reference:
        Eq. (18), as printed; the inverse transform of H_3.
    """
    mixed = (
        _linear_times_second(system, tau_1, tau_2, tau_3)
        + _linear_times_second(system, tau_2, tau_1, tau_3)
        + _linear_times_second(system, tau_3, tau_1, tau_2)
    )
    cubic = _linear_cubed(system, tau_1, tau_2, tau_3)
    return jnp.asarray(-(system.lambda_3 * cubic + (2.0 / 3.0) * system.rho * mixed))


def _linear_cubed(
    system: PolynomialOscillator, tau_1: Delay, tau_2: Delay, tau_3: Delay
) -> Float[Array, "..."]:
    """Return the integral over s of h_1(s) h_1(tau_1 - s) h_1(tau_2 - s) h_1(tau_3 - s)."""
    p_0, p_1, p_2, p_3 = _poles(system, 4)
    tau_1, tau_2, tau_3 = (_spread(tau, 4) for tau in (tau_1, tau_2, tau_3))
    until = jnp.minimum(jnp.minimum(tau_1, tau_2), tau_3)
    at_delay = jnp.exp(p_1 * tau_1 + p_2 * tau_2 + p_3 * tau_3)
    return _summed(system, at_delay * _ramp(p_0 - p_1 - p_2 - p_3, until), 4)


def _linear_times_second(
    system: PolynomialOscillator, tau_1: Delay, tau_2: Delay, tau_3: Delay
) -> Float[Array, "..."]:
    """Return the integral over s of h_1(s) h_1(tau_1 - s) h_2(tau_2 - s, tau_3 - s)."""
    p_0, p_1, p_2, p_3, p_4 = _poles(system, 5)
    tau_1, tau_2, tau_3 = (_spread(tau, 5) for tau in (tau_1, tau_2, tau_3))
    inner = jnp.minimum(tau_2, tau_3)
    until = jnp.minimum(tau_1, inner)
    # h_2(tau_2 - s, tau_3 - s) contains _ramp(rate, inner - s); its two parts are integrated here.
    rate = p_2 - p_3 - p_4
    grown = jnp.exp(rate * inner) * _ramp(p_0 - p_1 - p_2, until)
    ramps = (grown - _ramp(p_0 - p_1 - p_3 - p_4, until)) / rate
    at_delay = jnp.exp(p_1 * tau_1 + p_3 * tau_2 + p_4 * tau_3)
    return jnp.asarray(-system.rho * _summed(system, at_delay * ramps, 5))


def _poles(system: PolynomialOscillator, count: int) -> list[Complex[Array, "..."]]:
    """Return the two poles of an oscillator's linear part, repeated along `count` last axes."""
    decay = jnp.asarray(system.damping) / 2.0
    poles = -decay + 1j * jnp.array([1.0, -1.0]) * _damped(system)
    return [poles.reshape(2, *(1,) * (count - 1 - axis)) for axis in range(count)]


def _summed(
    system: PolynomialOscillator, terms: Complex[Array, "..."], count: int
) -> Float[Array, "..."]:
    """Sum terms over the poles of the linear part, with the weights that the poles have in h_1.

    The poles are on the last axes, and the weights are +-1/(2j omega_d).
    """
    weight = jnp.array([1.0, -1.0]) / (2j * _damped(system))
    for _ in range(count):
        terms = terms @ weight
    return terms.real


def _damped(system: PolynomialOscillator) -> Scalar:
    """Return the damped natural frequency, omega_d [rad/s]."""
    if is_concrete(system.damping, system.stiffness):
        least = np.min(np.asarray(system.stiffness) - np.square(np.asarray(system.damping) / 2.0))
        if least <= 0.0 or np.min(np.asarray(system.damping)) <= 0.0:
            raise ModelError(
                "The kernels in time need damping above zero and below critical, but damping = "
                f"{system.damping} 1/s with stiffness = {system.stiffness} 1/s^2.",
                remedy="Use `volterra_response`, which is valid for any damping.",
            )
    return jnp.sqrt(system.stiffness - jnp.square(system.damping / 2.0))


def _spread(tau: Delay, axes: int) -> Float[Array, "..."]:
    """Return non-negative delays, with a new last axis for each sum over the poles."""
    return jnp.maximum(jnp.asarray(tau), 0.0).reshape(jnp.shape(tau) + (1,) * axes)


def _ramp(rate: Complex[Array, "..."], until: Float[Array, "..."]) -> Complex[Array, "..."]:
    """Return the integral of exp(rate s) over s from 0 to `until`."""
    return jnp.expm1(rate * until) / rate
