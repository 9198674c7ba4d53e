r"""Nonlinear viscous dampers: the forces $c\,v|v|$ and $c\,v^3$ of the velocity."""

from collections.abc import Mapping
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient
from jaxtyping import Array, Complex

from jbw.oscillator.damper import Damper
from jbw.oscillator.kinks import Ends, StepPath, kink_impulse
from jbw.oscillator.law import Bounds, Loop, Scales
from jbw.oscillator.parameters import SLOW, Conversion, Material, Scalar, of_opensees
from jbw.oscillator.steady.waveform import (
    crest,
    exponentials,
    gauss_legendre,
    odd_harmonics,
    orders,
    synthesis,
)
from jbw.quantities import Quantity

# Largest added damping ratio at the largest displacement, which bounds the prior.
MOST_ADDED = 0.05
_NODES, _NODES_PER_HARMONIC = 24, 4
# number of samples of half a period, for motion with more than two turning points per period
_POINTS = 512


class QuadraticDamping(Damper):
    r"""Quadratic damping, as the drag of a flow, $g(v) = c\,v|v|$ [N/kg].

    Attributes:
        c: Coefficient [1/m].
    """

    name: ClassVar[str] = "quadratic_damping"
    table: ClassVar[tuple[Quantity, ...]] = (
        Quantity("quadratic_damping", "c_v", "1/m", "force over the square of the velocity", 0.0),
    )
    fields: ClassVar[Mapping[str, str]] = {"quadratic_damping": "c"}

    c: Scalar

    @classmethod
    def prior(cls, scales: Scales) -> Bounds:
        r"""Return prior bounds of c from the largest damping ratio of c, $4 c Y / (3\pi)$."""
        return {"quadratic_damping": (0.0, MOST_ADDED * 0.75 * np.pi / scales.y_peak)}

    def __call__(self, v: Scalar) -> Scalar:
        """Return the force at the velocity v [N/kg]."""
        return self.c * v * jnp.abs(v)

    def bend(
        self, h: Scalar, y: Scalar, v: Scalar, a: Scalar, memory: tuple[()], branch: tuple[()]
    ) -> Scalar:
        """Return h^2/2 times the second time derivative of the force, with the time step h.

        This is half of h^2 g'' a^2; the remaining term g' da/dt vanishes at a turning point.
        """
        return h**2 * self.c * jnp.sign(v) * a**2

    @property
    def kinked(self) -> bool:
        """Whether the law has kinks: yes, because g'' jumps at v = 0."""
        return True

    def turn(
        self, h: Scalar, y: Scalar, memory: tuple[()], ends: Ends, quartic: Scalar
    ) -> tuple[tuple[()], Scalar, Scalar]:
        r"""Return the effect of the jump of g'', $J_2 = 4 c\,a|a|$, $J_3 = 12 c\,|a|\dot a$."""
        path = StepPath.through(ends, quartic)
        size = jnp.where(path.turns, 4.0 * self.c / h**2 * jnp.abs(path.bend), 0.0)
        impulse = kink_impulse(1.0 - path.fraction, size * path.bend, 18.0 * size * path.cubic.c_3)
        return (), impulse.v, impulse.y

    def harmonics(
        self, q: Complex[Array, " harmonic"], max_turns: int, omega: Scalar = SLOW
    ) -> Complex[Array, " harmonic"]:
        """Return the odd harmonics of the force, by quadrature or on a uniform grid."""
        if max_turns > 2:
            theta = crest(stop_gradient(q)) + np.pi * (np.arange(_POINTS) + 0.5) / _POINTS
            weights = jnp.full(_POINTS, np.pi / _POINTS)
        else:
            start = crest(stop_gradient(q))
            num_nodes = _NODES + _NODES_PER_HARMONIC * q.shape[0]
            theta, weights = gauss_legendre(num_nodes, start, start + jnp.pi)
        force = self(omega * synthesis(q, theta, 1))
        return 2.0 / jnp.pi * ((weights * force) @ exponentials(theta, q.shape[0]).conj())

    def loop(self, y_peak: Scalar, omega: Scalar = SLOW) -> Loop:
        r"""Return the equivalent damping, $\mathrm{Im}\,\kappa = 8 c Y \omega^2 / (3\pi)$."""
        damping = 8.0 / (3.0 * jnp.pi) * self.c * jnp.asarray(y_peak) * omega**2
        return Loop(jnp.zeros_like(damping), damping)  # pyright: ignore[reportArgumentType]

    def convert(self, omega_n: float, zeta: float, mass: float) -> dict[str, Conversion]:
        """Return this damper as an OpenSees dashpot with velocity to the power 2."""
        return of_opensees(Material("Viscous", (mass * self.c, 2.0)))


class CubicDamping(Damper):
    r"""Cubic damping, $g(v) = c\,v^3$ [N/kg].

    Attributes:
        c: Coefficient [s/m^2].
    """

    name: ClassVar[str] = "cubic_damping"
    table: ClassVar[tuple[Quantity, ...]] = (
        Quantity("cubic_damping", "c_v3", "s/m^2", "force over the cube of the velocity", 0.0),
    )
    fields: ClassVar[Mapping[str, str]] = {"cubic_damping": "c"}

    c: Scalar

    @classmethod
    def prior(cls, scales: Scales) -> Bounds:
        r"""Return prior bounds of c from the largest ratio that c adds, $3 c Y^2 \omega_n / 8$."""
        return {"cubic_damping": (0.0, MOST_ADDED * 8 / 3 / (scales.y_peak**2 * scales.omega_n))}

    def __call__(self, v: Scalar) -> Scalar:
        """Return the force at the velocity v [N/kg]."""
        return self.c * v**3

    def harmonics(
        self, q: Complex[Array, " harmonic"], max_turns: int, omega: Scalar = SLOW
    ) -> Complex[Array, " harmonic"]:
        """Return the exact odd harmonics of the cubic damping force."""
        return odd_harmonics(self, jnp.asarray(1j * orders(q.shape[0])) * omega * q)

    def loop(self, y_peak: Scalar, omega: Scalar = SLOW) -> Loop:
        r"""Return the equivalent damping, $\mathrm{Im}\,\kappa = 3 c Y^2 \omega^3 / 4$."""
        damping = 0.75 * self.c * jnp.asarray(y_peak) ** 2 * omega**3
        return Loop(jnp.zeros_like(damping), damping)  # pyright: ignore[reportArgumentType]

    def convert(self, omega_n: float, zeta: float, mass: float) -> dict[str, Conversion]:
        """Return this damper as an OpenSees dashpot with velocity to the power 3."""
        return of_opensees(Material("Viscous", (mass * self.c, 3.0)))
