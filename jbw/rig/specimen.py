"""The specimen on the rig: an oscillator whose joint the rig integrates by laws of its own.

Nothing here is shared with the solvers of the identification: the rig takes the numbers of a joint
and has its own code for each law that it knows. A law that it is to know is one class here and one
line in `FORCES`: its stiffness at rest, its memory, the force of a memory, the rate of what is
integrated of it, and what a small step leaves of it in the end.
"""

import operator
from collections.abc import Callable, Mapping
from itertools import accumulate
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jbw.errors import ModelError
from jbw.oscillator.oscillator import Joint

Scalar = Float[Array, ""] | float
Memory = Any  # a pytree of scalars


class BoucWenForce(NamedTuple):
    """Eq. (2) at nu = 1, integrated in time."""

    alpha: Scalar
    delta: Scalar
    gamma: Scalar

    @property
    def stiffness(self) -> Scalar:
        """Of the joint that sticks [1/s^2]."""
        return self.alpha

    def at_rest(self) -> Scalar:
        """No force."""
        return 0.0

    def of(self, memory: Scalar) -> Scalar:
        """Z itself [N/kg]."""
        return memory

    def rate(self, v: Scalar, memory: Scalar) -> Scalar:
        """Rate of Z [N/kg/s]."""
        z = memory
        return self.alpha * v - self.gamma * abs(v) * z - self.delta * v * abs(z)

    def settle(self, before: Scalar, dy: Scalar, after: Scalar) -> Scalar:
        """As it was integrated."""
        return after


class Sliders(NamedTuple):
    """Springs in parallel that each slip at a force of their own: nothing to integrate."""

    springs: tuple[Scalar, ...]  # stiffness of each [1/s^2]
    limits: tuple[Scalar, ...]  # force at which each slips [N/kg]

    @classmethod
    def build(cls, theta: Mapping[str, float]) -> "Sliders":
        """From stiffness_1, slip_1 [m], stiffness_2, slip_ratio_2 [-] to the slip before, ..."""
        springs = tuple(x for name, x in theta.items() if name.startswith("stiffness"))
        ratios = (x for name, x in theta.items() if name.startswith("slip"))  # the first one is m
        slips = tuple(accumulate(ratios, operator.mul))
        return cls(springs, tuple(k * y for k, y in zip(springs, slips, strict=True)))

    @property
    def stiffness(self) -> Scalar:
        """All of them stuck [1/s^2]."""
        return sum(self.springs)

    def at_rest(self) -> tuple[Scalar, ...]:
        """No force in any."""
        return tuple(0.0 for _ in self.springs)

    def of(self, memory: tuple[Scalar, ...]) -> Scalar:
        """Sum of their forces [N/kg]."""
        return sum(memory)

    def rate(self, v: Scalar, memory: tuple[Scalar, ...]) -> tuple[Scalar, ...]:
        """None: their forces follow from where the step ends."""
        return tuple(0.0 * z for z in memory)

    def settle(
        self, before: tuple[Scalar, ...], dy: Scalar, after: tuple[Scalar, ...]
    ) -> tuple[Scalar, ...]:
        """Exact while the step does not turn round."""
        return tuple(
            jnp.clip(z + k * dy, -limit, limit)
            for z, k, limit in zip(before, self.springs, self.limits, strict=True)
        )


Force = BoucWenForce | Sliders
# Law in a campaign, without the number of a family's member, to the rig's own.
FORCES: dict[str, Callable[[Mapping[str, float]], Force]] = {
    "bouc_wen": lambda theta: BoucWenForce(**theta),
    "jenkins": Sliders.build,
}


class Specimen(NamedTuple):
    """The oscillator and its joint, per unit modal mass.

    Attributes:
        omega_n: Natural frequency at small amplitude [rad/s].
        zeta: Viscous damping ratio [-].
        forces: What the joint exerts.
    """

    omega_n: Scalar
    zeta: Scalar
    forces: tuple[Force, ...]

    @property
    def k(self) -> Scalar:
        """Stiffness beside the joint [1/s^2]."""
        return self.omega_n**2 - sum(force.stiffness for force in self.forces)

    def at_rest(self) -> tuple[Memory, ...]:
        """Memories before any motion."""
        return tuple(force.at_rest() for force in self.forces)

    def joint_force(self, memory: tuple[Memory, ...]) -> Array:
        """Force of the joint beside the spring k [N/kg]."""
        return jnp.asarray(sum((f.of(m) for f, m in zip(self.forces, memory, strict=True)), 0.0))

    def rates(self, v: Scalar, memory: tuple[Memory, ...]) -> tuple[Memory, ...]:
        """Rates of the memories at a velocity."""
        return tuple(f.rate(v, m) for f, m in zip(self.forces, memory, strict=True))

    def settle(self, before: tuple, after: tuple) -> tuple:
        """State (y, ..., memories) after a small step, from that before it."""
        dy = after[0] - before[0]
        pairs = zip(self.forces, before[-1], after[-1], strict=True)
        return (*after[:-1], tuple(force.settle(was, dy, now) for force, was, now in pairs))


def specimen_of(joint: Joint | Specimen) -> Specimen:
    """The rig's own record of a joint, its numbers in double precision.

    Args:
        joint: A `BoucWen` with nu = 1, or an `Oscillator` with laws that the rig knows.

    Raises:
        ModelError: In float32, or for a law or a parameter that the rig does not know.
    """
    if isinstance(joint, Specimen):
        return joint
    if not jax.config.jax_enable_x64:
        raise ModelError(
            "The rig must be simulated in float64, but JAX works in float32.",
            remedy="Call jbw.enable_x64() before any array is made.",
        )
    if (restoring := getattr(joint, "restoring", None)) is not None:
        raise ModelError(
            "Parameter `joint.restoring` of the rig must be None, but is of kind "
            f"{type(restoring).__name__}.",
            why="The rig integrates the hysteretic force and a linear spring by a code of its own.",
            remedy="Make records with `simulate`, which takes every restoring force.",
        )
    forces = []
    for law in joint.laws:
        if (nu := getattr(law, "nu", 1.0)) != 1.0:
            raise ModelError(f"Parameter `joint.nu` of the rig must be 1, but is {nu}.")
        known = law.name.rstrip("_0123456789")
        if known not in FORCES:
            raise ModelError(
                f"The law `{law.name}` of the joint is none of the rig's: {', '.join(FORCES)}.",
                why="The rig integrates every law by a code of its own.",
                remedy="Make records with `simulate`, which takes every law.",
            )
        forces.append(FORCES[known]({name: float(x) for name, x in law.parameters().items()}))
    return Specimen(float(joint.omega_n), float(joint.zeta), tuple(forces))


def doubles(numbers: Any) -> Any:
    """A specimen, or any numbers, as arrays of double precision for compiled code."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), numbers)
