"""The joint: parameters of the single-mode Bouc-Wen oscillator."""

import equinox as eqx
from jaxtyping import Array, Float

Scalar = Float[Array, "..."] | float


class BoucWen(eqx.Module):
    r"""Single-mode Bouc-Wen oscillator, per unit modal mass.

    $$\ddot y + 2\zeta\omega_n\dot y + k\,y + Z = u, \qquad k = \omega_n^2 - \alpha$$
    $$\dot Z = \alpha\dot y - \gamma|\dot y||Z|^{\nu-1}Z - \delta\dot y|Z|^\nu$$

    `omega_n` is the natural frequency at small amplitude, where the joint sticks. Leaves may be
    scalars or arrays of one shape (a batch of joints).

    Attributes:
        omega_n: Natural frequency at small amplitude [rad/s].
        zeta: Viscous damping ratio [-].
        alpha: Stiffness of the hysteretic part [1/s^2].
        delta: Softening of the hysteresis [1/m for nu = 1].
        gamma: Opening of the hysteresis loop [1/m for nu = 1].
        nu: Smoothness exponent [-]; static.

    Reference:
        Eqs. (1), (2), (39).
    """

    omega_n: Scalar
    zeta: Scalar
    alpha: Scalar
    delta: Scalar
    gamma: Scalar
    nu: float = eqx.field(default=1.0, static=True)

    @property
    def k(self) -> Scalar:
        """Stiffness beside the joint, omega_n^2 - alpha [1/s^2]."""
        return self.omega_n**2 - self.alpha
