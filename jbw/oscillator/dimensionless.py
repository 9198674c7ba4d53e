r"""The Bouc-Wen joint in dimensionless form: time in 1/omega_n, displacement in A/omega_n^2.

The oscillator under u = A cos(omega t) becomes a joint with omega_n = 1 under cos(Omega theta),
with alpha divided by omega_n^2, and delta and gamma multiplied by A/omega_n^2. The amplitude A
enters only through these two (and through the restoring force, if there is one), so A = 0 is the
linear oscillator and a regular point.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from jbw.oscillator.checks import require_at_least, require_closed_form, require_finite
from jbw.oscillator.oscillator import BoucWen
from jbw.oscillator.parameters import Restoring, Scalar


class Dimensionless(NamedTuple):
    """A joint under a harmonic force, in dimensionless form.

    Attributes:
        joint: Joint of omega_n = 1 under a tone of amplitude 1.
        frequency: Frequency of the tone over omega_n [-].
        length: Unit of displacement, A/omega_n^2 [m].
    """

    joint: BoucWen
    frequency: Array
    length: Array


class ScaledForce(eqx.Module):
    r"""A restoring force in other units, $f(\ell q)/(\kappa\ell)$; $f'(0)\,q/\kappa$ at l = 0.

    Attributes:
        force: Force f as a function of displacement.
        length: Unit l of displacement.
        stiffness: Unit kappa of stiffness.
    """

    force: Restoring
    length: Scalar
    stiffness: Scalar

    def __call__(self, q: Scalar) -> Scalar:
        """Return the scaled force at the scaled displacement q."""
        length = jnp.asarray(self.length)
        at_rest = length == 0.0
        safe = jnp.where(at_rest, 1.0, length)
        _, linear = jax.jvp(self.force, (jnp.zeros_like(q),), (q,))
        return jnp.where(at_rest, linear, self.force(safe * q) / safe) / self.stiffness


def dimensionless(joint: BoucWen, omega: Scalar, amplitude: Scalar) -> Dimensionless:
    r"""Return a joint under a harmonic force in dimensionless form, with its unit of displacement.

    $$\Omega = \omega/\omega_n, \quad \alpha/\omega_n^2, \quad \delta A/\omega_n^2, \quad
      \gamma A/\omega_n^2, \quad f\!\left((A/\omega_n^2)\,q\right)/A, \quad y = (A/\omega_n^2)\, q$$

    Args:
        joint: Bouc-Wen parameters with nu = 1.
        omega: Angular frequency of the tone [rad/s].
        amplitude: Amplitude A of the force [N/kg]; 0 is the linear oscillator.

    Returns:
        Dimensionless joint, frequency and unit of displacement.

    Raises:
        ModelError: nu is not 1, or a concrete argument is not finite.
        ConfigError: A concrete `omega` or `amplitude` is negative.

    Reference:
        Eq. (1), as printed, divided by its own scales.

    Examples:
        The frequency becomes omega / omega_n and the unit of length A / omega_n^2:

        >>> import jbw; jbw.enable_x64()
        >>> joint = jbw.BoucWen(omega_n=100.0, zeta=0.01, alpha=500.0, delta=340.0, gamma=33.0)
        >>> scaled = jbw.dimensionless(joint, omega=90.0, amplitude=2.0)
        >>> print(f"{scaled.frequency:.2f}, {scaled.length:.4f} m, alpha {scaled.joint.alpha:.3f}")
        0.90, 0.0002 m, alpha 0.050
    """
    require_closed_form(joint)
    require_finite(joint, omega=omega, amplitude=amplitude)
    require_at_least("omega", omega, 0.0)
    require_at_least("amplitude", amplitude, 0.0)
    stiffness = jnp.asarray(joint.omega_n) ** 2
    length = jnp.asarray(amplitude / stiffness)
    force = joint.restoring
    unit = BoucWen(
        jnp.ones_like(length),
        joint.zeta,
        joint.alpha / stiffness,
        joint.delta * length,
        joint.gamma * length,
        restoring=None if force is None else ScaledForce(force, length, stiffness),
    )
    return Dimensionless(unit, jnp.asarray(omega / jnp.asarray(joint.omega_n)), length)
