r"""Gaussian log likelihoods of repeats, through their sufficient statistics.

K repeats d_k enter only by their mean, their within-repeat sum of squares and K:

$$\sum_k |d_k - m|^2 = K |\bar d - m|^2 + S, \qquad S = \sum_k |d_k - \bar d|^2$$
"""

import math

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

Reals = Float[Array, "..."] | Float[np.ndarray, "..."]
Complexes = Complex[Array, "..."] | Complex[np.ndarray, "..."]
Real = Reals | float
LOG_TWO_PI = math.log(2 * math.pi)


def complex_gaussian_log_likelihood(
    mean: Complexes,
    within_ss: Real,
    num_repeats: Real,
    model: Complexes,
    noise_std: Real,
) -> Float[Array, "..."]:
    r"""Log likelihood of K repeats of complex data, one term a point.

    $$\log L = -K \log(2\pi\sigma^2) - \frac{K |\bar d - m|^2 + S}{2\sigma^2}$$

    The transpose in (34) is the conjugate one, and sigma is the standard deviation of each real
    component, as 2 sigma^2 requires.

    Args:
        mean: Mean of the repeats.
        within_ss: Sum of squares S of the repeats about their mean, at each point.
        num_repeats: K.
        model: Prediction m.
        noise_std: Standard deviation of the real, and of the imaginary, part of one repeat.

    Returns:
        Log likelihood of each point [nats].

    Reference:
        Eqs. (34), (36).
    """
    num_repeats, variance = jnp.asarray(num_repeats), jnp.square(noise_std)
    misfit = num_repeats * _squared_modulus(mean - model) + within_ss
    return -num_repeats * (LOG_TWO_PI + jnp.log(variance)) - misfit / (2 * variance)


def complex_gaussian_marginal_log_likelihood(
    mean: Complexes,
    within_ss: Real,
    num_repeats: Real,
    model: Complexes,
) -> Float[Array, ""]:
    r"""Log likelihood of complex repeats with the unknown common noise integrated out.

    $$\log p = -N K \log \sum_{i,k} |d_{ik} - m_i|^2 + \mathrm{const}$$

    Args:
        mean: Mean of the repeats.
        within_ss: Sum of squares S: at each point, or in all.
        num_repeats: K.
        model: Prediction m.

    Returns:
        One number [nats], up to a constant: the points share the noise, so there are no
        independent terms.

    Reference:
        Eq. (36) under the Jeffreys prior 1/sigma.
    """
    total = jnp.sum(num_repeats * _squared_modulus(mean - model)) + jnp.sum(within_ss)
    return -mean.size * jnp.asarray(num_repeats) * jnp.log(total)


def _squared_modulus(value: Complexes) -> Float[Array, "..."]:
    return jnp.square(jnp.real(value)) + jnp.square(jnp.imag(value))
