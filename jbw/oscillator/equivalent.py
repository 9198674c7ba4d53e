"""The equivalent system: the oscillator with its hysteresis smoothed to a polynomial."""

from typing import Literal

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Complex, Float, Real

from jbw.errors import ConfigError
from jbw.oscillator.checks import require_at_least
from jbw.oscillator.parameters import BoucWen, Scalar
from jbw.oscillator.smoothing import Smoothing, smoothed_force


def square_wave(
    lambda_0: Scalar,
    theta: Real[ArrayLike, "..."],
    variant: Literal["corrected", "printed"] = "corrected",
    num_terms: int = 2,
) -> Float[Array, "..."]:
    r"""Fourier series of the switched force u_0 = lambda_0 sgn(v) for y = Y cos(theta).

    $$u_0 = -\frac{4\lambda_0}{\pi} \sum_{m = 1, 3, \dots} \frac{\sin m\theta}{m}$$

    Two terms hold 90.1 % of the square wave's power. The printed series has the opposite sign, as
    has the lambda_0 of Eq. (10): printed with printed is right again. theta is the phase of y; the
    paper's phase of u is the same below resonance only.

    Args:
        lambda_0: Force at y = 0 [N/kg].
        theta: Phase of the displacement [rad].
        variant: Sign of the series: "corrected" as above, or "printed".
        num_terms: Number of odd harmonics kept.

    Returns:
        Force u_0, on the side of the restoring forces [N/kg].

    Raises:
        ConfigError: The variant is unknown or `num_terms` is below 1.

    Reference:
        Eq. (15).
    """
    if variant not in ("corrected", "printed"):
        raise ConfigError(
            f'Argument `variant` must be "corrected" or "printed", but it is "{variant}".'
        )
    require_at_least("num_terms", num_terms, 1)
    sign = -1.0 if variant == "corrected" else 1.0
    m = 2.0 * jnp.arange(num_terms) + 1.0
    series = jnp.sum(jnp.sin(m * jnp.asarray(theta)[..., None]) / m, axis=-1)
    return sign * 4.0 / jnp.pi * jnp.asarray(lambda_0) * series


def smoothed_harmonics(
    smoothing: Smoothing, y_peak: Real[ArrayLike, "..."]
) -> tuple[Complex[Array, "..."], Complex[Array, "..."]]:
    r"""First and third harmonic of the smoothed force for y = Y cos(theta).

    $$Z_1 = \lambda_1 Y + \tfrac34 \lambda_3 Y^3
      + \frac{4j}{\pi}\left(\lambda_0 - \tfrac13 \lambda_2 Y^2\right)$$
    $$Z_3 = \tfrac14 \lambda_3 Y^3
      + \frac{4j}{3\pi}\left(\lambda_0 - \tfrac75 \lambda_2 Y^2\right)$$

    Args:
        smoothing: Coefficients of the smoothed force.
        y_peak: Amplitude Y [m].

    Returns:
        Peak complex amplitudes Z_1 and Z_3 [N/kg].

    Reference:
        Eqs. (7), (8), (14).
    """
    y = jnp.asarray(y_peak)
    cubic, opening = smoothing.lambda_3 * y**3, smoothing.lambda_2 * y**2
    sine_1 = 4.0 / jnp.pi * (smoothing.lambda_0 - opening / 3.0)
    sine_3 = 4.0 / (3.0 * jnp.pi) * (smoothing.lambda_0 - 7.0 / 5.0 * opening)
    return smoothing.lambda_1 * y + 0.75 * cubic + 1j * sine_1, 0.25 * cubic + 1j * sine_3


def equivalent_force(
    smoothing: Smoothing,
    y: Real[ArrayLike, "..."],
    v: Real[ArrayLike, "..."],
    u_0: Real[ArrayLike, "..."] | None = None,
) -> Float[Array, "..."]:
    r"""Smoothed hysteretic force with its switched part given from outside.

    $$Z = \lambda_1 y + \rho\,y^2 + \lambda_3 y^3 + u_0, \qquad \rho = -\lambda_2\,\mathrm{sgn}(v)$$

    Args:
        smoothing: Coefficients of the smoothed force.
        y: Displacement [m].
        v: Velocity [m/s].
        u_0: Switched force [N/kg]; lambda_0 sgn(v) when None.

    Returns:
        Force [N/kg].

    Reference:
        Eq. (14).
    """
    force = smoothed_force(smoothing, y, v)
    return force if u_0 is None else force - smoothing.lambda_0 * jnp.sign(v) + u_0


def equivalent_acceleration(
    joint: BoucWen,
    smoothing: Smoothing,
    y: Real[ArrayLike, "..."],
    v: Real[ArrayLike, "..."],
    u: Real[ArrayLike, "..."],
    u_0: Real[ArrayLike, "..."] | None = None,
) -> Float[Array, "..."]:
    r"""Acceleration of the equivalent system.

    $$\ddot y = u - 2\zeta\omega_n\dot y - (k+\lambda_1)\,y - \rho\,y^2 - \lambda_3 y^3 - u_0$$

    less the restoring force f(y) of the joint, where it has one.

    Args:
        joint: Bouc-Wen parameters; k, zeta, omega_n and `restoring` are used.
        smoothing: Coefficients of the smoothed force.
        y: Displacement [m].
        v: Velocity [m/s].
        u: Input [N/kg].
        u_0: Switched force [N/kg]; lambda_0 sgn(v) when None.

    Returns:
        Acceleration [m/s^2].

    Reference:
        Eq. (14).
    """
    y, v, u = jnp.asarray(y), jnp.asarray(v), jnp.asarray(u)
    viscous = 2.0 * joint.zeta * joint.omega_n * v
    a = u - viscous - joint.k * y - equivalent_force(smoothing, y, v, u_0)
    return a if joint.restoring is None else a - joint.restoring(y)
