"""The Bouc-Wen hysteresis: its rate, its exact map along a path, and its steady loop."""

import warnings

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Complex, Float, Real

from jbw.errors import ModelError
from jbw.oscillator.checks import (
    is_concrete,
    require_at_least,
    require_closed_form,
    require_finite,
)
from jbw.oscillator.laws.relaxation import half_width, loop_harmonics, opening_and_area, phi, psi
from jbw.oscillator.parameters import Hysteresis
from jbw.report.messages import joint as messages

# Largest plausible exponent of the exponential approach to slip. The strongest sweeps reach 17;
# above this limit the joint slips fully, or a unit is wrong.
_LARGEST_EXPONENT = 50.0
_REMEDY = "Check delta and gamma [1/m] and the unit of the displacement [m]."


class SteadyLoop(eqx.Module):
    """The steady symmetric loop for y = Y cos(theta), z = Re sum z_n exp(j n theta).

    Attributes:
        y_open: Displacement at which z vanishes on unloading, with gamma's sign [m].
        z_max: Hysteretic force at y = Y [N/kg].
        energy: Energy dissipated per cycle, with gamma's sign [J/kg].
        z_1: First harmonic of z, peak amplitude [N/kg].
        z_3: Third harmonic of z, peak amplitude [N/kg].
        z_5: Fifth harmonic of z, peak amplitude [N/kg].
        k_eq: Equivalent stiffness of z, Re(z_1)/Y [1/s^2].
        c_eq_omega: Equivalent viscous damping of z times omega, energy/(pi Y^2) [1/s^2].
        secant_stiffness: z_max/Y [1/s^2].
    """

    y_open: Float[Array, "..."]
    z_max: Float[Array, "..."]
    energy: Float[Array, "..."]
    z_1: Complex[Array, "..."]
    z_3: Complex[Array, "..."]
    z_5: Complex[Array, "..."]
    k_eq: Float[Array, "..."]
    c_eq_omega: Float[Array, "..."]
    secant_stiffness: Float[Array, "..."]


def hysteresis_rate(
    joint: Hysteresis, v: Real[ArrayLike, "..."], z: Real[ArrayLike, "..."]
) -> Float[Array, "..."]:
    r"""Return the rate of the hysteretic force, for every nu > 0.

    $$\dot Z = \alpha v - \gamma |v| |Z|^{\nu-1} Z - \delta v |Z|^\nu$$

    At v = 0 and at z = 0 the derivatives are the mean of the two sides.

    Args:
        joint: Bouc-Wen parameters.
        v: Velocity [m/s].
        z: Hysteretic force [N/kg].

    Returns:
        Rate of z [N/kg/s].

    Raises:
        ModelError: `nu` is not greater than 0.

    Reference:
        Eq. (2).

    Examples:
        The rate is (alpha - (delta + gamma) z) v in loading and (alpha - (delta - gamma) z) v in
        unloading:

        >>> import jbw; jbw.enable_x64()
        >>> joint = jbw.BoucWen(omega_n=118.12, zeta=0.00444, alpha=500.0, delta=350.0, gamma=50.0)
        >>> loading, unloading = (jbw.hysteresis_rate(joint, v=v, z=0.5) for v in (0.1, -0.1))
        >>> print(f"{loading:.1f}, {unloading:.1f} N/kg/s")
        30.0, -35.0 N/kg/s
    """
    if not joint.nu > 0.0:
        raise ModelError(f"Parameter `nu` must be greater than 0, but nu = {joint.nu:g}.")
    v, z = jnp.asarray(v), jnp.asarray(z)
    size, signed = jnp.abs(z), z
    if joint.nu != 1.0:
        # The power's derivative is infinite or NaN at z = 0; there both terms vanish.
        safe = jnp.where(z == 0.0, 1.0, size)
        size = jnp.where(z == 0.0, 0.0, safe**joint.nu)
        signed = jnp.sign(z) * size
    return joint.alpha * v - joint.gamma * jnp.abs(v) * signed - joint.delta * v * size


