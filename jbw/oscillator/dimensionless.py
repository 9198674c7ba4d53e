r"""The joint in its own units: time in 1/omega_n, displacement in A/omega_n^2.

The oscillator under u = A cos(omega t) is then the joint of omega_n = 1 under cos(Omega theta),
its alpha over omega_n^2, its delta and gamma times A/omega_n^2. The load A enters through these
two alone (and through the restoring force beside them, where there is one), so A = 0 is the linear
oscillator and an ordinary point.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from jbw.oscillator.parameters import BoucWen, Restoring, Scalar


class ScaledForce(eqx.Module):
    r"""A restoring force in other units, $f(\ell q)/(\kappa\ell)$; $f'(0)\,q/\kappa$ at l = 0.

    Attributes:
        force: f, from the displacement to the force.
        length: Unit l of displacement.
        stiffness: Unit kappa of stiffness.
    """

    force: Restoring
    length: Scalar
    stiffness: Scalar

    def __call__(self, q: Scalar) -> Scalar:
        """Force at the displacement q."""
        at_rest = self.length == 0.0
        length = jnp.where(at_rest, 1.0, self.length)
        _, linear = jax.jvp(self.force, (jnp.zeros_like(q),), (q,))
        return jnp.where(at_rest, linear, self.force(length * q) / length) / self.stiffness


def dimensionless(joint: BoucWen, omega: Scalar, amplitude: Scalar) -> tuple[BoucWen, Array, Array]:
    r"""Joint, frequency and unit of displacement of the dimensionless problem.

    $$\Omega = \omega/\omega_n, \quad \alpha/\omega_n^2, \quad \delta A/\omega_n^2, \quad
      \gamma A/\omega_n^2, \quad f\!\left((A/\omega_n^2)\,q\right)/A, \quad y = (A/\omega_n^2)\, q$$

    Args:
        joint: Bouc-Wen parameters.
        omega: Angular frequency [rad/s].
        amplitude: Amplitude A of the force [N/kg].

    Returns:
        Dimensionless joint, Omega, A/omega_n^2 [m].
    """
    stiffness = joint.omega_n**2
    length = jnp.asarray(amplitude / stiffness)
    unit = BoucWen(
        jnp.ones_like(length),
        joint.zeta,
        joint.alpha / stiffness,
        joint.delta * length,
        joint.gamma * length,
        restoring=_scaled(joint.restoring, length, stiffness),
    )
    return unit, jnp.asarray(omega / joint.omega_n), length


def loaded(joint: BoucWen, load: Scalar) -> BoucWen:
    """The dimensionless joint under a part of its load.

    Args:
        joint: Dimensionless joint.
        load: The part, from 0 to 1 [-].

    Returns:
        Dimensionless joint, in the unit of displacement of that load.
    """
    return BoucWen(
        joint.omega_n,
        joint.zeta,
        joint.alpha,
        load * joint.delta,
        load * joint.gamma,
        restoring=_scaled(joint.restoring, load, 1.0),
    )


def _scaled(force: Restoring | None, length: Scalar, stiffness: Scalar) -> ScaledForce | None:
    return None if force is None else ScaledForce(force, length, stiffness)
