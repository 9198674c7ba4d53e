r"""Damper laws: forces $g(v)$ of the velocity alone, in parallel with other laws.

The rate of such a force depends on the acceleration; its harmonics and losses depend on the
frequency.
"""

from jbw.oscillator.law import Law
from jbw.oscillator.parameters import Scalar


class Damper(Law):
    """The base class of laws whose force g(v) depends on the velocity alone."""

    def __call__(self, v: Scalar) -> Scalar:
        """Return the force at the velocity v [N/kg]."""
        raise NotImplementedError

    def stiffness(self) -> Scalar:
        """Return zero, because a damper has no stiffness [1/s^2]."""
        return 0.0

    def force(self, y: Scalar, v: Scalar, memory: tuple[()]) -> Scalar:
        """Return the force at the velocity v [N/kg]."""
        return self(v)

    def remainder(
        self, h: Scalar, y: Scalar, v: Scalar, memory: tuple[()], branch: tuple[()]
    ) -> tuple[Scalar, Scalar]:
        """Return the force g(v), and zero as its rate: the step adds dg/dv times acceleration."""
        return self(v), 0.0 * v