def hysteresis_map(
    joint: Hysteresis, z: Real[ArrayLike, "..."], dy: Real[ArrayLike, "..."]
) -> Float[Array, "..."]:
    r"""Return the hysteretic force after a monotone move dy, exact for nu = 1.

    $$\frac{dZ}{dy} = \alpha - \gamma\,\mathrm{sgn}(dy)\,Z - \delta\,|Z|$$

    Towards zero z relaxes at the rate gamma - delta, away from it at gamma + delta; each part is
    z + (alpha - c z) phi(c, x). Nothing is singular at gamma = +-delta or dy = 0; the derivative
    at dy = 0 is that of loading (dy > 0).

    Args:
        joint: Bouc-Wen parameters with nu = 1.
        z: Hysteretic force before the move [N/kg].
        dy: Move, in one direction [m].

    Returns:
        Hysteretic force after the move [N/kg].

    Raises:
        ModelError: `nu` is not 1, or a concrete argument is not finite.

    Reference:
        Eq. (2) in closed form; each part is one of Eqs. (3)-(6).

    Examples:
        The force of a stuck joint becomes alpha (1 - exp(-c dy)) / c with c = delta + gamma:

        >>> import jbw; jbw.enable_x64()
        >>> joint = jbw.BoucWen(omega_n=118.12, zeta=0.00444, alpha=500.0, delta=350.0, gamma=50.0)
        >>> print(f"{jbw.hysteresis_map(joint, z=0.0, dy=1e-3):.4f} N/kg")
        0.4121 N/kg
    """
    require_closed_form(joint)
    require_finite(joint, z=z, dy=dy)
    if is_concrete(joint, z, dy):
        _warn_unbounded(joint, z, dy)
    return _move(joint, z, dy)


@jax.jit
def _move(joint: Hysteresis, z: ArrayLike, dy: ArrayLike) -> Array:
    dy = jnp.asarray(dy)
    direction = jnp.where(dy < 0.0, -1.0, 1.0)
    distance, z = direction * dy, direction * z
    towards_zero = z < 0.0
    c_in, c_out = joint.gamma - joint.delta, joint.gamma + joint.delta
    z_in = jnp.where(towards_zero, z, 0.0)
    to_zero = -psi(c_in / joint.alpha, z_in) / joint.alpha
    stays = towards_zero & (distance <= to_zero)
    # Both parts are always computed; the part that does not apply gets a move of length zero.
    inner = z_in + (joint.alpha - c_in * z_in) * phi(c_in, jnp.where(stays, distance, 0.0))
    z_out = jnp.where(towards_zero, 0.0, z)
    rest = jnp.where(stays, 0.0, distance - jnp.where(towards_zero, to_zero, 0.0))
    outer = z_out + (joint.alpha - c_out * z_out) * phi(c_out, rest)
    return direction * jnp.where(stays, inner, outer)


