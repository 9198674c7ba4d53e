"""A power of the displacement, by which laws of microslip lose stiffness."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import gammaln
from jaxtyping import Array, Float
from scipy import special

from jbw.oscillator.parameters import Scalar

# Displacement at which the power law's loss of stiffness is stated: the law is the same for any.
REFERENCE = 1e-3
PER_REFERENCE = 1.0 / REFERENCE  # a product in every time step, where a quotient takes long


@jax.custom_jvp
def power(x: Scalar, exponent: Scalar) -> Float[Array, "..."]:
    """Power of x >= 0, its exponent above zero, with derivatives at x = 0, where both are 0."""
    # One call: a logarithm and an exponential wait for each other in every step.
    return jnp.power(jnp.maximum(jnp.asarray(x, float), 0.0), exponent)


@power.defjvp
def _power_jvp(primals, tangents):
    (x, exponent), (x_dot, exponent_dot) = primals, tangents
    x_power = power(x, exponent)
    acts = jnp.asarray(x) > 0.0
    safe = jnp.where(acts, x, 1.0)
    by_x = jnp.where(acts, exponent * x_power / safe, 0.0)
    return x_power, by_x * x_dot + x_power * jnp.log(safe) * exponent_dot


def power_loop(exponent: Scalar) -> tuple[Scalar, Scalar]:
    r"""Losses of stiffness and damping of the lag $c\,x^{1+q}$, over $c\,Y^q$; exact.

    $$C_s = \frac{8}{\pi} I(2q+2) \frac{1+q}{2+q}, \qquad C_d = \frac{4q}{\pi (2+q)}, \qquad
      I(n) = \int_0^{\pi/2} \sin^n = \frac{\sqrt\pi}{2}
      \frac{\Gamma((n+1)/2)}{\Gamma(n/2+1)}$$
    """
    is_constant = isinstance(
        exponent, float
    )  # then by NumPy: there is nothing to trace or to compile
    q = exponent if is_constant else jnp.asarray(exponent, float)
    xp, log_gamma = (np, special.gammaln) if is_constant else (jnp, gammaln)
    integral = 0.5 * np.sqrt(np.pi) * xp.exp(log_gamma(q + 1.5) - log_gamma(q + 2.0))
    return 8.0 / np.pi * integral * (1.0 + q) / (2.0 + q), 4.0 / np.pi * q / (2.0 + q)
