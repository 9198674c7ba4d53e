r"""Forces $g(v)$ of the velocity alone, in parallel with other laws.

The rate of such a force needs the acceleration, its harmonics and its losses the frequency.
"""

from jbw.oscillator.law import Law
from jbw.oscillator.parameters import Scalar


class Damper(Law):
    """The base of laws that are a function of the velocity, which may be called with it."""

    def __call__(self, v: Scalar) -> Scalar:
        """Return the force at the velocity v [N/kg]."""
        raise NotImplementedError

    def stiffness(self) -> Scalar:
        """Return zero [1/s^2]."""
        return 0.0

    def force(self, y: Scalar, v: Scalar, memory: tuple[()]) -> Scalar:
        """Return the force at the velocity v [N/kg]."""
        return self(v)

    def remainder(
        self, h: Scalar, y: Scalar, v: Scalar, memory: tuple[()], branch: tuple[()]
    ) -> tuple[Scalar, Scalar]:
        """Return the force; its rate is dg/dv times the acceleration, which the step knows."""
        return self(v), 0.0 * v
