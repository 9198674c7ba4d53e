r"""The protocol of a force $g(v)$ of the velocity, in parallel with rate-independent laws.

The rate of such a force needs the acceleration, its harmonics and its losses the frequency. What
a `Law` says of slow motion (`move`, `harmonics`, `loop`) is therefore that nothing is felt.
"""

import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

from jbw.oscillator.kinks import Ends
from jbw.oscillator.law import Law, Loop
from jbw.oscillator.parameters import Scalar


class Damper(Law):
    """An odd force of v; a subclass defines `__call__`, `drag`, `harmonics_at` and `loop_at`."""

    def __call__(self, v: Scalar) -> Scalar:
        """Force at the velocity v [N/kg]."""
        raise NotImplementedError

    def drag(self, v: Scalar) -> Scalar:
        """Slope dg/dv [1/s]."""
        raise NotImplementedError

    def harmonics_at(
        self, omega: Scalar, q: Complex[Array, " harmonic"], max_turns: int
    ) -> Complex[Array, " harmonic"]:
        """Odd harmonics of the force along the motion of frequency omega."""
        raise NotImplementedError

    def loop_at(self, y_peak: Scalar, omega: Scalar) -> Loop:
        """Equivalent stiffness, which is none, and damping at amplitude Y and frequency omega."""
        raise NotImplementedError

    def reversal(self, h: Scalar, ends: Ends, quartic: Scalar) -> tuple[Scalar, Scalar]:
        """Impulses on v over h and on y over h^2 of a kink at v = 0, as of `Law.turn`."""
        return 0.0, 0.0

    # -- in slow motion ----------------------------------------------------------------------------
    def stiffness(self) -> Scalar:
        """Zero [1/s^2]."""
        return 0.0

    def force(self, y: Scalar, v: Scalar, memory: tuple[()]) -> Scalar:
        """Force at the velocity v [N/kg]."""
        return self(v)

    def loop(self, y_peak: Scalar) -> Loop:
        """Zero: the losses at amplitude Y depend on the frequency, see `loop_at`."""
        none = 0.0 * jnp.asarray(y_peak, float)
        return Loop(none, none)

    def harmonics(
        self, q: Complex[Array, " harmonic"], max_turns: int
    ) -> Complex[Array, " harmonic"]:
        """Zero: the harmonics depend on the frequency, see `harmonics_at`."""
        return jnp.zeros_like(q)

    def force_over_period(
        self, q: Complex[Array, " harmonic"], theta: Float[Array, " time"], max_turns: int
    ) -> Float[Array, " time"]:
        """Zero: slow motion feels no damper."""
        return jnp.zeros_like(theta)

    # -- through a time step -----------------------------------------------------------------------
    def remainder(
        self, h: Scalar, y: Scalar, v: Scalar, memory: tuple[()], branch: tuple[()]
    ) -> tuple[Scalar, Scalar]:
        """The force; its rate is dg/dv times the acceleration, which the step knows."""
        return self(v), 0.0 * v

    def turn(
        self, y: Scalar, memory: tuple[()], ends: Ends, quartic: Scalar
    ) -> tuple[tuple[()], Scalar, Scalar]:
        """No impulses from the path; see `reversal`."""
        return (), 0.0, 0.0
