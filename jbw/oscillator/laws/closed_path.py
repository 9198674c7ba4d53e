r"""Hysteretic force along a periodic motion that turns twice a period (nu = 1).

Between its two turning points the motion is monotone, so the force depends on the path through the
peak Y alone: it is the steady loop's, in closed form. Everything is in one unit of length, with
delta and gamma in its inverse and z over alpha.
"""

import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Complex, Float

from jbw.oscillator.laws.relaxation import half_width, opening_and_area, unloading_lag
from jbw.oscillator.parameters import Scalar
from jbw.oscillator.steady.waveform import angle_of, crest, exponentials, gauss_legendre, synthesis

# The force is smooth between turning point and zero; each harmonic adds about pi/2 of phase there.
_NODES = 24
_NODES_PER_HARMONIC = 2


def opening(y_peak: Scalar, delta: Scalar, gamma: Scalar) -> Float[Array, "..."]:
    """Displacement at which z vanishes on unloading from `y_peak`, with gamma's sign."""
    sign = jnp.where(gamma < 0.0, -1.0, 1.0)
    d, g = delta * y_peak, sign * gamma * y_peak
    return sign * y_peak * opening_and_area(half_width(d, g), d + g, g)[0]


def relaxed_force(
    q: Complex[Array, " harmonic"], delta: Scalar, gamma: Scalar
) -> Complex[Array, " harmonic"]:
    r"""Harmonics of what relaxation takes from the elastic force, r = z/alpha - y.

    $$r_n = \frac{2}{\pi}\int_{\theta_t}^{\theta_t+\pi} r\, e^{-jn\theta}\,d\theta, \qquad
      r = -(y_0 + \text{lag}) \text{ on unloading}$$

    by Gauss-Legendre between the turning points and the zero of z. The integrand is continuous
    at these break points and equal at both ends, to its first derivative, so their motion adds
    nothing to two derivatives of r_n and the nodes carry none.

    Args:
        q: Complex amplitudes of the odd orders of y.
        delta: Softening, in the inverse unit of `q`.
        gamma: Opening, in the inverse unit of `q`.

    Returns:
        Complex amplitudes of r, in the unit of `q`.
    """
    num_harmonics = q.shape[0]
    delta, gamma = jnp.asarray(delta), jnp.asarray(gamma)
    start = crest(q)
    y_open = opening(synthesis(q, start), delta, gamma)
    start_fixed = stop_gradient(start)
    zero = angle_of(*stop_gradient((q, start, y_open)))
    num_nodes = _NODES + _NODES_PER_HARMONIC * num_harmonics
    segments = (
        gauss_legendre(num_nodes, start_fixed, zero),
        gauss_legendre(num_nodes, zero, start_fixed + jnp.pi),
    )
    theta, weights = (jnp.concatenate(part) for part in zip(*segments, strict=True))
    basis = exponentials(theta, num_harmonics)
    y = jnp.sum(basis * q, -1).real
    r = -(y_open + unloading_lag(y, y_open, delta, gamma))
    return 2.0 / jnp.pi * ((weights * r) @ basis.conj())


def force_over_period(
    q: Complex[Array, " harmonic"],
    theta: Float[Array, " time"],
    delta: Scalar,
    gamma: Scalar,
) -> Float[Array, " time"]:
    """Hysteretic force z/alpha at angles of the period.

    Args:
        q: Complex amplitudes of the odd orders of y.
        theta: Angles [rad].
        delta: Softening, in the inverse unit of `q`.
        gamma: Opening, in the inverse unit of `q`.

    Returns:
        z/alpha, in the unit of `q`.
    """
    delta, gamma = jnp.asarray(delta), jnp.asarray(gamma)
    y_open = opening(synthesis(q, crest(q)), delta, gamma)
    # Loading mirrors unloading.
    side = jnp.where(synthesis(q, theta, 1) > 0.0, -1.0, 1.0)
    y = side * synthesis(q, theta)
    return side * (y - y_open - unloading_lag(y, y_open, delta, gamma))
