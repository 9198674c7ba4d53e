"""The forces of joints in the rig, integrated in small steps from rates and sliders.

Nothing here is shared with the laws of the identification. Each force is one class with its
stiffness at rest, its internal state, the rate of that state, the correction of the state after a
small step, and the force. `jbw.rig.law_forces` relates forces to laws.
"""

from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

MILLIMETRE = 1e-3  # displacement at which a power law is stated [m]

Scalar = Float[Array, ""] | float
Kept = Any  # internal state: a number or an array that is integrated over time


class Force(eqx.Module):
    """The force of one element of a joint per unit modal mass; here without an internal state."""

    @property
    def stiffness(self) -> Scalar:
        """The stiffness at rest [1/s^2]."""
        return 0.0

    def at_rest(self) -> Kept:
        """Return the internal state of the force before any motion."""
        return ()

    def rate(self, v: Scalar, z: Kept) -> Kept:
        """Return the rate of the internal state."""
        return ()

    def settle(self, before: Kept, dy: Scalar, after: Kept) -> Kept:
        """Correct the integrated internal state after a small step dy of displacement."""
        return after

    @abstractmethod
    def exerted(self, y: Scalar, v: Scalar, z: Kept) -> Scalar:
        """Return the force per unit modal mass [N/kg]."""


class BoucWenForce(Force):
    """The Bouc-Wen force of Eq. (2) at nu = 1, whose force Z [N/kg] is integrated in time."""

    alpha: Scalar
    delta: Scalar
    gamma: Scalar

    @property
    def stiffness(self) -> Scalar:
        """The stiffness of the fully stuck joint [1/s^2]."""
        return self.alpha

    def at_rest(self) -> Kept:
        """Return zero force as the initial state."""
        return 0.0

    def rate(self, v: Scalar, z: Kept) -> Kept:
        """Return the rate of Z [N/kg/s]."""
        return self.alpha * v - self.gamma * abs(v) * z - self.delta * v * abs(z)

    def exerted(self, y: Scalar, v: Scalar, z: Kept) -> Scalar:
        """Return the hysteretic force Z [N/kg]."""
        return z


class BoucWenNuForce(Force):
    """The Bouc-Wen force of Eq. (2) with any nu, from its spring's stretch w = Z / alpha [m]."""

    nu_stiffness: Scalar
    nu_softening: Scalar
    nu_opening: Scalar
    nu: Scalar

    @property
    def stiffness(self) -> Scalar:
        """The stiffness of the fully stuck joint [1/s^2]."""
        return self.nu_stiffness

    def at_rest(self) -> Kept:
        """Return an unstretched spring as the initial state."""
        return 0.0

    def rate(self, v: Scalar, z: Kept) -> Kept:
        """Return the rate at which the spring stretches, dw/dt [m/s]."""
        size = (abs(z) / MILLIMETRE) ** self.nu
        return v - self.nu_softening * v * size - self.nu_opening * abs(v) * jnp.sign(z) * size

    def exerted(self, y: Scalar, v: Scalar, z: Kept) -> Scalar:
        """Return the force alpha w."""
        return self.nu_stiffness * z


class WornForce(Force):
    r"""The Bouc-Wen force with degradation and pinching; w = z / z_y and an energy are integrated.

    $$h = 1 - \zeta_1 e^{-(w s - q w_u)^2/\zeta_2^2}, \qquad
      \dot w = \frac{h v}{\eta z_y} (1 - \nu |w|^n (\beta s\,\mathrm{sgn}(w) + 1 - \beta))$$
    """

    bwbn_stiffness: Scalar
    bwbn_yield: Scalar
    bwbn_n: Scalar
    bwbn_beta: Scalar
    bwbn_zeta_s: Scalar
    bwbn_p: Scalar
    bwbn_q: Scalar
    bwbn_psi: Scalar
    bwbn_delta_psi: Scalar
    bwbn_lambda: Scalar
    bwbn_delta_nu: Scalar = 0.0
    bwbn_delta_eta: Scalar = 0.0

    @property
    def stiffness(self) -> Scalar:
        """The stiffness before damage [1/s^2]."""
        return self.bwbn_stiffness

    def at_rest(self) -> Kept:
        """Return an unstretched, undamaged spring as the initial state."""
        return jnp.zeros(2)

    def rate(self, v: Scalar, z: Kept) -> Kept:
        """Return the rates of the spring's stretch w and of the energy that causes damage [1/s]."""
        w, energy = z
        s, nu = jnp.sign(v), 1.0 + self.bwbn_delta_nu * energy
        zeta_1 = self.bwbn_zeta_s * (1.0 - jnp.exp(-self.bwbn_p * energy))
        zeta_2 = (self.bwbn_psi + self.bwbn_delta_psi * energy) * (self.bwbn_lambda + zeta_1)
        centre = self.bwbn_q / nu ** (1.0 / self.bwbn_n)
        h = 1.0 - zeta_1 * jnp.exp(-((w * s - centre) ** 2) / zeta_2**2)
        both = self.bwbn_beta * s * jnp.sign(w) + (1.0 - self.bwbn_beta)
        moved = v / self.bwbn_yield
        slope = h / (1.0 + self.bwbn_delta_eta * energy) * (1.0 - nu * abs(w) ** self.bwbn_n * both)
        return jnp.stack([moved * slope, moved * w])

    def exerted(self, y: Scalar, v: Scalar, z: Kept) -> Scalar:
        """Return the force alpha z_y w."""
        return self.bwbn_stiffness * self.bwbn_yield * z[0]


