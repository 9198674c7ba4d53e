r"""A linear dashpot across a joint, $g(v) = c\,v$, for damping that couples modes.

No campaign names it: across the joint of a single mode it is part of that mode's damping ratio.
"""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Complex

from jbw.oscillator.damper import Damper
from jbw.oscillator.law import Loop
from jbw.oscillator.parameters import SLOW, Scalar
from jbw.oscillator.steady.waveform import orders
from jbw.quantities import Quantity


class Dashpot(Damper):
    r"""Linear damping $g(v) = c\,v$; c is negative if the modes' damping exceeds the joint's.

    Attributes:
        c: Coefficient [1/s; N s/m across a joint in physical units].
    """

    name: ClassVar[str] = "dashpot"
    table: ClassVar[tuple[Quantity, ...]] = (Quantity("c", "c", "1/s", "force over the velocity"),)

    c: Scalar

    def __call__(self, v: Scalar) -> Scalar:
        """Return the force at the velocity v [N/kg]."""
        return self.c * v

    def harmonics(
        self, q: Complex[Array, " harmonic"], max_turns: int, omega: Scalar = SLOW
    ) -> Complex[Array, " harmonic"]:
        r"""Return the harmonics of the viscous force, $\mathrm{i}n\omega c\,q_n$."""
        return self.c * jnp.asarray(1j * orders(q.shape[0])) * omega * q  # pyright: ignore[reportReturnType]

    def loop(self, y_peak: Scalar, omega: Scalar = SLOW) -> Loop:
        r"""Return the steady loop; its equivalent damping is $\mathrm{Im}\,\kappa = c\,\omega$."""
        damping = self.c * omega + 0.0 * jnp.asarray(y_peak)
        return Loop(jnp.zeros_like(damping), damping)  # pyright: ignore[reportArgumentType]
