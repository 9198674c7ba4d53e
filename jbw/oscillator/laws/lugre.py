r"""The LuGre law, whose friction falls with speed; for simulation only.

Its force depends on the rate of motion, so that it has no loop, no backbone and no move along a
path without time; joints in harmonic motion at one frequency show no such dependence. It is not in
the register: a stock solver integrates it, and nothing fits it.

Reference:
    Canudas de Wit, Olsson, Astrom and Lischinsky (1995), IEEE Trans. Autom. Control 40, 419.
"""

from typing import ClassVar, NoReturn

import jax.numpy as jnp

from jbw.errors import ModelError
from jbw.oscillator.law import Law
from jbw.oscillator.parameters import Scalar
from jbw.quantities import Quantity


class LuGre(Law):
    r"""LuGre friction: bristles with mean deflection z, which slip according to $g(v)$.

    $$\dot z = v - \frac{\sigma_0 |v|}{g(v)}\,z, \qquad
      g(v) = F_c + (F_s - F_c)\,e^{-(v/v_s)^2}, \qquad
      F = \sigma_0 z + \sigma_1 \dot z + \sigma_2 v$$

    With F_s = F_c and sigma_1 = sigma_2 = 0 it is Dahl's law. Motion with
    $\sigma_0 |v| / g$ above the sampling rate is stiff.

    Attributes:
        lugre_stiffness: Stiffness sigma_0 of the bristles [1/s^2].
        lugre_friction: Friction F_c of fast motion [N/kg].
        lugre_static: Friction F_s at rest [N/kg].
        lugre_speed: Stribeck's speed v_s, at which static friction turns into friction of motion
            [m/s].
        lugre_bristle_damping: Damping sigma_1 of the bristles [1/s].
        lugre_viscous: Viscous friction sigma_2 [1/s].
    """

    name: ClassVar[str] = "lugre"
    table: ClassVar[tuple[Quantity, ...]] = (
        Quantity("lugre_stiffness", "σ₀", "1/s^2", "stiffness of the bristles", 0.0, is_share=True),
        Quantity("lugre_friction", "F_c", "N/kg", "friction of fast motion", 0.0),
        Quantity("lugre_static", "F_s", "N/kg", "friction at rest", 0.0),
        Quantity("lugre_speed", "v_s", "m/s", "Stribeck's speed", 0.0),
        Quantity("lugre_bristle_damping", "σ₁", "1/s", "damping of the bristles", 0.0),
        Quantity("lugre_viscous", "σ₂", "1/s", "viscous friction", 0.0),
    )
    stepped: ClassVar[bool] = False

    lugre_stiffness: Scalar
    lugre_friction: Scalar
    lugre_static: Scalar
    lugre_speed: Scalar
    lugre_bristle_damping: Scalar = 0.0
    lugre_viscous: Scalar = 0.0

    def stiffness(self) -> Scalar:
        """Return the bristle stiffness sigma_0 [1/s^2]."""
        return self.lugre_stiffness

    def at_rest(self) -> Scalar:
        """Return the internal state at rest: no deflection of the bristles."""
        return 0.0

    def rate(self, y: Scalar, v: Scalar, memory: Scalar) -> Scalar:
        """Return the time derivative of the bristles' deflection [m/s]."""
        falls = self.lugre_static - self.lugre_friction
        limit = self.lugre_friction + falls * jnp.exp(-((v / self.lugre_speed) ** 2))
        return v - self.lugre_stiffness * jnp.abs(v) / limit * memory

    def force(self, y: Scalar, v: Scalar, memory: Scalar) -> Scalar:
        """Return the friction force F [N/kg]."""
        bristles = self.lugre_bristle_damping * self.rate(y, v, memory)
        return self.lugre_stiffness * memory + bristles + self.lugre_viscous * v

    def move(self, y: Scalar, memory: Scalar, dy: Scalar) -> NoReturn:
        """Raise an error, because the force depends on time and not on the path alone."""
        raise ModelError(
            "The law `lugre` depends on the rate of motion and has no loop or backbone.",
            remedy="Simulate the law, or use `Valanis.dahl` if the rate does not matter.",
        )

    def check_periodic(self) -> None:
        """Raise an error, because periodic motion with this law is not supported."""
        self.move(0.0, 0.0, 0.0)