class SliderForces(Force):
    """The force of parallel springs that slip at limits; it is updated at the end of each step."""

    springs: Float[Array, " slider"]  # stiffness of every slider [1/s^2]
    slips: Float[Array, " slider"]  # stretch at which each slider slips [m]

    @property
    def stiffness(self) -> Scalar:
        """The stiffness of all sliders while they are stuck [1/s^2]."""
        return jnp.sum(self.springs)

    def at_rest(self) -> Kept:
        """Return zero force in every slider as the initial state."""
        return 0.0 * self.springs

    def rate(self, v: Scalar, z: Kept) -> Kept:
        """Return zero rates, because `settle` updates the slider forces."""
        return 0.0 * z

    def settle(self, before: Kept, dy: Scalar, after: Kept) -> Kept:
        """Return the slider forces after a step by dy; exact unless the step reverses."""
        limits = self.springs * self.slips
        return jnp.clip(before + self.springs * dy, -limits, limits)

    def exerted(self, y: Scalar, v: Scalar, z: Kept) -> Scalar:
        """Return the sum of the slider forces."""
        return jnp.sum(z)


class LinearSpring(Force):
    """The force of a linear spring in parallel to the structure, of stiffness k [1/s^2]."""

    k: Scalar

    @property
    def stiffness(self) -> Scalar:
        """The stiffness k [1/s^2]."""
        return self.k

    def exerted(self, y: Scalar, v: Scalar, z: Kept) -> Scalar:
        """Return the force k y."""
        return self.k * y


class PowerSpring(Force):
    """The force c |y|^n sgn y of a spring with a power above one."""

    c: Scalar
    n: int = eqx.field(static=True)

    def exerted(self, y: Scalar, v: Scalar, z: Kept) -> Scalar:
        """Return the force c sgn(y) |y|^n."""
        return self.c * jnp.sign(y) * abs(y) ** self.n


class EvenSpring(Force):
    """The force c y^2, which has the same sign on both sides."""

    c: Scalar

    def exerted(self, y: Scalar, v: Scalar, z: Kept) -> Scalar:
        """Return the force c y^2."""
        return self.c * y * y


class Drag(Force):
    """The drag force c |v|^n sgn v with a power above one."""

    c: Scalar
    n: int = eqx.field(static=True)

    def exerted(self, y: Scalar, v: Scalar, z: Kept) -> Scalar:
        """Return the drag force c sgn(v) |v|^n."""
        return self.c * jnp.sign(v) * abs(v) ** self.n


class StopForce(Force):
    """The force of springs that are reached on both sides at a displacement `gap` [m]."""

    k: Scalar
    gap: Scalar

    def exerted(self, y: Scalar, v: Scalar, z: Kept) -> Scalar:
        """Return the stop's force, k times the displacement beyond the gap."""
        return self.k * (y - jnp.clip(y, -self.gap, self.gap))


class GapForce(Force):
    """The force of Eq. (2) at nu = 1 behind a gap; its state is the force Z and the position s."""

    gap_stiffness: Scalar
    gap_softening: Scalar
    gap_opening: Scalar
    gap: Scalar

    def at_rest(self) -> Kept:
        """Return the initial state: in the middle of the gap, with zero force."""
        return 0.0, 0.0

    def rate(self, v: Scalar, z: Kept) -> Kept:
        """Return zero rates, because `settle` updates the state."""
        return 0.0 * z[0], 0.0 * z[1]

    def settle(self, before: Kept, dy: Scalar, after: Kept) -> Kept:
        """Advance by the midpoint rule in contact; after a release, let the element move freely."""
        z, s = before

        def slope(force: Scalar) -> Scalar:
            lost = self.gap_softening * abs(force) + self.gap_opening * jnp.sign(dy) * force
            return self.gap_stiffness - lost

        held = (z != 0.0) | ((abs(s) >= self.gap) & (s * dy > 0.0))
        moved = z + dy * slope(z + 0.5 * dy * slope(z))
        released = held & (moved * s < 0.0)
        part = jnp.where(released, z / jnp.where(released, z - moved, 1.0), 1.0)
        free = jnp.where(released, (1.0 - part) * dy, jnp.where(held, 0.0, dy))
        place = jnp.clip(s + free, -self.gap, self.gap)
        beyond = jnp.where(held, 0.0, s + free - place)
        force = jnp.where(held & ~released, moved, self.gap_stiffness * beyond)
        return force, place

    def exerted(self, y: Scalar, v: Scalar, z: Kept) -> Scalar:
        """Return the force Z."""
        return z[0]
