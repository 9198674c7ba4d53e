"""The forces of joints as the rig knows them: by their rates and their sliders, small step by step.

Nothing here is shared with the laws of the identification. A law that the rig is to know is one
line in `FORCES`, and a class where no other has its form: the stiffness at rest, what is kept of
the past, the rate of what is integrated, what a small step leaves of it in the end, and the force.
"""

from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jbw.errors import ModelError
from jbw.oscillator.law import Law

MILLIMETRE = 1e-3  # at which a power is stated [m]
BINS = 300  # of a continuous density of sliders, in the ratio of 1.055 of their slips
DECADES = 7  # of displacement that they span
FARTHEST = 0.1  # slip of the last slider of a density that has none [m]

Scalar = Float[Array, ""] | float
Kept = Any  # of the past: a number or an array, integrated


class Force(eqx.Module):
    """What one element of a joint exerts, per unit modal mass; by itself it keeps nothing."""

    @property
    def stiffness(self) -> Scalar:
        """At rest [1/s^2]."""
        return 0.0

    def at_rest(self) -> Kept:
        """What is kept of the past before any motion."""
        return ()

    def rate(self, v: Scalar, z: Kept) -> Kept:
        """Rate of what is kept."""
        return ()

    def settle(self, before: Kept, dy: Scalar, after: Kept) -> Kept:
        """What is kept after a small step by dy, from before it and as it was integrated."""
        return after

    @abstractmethod
    def exerted(self, y: Scalar, v: Scalar, z: Kept) -> Scalar:
        """Force [N/kg]."""


class BoucWenForce(Force):
    """Eq. (2) at nu = 1: its force Z [N/kg] is integrated in time."""

    alpha: Scalar
    delta: Scalar
    gamma: Scalar

    @property
    def stiffness(self) -> Scalar:
        """Of the joint that sticks."""
        return self.alpha

    def at_rest(self) -> Kept:
        """No force."""
        return 0.0

    def rate(self, v: Scalar, z: Kept) -> Kept:
        """Rate of Z [N/kg/s]."""
        return self.alpha * v - self.gamma * abs(v) * z - self.delta * v * abs(z)

    def exerted(self, y: Scalar, v: Scalar, z: Kept) -> Scalar:
        """Z."""
        return z


class BoucWenNuForce(Force):
    """Eq. (2) with nu free: the stretch w = Z / alpha [m] is integrated in time."""

    nu_stiffness: Scalar
    nu_softening: Scalar
    nu_opening: Scalar
    nu: Scalar

    @property
    def stiffness(self) -> Scalar:
        """Of the joint that sticks."""
        return self.nu_stiffness

    def at_rest(self) -> Kept:
        """No stretch."""
        return 0.0

    def rate(self, v: Scalar, z: Kept) -> Kept:
        """Rate of w [m/s]."""
        size = (abs(z) / MILLIMETRE) ** self.nu
        return v - self.nu_softening * v * size - self.nu_opening * abs(v) * jnp.sign(z) * size

    def exerted(self, y: Scalar, v: Scalar, z: Kept) -> Scalar:
        """Alpha w."""
        return self.nu_stiffness * z


class Sliders(Force):
    """Springs side by side, each slipping at a limit: where a step ends tells their forces."""

    springs: Float[Array, " slider"]  # [1/s^2]
    slips: Float[Array, " slider"]  # stretch at which each slips [m]

    @property
    def stiffness(self) -> Scalar:
        """Of all while they stick."""
        return jnp.sum(self.springs)

    def at_rest(self) -> Kept:
        """No force in any."""
        return 0.0 * self.springs

    def rate(self, v: Scalar, z: Kept) -> Kept:
        """Nothing to integrate."""
        return 0.0 * z

    def settle(self, before: Kept, dy: Scalar, after: Kept) -> Kept:
        """Exact while the step does not turn round."""
        limits = self.springs * self.slips
        return jnp.clip(before + self.springs * dy, -limits, limits)

    def exerted(self, y: Scalar, v: Scalar, z: Kept) -> Scalar:
        """Sum over the sliders."""
        return jnp.sum(z)


class Spring(Force):
    """Stiffness k beside that of the structure [1/s^2]."""

    k: Scalar

    @property
    def stiffness(self) -> Scalar:
        """K."""
        return self.k

    def exerted(self, y: Scalar, v: Scalar, z: Kept) -> Scalar:
        """K y."""
        return self.k * y


class PowerSpring(Force):
    """Force c |y|^n sgn y of a power above one."""

    c: Scalar
    n: int = eqx.field(static=True)

    def exerted(self, y: Scalar, v: Scalar, z: Kept) -> Scalar:
        """By the power."""
        return self.c * jnp.sign(y) * abs(y) ** self.n


class Drag(Force):
    """Force c |v|^n sgn v of a power above one."""

    c: Scalar
    n: int = eqx.field(static=True)

    def exerted(self, y: Scalar, v: Scalar, z: Kept) -> Scalar:
        """By the power."""
        return self.c * jnp.sign(v) * abs(v) ** self.n


