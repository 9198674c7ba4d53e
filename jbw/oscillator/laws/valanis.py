r"""Valanis's endochronic law, and Dahl's law as a limit of it.

It is not in the register, because in small motion it has no softening of first order while joints
have: use `register` to fit or compare it.

Reference:
    Valanis (1971); Gaul and Lenz, Acta Mechanica 125 (1997) 169; Dahl (1968).
"""

from typing import Any, ClassVar

import jax.numpy as jnp

from jbw.oscillator.law import Bounds, Law, Scales
from jbw.oscillator.laws.bouc_wen import SHARE, BoucWenLaw
from jbw.oscillator.parameters import Scalar
from jbw.quantities import Quantity

MOST_MICROSLIP = 0.95  # largest kappa; at 1 the slope after a reversal is infinite


class Valanis(Law):
    r"""Valanis's endochronic law; s is the direction of motion and $Z = F - E_t y$.

    $$\frac{dZ}{dy} = \frac{E_0 - \lambda s Z}{1 - \kappa\lambda s Z / E_0} - E_t, \qquad
      |Z| < \frac{E_0 - E_t}{\lambda (1 - \kappa E_t / E_0)}$$

    With $\kappa = 0$ it is Bouc-Wen's law with delta = 0, gamma = lambda and alpha = E_0 - E_t,
    parallel to a spring E_t. If E_t = 0 too, it is Dahl's law with the friction force E_0/lambda.

    Attributes:
        valanis_stiffness: Stiffness E_0 of the stuck joint [1/s^2].
        valanis_hardening: Stiffness of the fully slipping joint over that of the stuck joint,
            E_t/E_0 [-].
        valanis_rate: Rate lambda at which the force approaches its limit [1/m].
        valanis_microslip: Degree kappa of sticking below the force limit, from 0 to below 1 [-].
    """

    name: ClassVar[str] = "valanis"
    table: ClassVar[tuple[Quantity, ...]] = (
        Quantity(
            "valanis_stiffness",
            "E₀",
            "1/s^2",
            "stiffness of the stuck joint",
            0.0,
            is_share=True,
        ),
        Quantity("valanis_hardening", "E_t/E₀", "1", "stiffness left when all slips", 0.0),
        Quantity("valanis_rate", "λ", "1/m", "rate at which the force approaches its limit", 0.0),
        Quantity("valanis_microslip", "κ", "1", "degree of sticking below the force limit", 0.0),
    )

    valanis_stiffness: Scalar
    valanis_hardening: Scalar
    valanis_rate: Scalar
    valanis_microslip: Scalar

    @classmethod
    def dahl(cls, stiffness: Scalar, friction: Scalar) -> "Valanis":
        """Build Dahl's law from a stiffness [1/s^2] and a friction force [N/kg]."""
        return cls(stiffness, 0.0, stiffness / friction, 0.0)

    def bouc_wen_limit(self) -> BoucWenLaw:
        """Return the Bouc-Wen law that equals this law at kappa = 0, less a parallel spring E_t."""
        alpha = self.valanis_stiffness * (1.0 - self.valanis_hardening)
        return BoucWenLaw(alpha, 0.0, self.valanis_rate)

    @classmethod
    def prior(cls, scales: Scales) -> Bounds:
        """Return prior bounds: a share of omega_n^2, and slip far below to far above the motion."""
        low, high = (part * scales.omega_n**2 for part in SHARE)
        return {
            "valanis_stiffness": (low, high),
            "valanis_hardening": (0.0, 0.99),
            "valanis_rate": (1e-3 / scales.y_peak, 1e2 / scales.y_peak),
            "valanis_microslip": (0.0, MOST_MICROSLIP),
        }

    def stiffness(self) -> Scalar:
        """Return the initial stiffness E_0 [1/s^2]."""
        return self.valanis_stiffness

    def at_rest(self) -> Scalar:
        """Return the internal state at rest, Z = 0."""
        return 0.0

    def force(self, y: Scalar, v: Scalar, memory: Scalar) -> Scalar:
        """Return the force Z + E_t y [N/kg]."""
        return memory + self.valanis_hardening * self.valanis_stiffness * y

    def rate(self, y: Scalar, v: Scalar, memory: Scalar) -> Any:
        """Return the time derivative of Z: the slope dZ/dy for this direction, times v."""
        stiffness, towards = self.valanis_stiffness, jnp.where(v < 0.0, -1.0, 1.0)
        part = towards * self.valanis_rate * memory / stiffness
        slope = stiffness * ((1.0 - part) / (1.0 - self.valanis_microslip * part))
        return (slope - self.valanis_hardening * stiffness) * v
