"""Powers of displacement, for the stiffness loss of microslip laws."""

import jax
import jax.numpy as jnp
from jax.scipy.special import gammaln
from jaxtyping import Array, Float

from jbw.oscillator.parameters import Scalar
from jbw.oscillator.power_losses import power_losses

# Displacement [m] at which a power law's stiffness loss is stated; the law does not depend on it.
REFERENCE = 1e-3
# reciprocal of `REFERENCE`, because multiplication is faster than division
PER_REFERENCE = 1.0 / REFERENCE


@jax.custom_jvp
def power(x: Scalar, exponent: Scalar) -> Float[Array, "..."]:
    """Return x^exponent for x >= 0; the value and two derivatives are zero at x = 0."""
    # `pow` is called once, because a logarithm and an exponential would have to wait for each
    # other.
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
    """Return a power law's stiffness loss and damping; NumPy is used for a plain float exponent."""
    if isinstance(exponent, float):
        return power_losses(exponent)
    return power_losses(jnp.asarray(exponent, float), jnp, gammaln)