class StopForce(Force):
    """Spring that is met on both sides, at a displacement `gap` [m]."""

    k: Scalar
    gap: Scalar

    def exerted(self, y: Scalar, v: Scalar, z: Kept) -> Scalar:
        """Beyond the gap."""
        return self.k * (y - jnp.clip(y, -self.gap, self.gap))


def jenkins(theta: Mapping[str, Scalar]) -> list[Force]:
    """From stiffness_1, slip_1 [m], stiffness_2, slip_ratio_2 [-] to the slip before, ..."""
    springs = [x for name, x in theta.items() if name.startswith("stiffness")]
    ratios = (x for name, x in theta.items() if name.startswith("slip"))  # the first one is m
    return [Sliders(_row(springs), jnp.cumprod(_row(ratios)))]


def _row(numbers: Iterable[Scalar]) -> Array:
    return jnp.stack([jnp.asarray(x) for x in numbers])


def _slips(last: Scalar) -> Array:
    """Slips that part a density of sliders into bins, from zero to the last one."""
    return last * jnp.append(0.0, jnp.logspace(-DECADES, 0.0, BINS))


def _binned(weight: Array, moment: Array) -> Sliders:
    """A slider for each bin at its centroid, by integrals of the density and of its moment."""
    springs = jnp.diff(weight)
    return Sliders(springs, jnp.diff(moment) / springs)


def _power_density(r: Scalar, chi: Scalar, last: Scalar) -> Sliders:
    r"""Sliders of the density $R \varphi^\chi$ to the last slip."""
    x = _slips(last)
    return _binned(r * x ** (chi + 1) / (chi + 1), r * x ** (chi + 2) / (chi + 2))


def iwan4(theta: Mapping[str, Scalar]) -> list[Force]:
    """Segalman's density of sliders, and those at its end that slip together."""
    chi, spread = theta["iwan_chi"], theta["iwan_stiffness"] / (1 + theta["iwan_beta"])
    r = theta["iwan_loss"] * (chi + 1) * (chi + 2) / MILLIMETRE ** (chi + 1)
    last = (spread * (chi + 1) / r) ** (1 / (chi + 1))
    together = Sliders(_row([theta["iwan_beta"] * spread]), _row([last]))
    return [_power_density(r, chi, last), together]


def masing_power(theta: Mapping[str, Scalar]) -> list[Force]:
    """Sliders of a power density, without the stiffness that they have at rest."""
    q = theta["power_exponent"]
    r = theta["power_loss"] * q * (q + 1) / MILLIMETRE**q
    sliders = _power_density(r, q - 1, FARTHEST)
    return [sliders, Spring(-sliders.stiffness)]


def masing_exponential(theta: Mapping[str, Scalar]) -> list[Force]:
    r"""Sliders of the density $\alpha b\,e^{-b\varphi}$."""
    alpha, b = theta["exponential_alpha"], theta["exponential_b"]
    x = _slips(40.0 / b)  # beyond which are 4e-18 of them
    passed = jnp.exp(-b * x)
    return [_binned(-alpha * passed, -alpha * passed * (x + 1 / b))]


# Law in a campaign, without the number of a family's member, to the rig's own, side by side.
FORCES: dict[str, Callable[[Mapping[str, Scalar]], Sequence[Force]]] = {
    "bouc_wen": lambda theta: [BoucWenForce(**theta)],
    "bouc_wen_nu": lambda theta: [BoucWenNuForce(**theta)],
    "cubic": lambda theta: [PowerSpring(theta["cubic"], 3)],
    "cubic_damping": lambda theta: [Drag(theta["cubic_damping"], 3)],
    "iwan": iwan4,
    "jenkins": jenkins,
    "masing_exponential": masing_exponential,
    "masing_power": masing_power,
    "quadratic": lambda theta: [PowerSpring(theta["quadratic"], 2)],
    "quadratic_damping": lambda theta: [Drag(theta["quadratic_damping"], 2)],
    "quintic": lambda theta: [PowerSpring(theta["quintic"], 5)],
    "stop": lambda theta: [StopForce(theta["stop_stiffness"], theta["stop_gap"])],
}


def forces_of(laws: Iterable[Law], number: Callable[[Any], Scalar] = float) -> tuple[Force, ...]:
    """The rig's own forces of laws, every parameter made a number by `number`."""
    forces: list[Force] = []
    for law in laws:
        if law.name == "bouc_wen" and (nu := getattr(law, "nu", 1.0)) != 1.0:
            raise ModelError(
                f"Parameter `joint.nu` of the rig must be 1, but is {nu}.",
                remedy="The law `bouc_wen_nu` takes any: BoucWenNu.of_bouc_wen(...).",
            )
        known = law.name.rstrip("_0123456789")
        if known not in FORCES:
            raise ModelError(
                f"The law `{law.name}` of the joint is none of the rig's: {', '.join(FORCES)}.",
                why="The rig integrates every law by a code of its own.",
                remedy="Make records with `simulate`, which takes every law.",
            )
        forces += FORCES[known]({name: number(x) for name, x in law.parameters().items()})
    return tuple(forces)