def steady_loop(joint: Hysteresis, y_peak: Real[ArrayLike, "..."]) -> SteadyLoop:
    r"""Return the steady symmetric loop of z for a displacement between -Y and Y, nu = 1.

    With g = |gamma|, b = delta + g and x = Y + |y_open|, half the width on which z has one sign,

    $$Z_{max} = \alpha\,\phi(b, x), \qquad
      |y_0| = x - Y = g \int_0^x \frac{\phi(b,t)}{e^{-bt} + 2 g \phi(b,t)}\,dt$$
    $$|E| = 4 \alpha g \int_0^x \frac{\phi(b,t)^2}{e^{-bt} + 2 g \phi(b,t)}\,dt$$

    where the denominator is 1 - (delta - g) phi(b, t) written without cancellation. Everything is
    computed in units of Y, where only delta Y and gamma Y remain, so Y = 0 is a regular point.
    Opening, tip and energy are accurate to about 1e-14, stiffness and harmonics to 1e-12 where
    (delta + |gamma|) (Y + |y_open|) is some hundreds.

    Args:
        joint: Bouc-Wen parameters with nu = 1; omega_n, zeta and `restoring` have no influence.
        y_peak: Largest displacement Y [m].

    Returns:
        The loop, its harmonics and its equivalent stiffness and damping.

    Raises:
        ModelError: `nu` is not 1, or a concrete argument is not finite.
        ConfigError: A concrete `y_peak` is negative.

    Reference:
        Closes Eqs. (3)-(6), which leave the threshold y_0 open.

    Examples:
        The energy lost per cycle is near 4/3 alpha gamma Y^3 while delta Y is small:

        >>> import jbw; jbw.enable_x64()
        >>> joint = jbw.BoucWen(omega_n=118.12, zeta=0.00444, alpha=497.4, delta=340.2, gamma=32.8)
        >>> loop = jbw.steady_loop(joint, y_peak=0.01e-3)
        >>> print(f"{1e12 * loop.energy:.1f} pJ/kg")
        21.8 pJ/kg
    """
    require_closed_form(joint)
    if is_concrete(y_peak):
        require_finite(joint, y_peak=y_peak)
        require_at_least("y_peak", y_peak, 0.0)
    loop = _loop(joint, y_peak)
    if is_concrete(joint, y_peak, loop):
        _warn_saturated(joint, y_peak, loop)
    return loop


@jax.jit
def _loop(joint: Hysteresis, y_peak: ArrayLike) -> SteadyLoop:
    alpha, delta, gamma, y_peak = jnp.broadcast_arrays(
        *(jnp.asarray(value, float) for value in (joint.alpha, joint.delta, joint.gamma, y_peak))
    )
    sign = jnp.where(gamma < 0.0, -1.0, 1.0)
    p, g = delta * y_peak, sign * gamma * y_peak
    x = half_width(p, g)
    opening, area = opening_and_area(x, p + g, g)
    z_max = phi(p + g, x)
    harmonics = loop_harmonics(p, sign * g, sign * opening, sign * area)
    force = alpha * y_peak
    return SteadyLoop(
        y_open=sign * opening * y_peak,
        z_max=force * z_max,
        energy=sign * area * force * y_peak,
        z_1=force * harmonics[0],
        z_3=force * harmonics[1],
        z_5=force * harmonics[2],
        k_eq=alpha * harmonics[0].real,
        c_eq_omega=alpha * harmonics[0].imag,
        secant_stiffness=alpha * z_max,
    )


def _warn_unbounded(joint: Hysteresis, z: ArrayLike, dy: ArrayLike) -> None:
    """Warn if z grows without bound instead of approaching alpha/(delta + gamma)."""
    alpha, delta, gamma = (np.asarray(x) for x in (joint.alpha, joint.delta, joint.gamma))
    if np.any((alpha <= 0.0) | (delta + gamma < 0.0)):
        reason = messages.BOUNDED
    elif np.any((np.asarray(z) * dy < 0.0) & (np.abs(z) * (delta - gamma) >= alpha)):
        reason = messages.unloads_beyond(np.max(np.abs(z)))
    else:
        return
    parameters = {"alpha": alpha, "delta": delta, "gamma": gamma}
    warnings.warn(messages.unbounded(reason, parameters, _REMEDY), stacklevel=3)


def _warn_saturated(joint: Hysteresis, y_peak: ArrayLike, loop: SteadyLoop) -> None:
    """Warn if the joint slips almost completely, because a wrong unit would cause this."""
    exponent = np.abs(joint.delta + np.abs(joint.gamma)) * (y_peak + np.abs(loop.y_open))
    if np.any(exponent > _LARGEST_EXPONENT):
        warnings.warn(
            f"The steady loop is saturated, (delta + |gamma|) (y_peak + |y_open|) = "
            f"{np.max(exponent):.3g} > {_LARGEST_EXPONENT:g}: the joint slips almost all the way. "
            f"{_REMEDY}",
            stacklevel=3,
        )
