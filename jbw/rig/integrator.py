"""The specimen, its joint by laws of the rig's own, answers an analog force.

Nothing here is shared with the solvers of the identification: the rig takes the numbers of a joint
and has its own code for each law that it knows. A law that it is to know is one class here and one
line in `FORCES`: its stiffness at rest, the rate of its force where that is integrated, and what a
small step leaves of the force in the end.

It is integrated far finer than it is sampled: classical Runge-Kutta steps, sixteen to a sample,
under the force as it is between the samples, not under any hold of the samples. With the paper's
joint the velocity of a sweep is right to 2e-7 of its rms, at most 0.02 um/s in the laboratory's:
300 times below what 48 averaged repeats of a laser with 50 um/s can resolve.
"""

import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import accumulate
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float
from numpy.typing import NDArray

from jbw.errors import ModelError
from jbw.oscillator.law import Law
from jbw.oscillator.oscillator import Joint

SUBSTEPS = 16  # Runge-Kutta steps in a sample
GRID = 2 * SUBSTEPS  # values of the force in a sample: at the ends and in the middle of each step
# Samples in one compiled call: bounds the memory of the force, keeps one compilation for all.
BLOCK = 16_384

Scalar = Float[Array, ""] | float
Parts = tuple[Scalar, ...]  # of the joint's force: what each of the rig's forces exerts [N/kg]
State = Any  # a tuple that begins with the displacement and ends with the parts


class BoucWenForce(NamedTuple):
    """Eq. (2) at nu = 1: its force Z [N/kg] is integrated in time."""

    alpha: Scalar
    delta: Scalar
    gamma: Scalar

    @property
    def stiffness(self) -> Scalar:
        """Of the joint that sticks [1/s^2]."""
        return self.alpha

    def rate(self, v: Scalar, z: Scalar) -> Scalar:
        """Rate of Z [N/kg/s]."""
        return self.alpha * v - self.gamma * abs(v) * z - self.delta * v * abs(z)

    def settle(self, before: Scalar, dy: Scalar, after: Scalar) -> Scalar:
        """As it was integrated."""
        return after


class Slider(NamedTuple):
    """A spring that slips at a limit: its force follows from where a step ends."""

    stiffness: Scalar  # [1/s^2]
    limit: Scalar  # force at which it slips [N/kg]

    def rate(self, v: Scalar, z: Scalar) -> Scalar:
        """Nothing to integrate."""
        return 0.0 * z

    def settle(self, before: Scalar, dy: Scalar, after: Scalar) -> Scalar:
        """Exact while the step does not turn round."""
        return jnp.clip(before + self.stiffness * dy, -self.limit, self.limit)


def sliders(theta: Mapping[str, Scalar]) -> list[Slider]:
    """From stiffness_1, slip_1 [m], stiffness_2, slip_ratio_2 [-] to the slip before, ..."""
    springs = [x for name, x in theta.items() if name.startswith("stiffness")]
    ratios = (x for name, x in theta.items() if name.startswith("slip"))  # the first one is m
    slips = tuple(accumulate(ratios, operator.mul))
    return [Slider(k, k * y) for k, y in zip(springs, slips, strict=True)]


Force = BoucWenForce | Slider
# Law in a campaign, without the number of a family's member, to the rig's own, side by side.
FORCES: dict[str, Callable[[Mapping[str, Scalar]], Sequence[Force]]] = {
    "bouc_wen": lambda theta: [BoucWenForce(**theta)],
    "jenkins": sliders,
}


class Specimen(NamedTuple):
    """The oscillator and its joint, per unit modal mass."""

    omega_n: Scalar  # natural frequency at small amplitude [rad/s]
    zeta: Scalar  # viscous damping ratio [-]
    forces: tuple[Force, ...]  # what the joint exerts

    @property
    def k(self) -> Scalar:
        """Stiffness beside the joint [1/s^2]."""
        return self.omega_n**2 - sum(force.stiffness for force in self.forces)

    def at_rest(self) -> Parts:
        """Parts of the force before any motion."""
        return (0.0,) * len(self.forces)

    def joint_force(self, parts: Parts) -> Array:
        """Force of the joint beside the spring k [N/kg]."""
        return jnp.asarray(sum(parts, 0.0))

    def rates(self, v: Scalar, parts: Parts) -> Parts:
        """Rates of the parts at a velocity."""
        return tuple(force.rate(v, z) for force, z in zip(self.forces, parts, strict=True))

    def state_rate(self, state: State, u: Scalar) -> State:
        """Rate of the state (y, v, parts) under a force per unit mass u [N/kg]."""
        y, v, parts = state
        a = u - 2 * self.zeta * self.omega_n * v - self.k * y
        return v, a - self.joint_force(parts), self.rates(v, parts)

    def settle(self, before: State, after: State) -> State:
        """State (y, ..., parts) after a small step, from that before it."""
        dy = after[0] - before[0]
        pairs = zip(self.forces, before[-1], after[-1], strict=True)
        return (*after[:-1], tuple(force.settle(was, dy, now) for force, was, now in pairs))


def specimen_of(joint: Joint | Specimen) -> Specimen:
    """The rig's own record of a joint, its numbers in double precision."""
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
    return Specimen(float(joint.omega_n), float(joint.zeta), forces_of(joint.laws))


def forces_of(laws: Iterable[Law], number: Callable[[Any], Scalar] = float) -> tuple[Force, ...]:
    """The rig's own forces of laws, every parameter made a number by `number`."""
    forces: list[Force] = []
    for law in laws:
        if (nu := getattr(law, "nu", 1.0)) != 1.0:
            raise ModelError(f"Parameter `joint.nu` of the rig must be 1, but is {nu}.")
        known = law.name.rstrip("_0123456789")
        if known not in FORCES:
            raise ModelError(
                f"The law `{law.name}` of the joint is none of the rig's: {', '.join(FORCES)}.",
                why="The rig integrates every law by a code of its own.",
                remedy="Make records with `simulate`, which takes every law.",
            )
        forces += FORCES[known]({name: number(x) for name, x in law.parameters().items()})
    return tuple(forces)


def doubles(numbers: Any) -> Any:
    """A specimen, or any numbers, as arrays of double precision for compiled code."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), numbers)


def runge_kutta(
    rate: Callable[[State, Array], State],
    settle: Callable[[State, State], State],
    now: State,
    inputs: tuple[Array, Array, Array],
    h: Scalar,
) -> State:
    """One classical Runge-Kutta step of h seconds; inputs at its beginning, middle and end."""
    # `settle` puts right what is not integrated of a state after a small step from `now`.

    def moved(length: Scalar, slope: State) -> State:
        return settle(now, jax.tree.map(lambda x, s: x + length * s, now, slope))

    k_1 = rate(now, inputs[0])
    k_2 = rate(moved(h / 2, k_1), inputs[1])
    k_3 = rate(moved(h / 2, k_2), inputs[1])
    k_4 = rate(moved(h, k_3), inputs[2])
    after = jax.tree.map(
        lambda x, a, b, c, d: x + h / 6 * (a + 2 * b + 2 * c + d), now, k_1, k_2, k_3, k_4
    )
    return settle(now, after)


def respond(
    joint: Joint | Specimen,
    force: Callable[[int, int], NDArray[np.float64]],
    num_samples: int,
    fs: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Displacement [m], velocity [m/s] and joint force beside the spring k [N/kg], from rest."""
    # `force(i, j)` is the analog force per unit mass at points i .. j - 1, `GRID` a sample [N/kg].
    specimen = doubles(specimen_of(joint))
    state: State = doubles((0.0, 0.0, specimen.at_rest()))
    saved = []
    for first in range(0, num_samples, BLOCK):
        u = force(first * GRID, (first + BLOCK) * GRID + 1)
        state, block = _advance(specimen, state, u, 1.0 / (fs * SUBSTEPS))
        saved.append(np.stack(block))
    y, v, z = np.concatenate(saved, axis=1)[:, :num_samples]
    if not np.isfinite(v).all():
        raise ModelError(
            f"The response of `joint` must stay finite, but it is not from sample "
            f"{int(np.argmin(np.isfinite(v)))} on.",
            remedy="Check the joint's parameters, the gain and the sampling frequency.",
        )
    return y, v, z


@jax.jit
def _advance(
    specimen: Specimen, state: State, u: Float[Array, " grid"], h: float
) -> tuple[State, tuple[Array, Array, Array]]:
    """Runs one block; returns its final state, and motion and force at the start of each sample."""

    def substep(i: Array, carry: tuple[Array, State]) -> tuple[Array, State]:
        start, now = carry
        at = start + 2 * i
        inputs = (u[at], u[at + 1], u[at + 2])
        return start, runge_kutta(specimen.state_rate, specimen.settle, now, inputs, h)

    def sample(now: State, n: Array) -> tuple[State, tuple[Array, Array, Array]]:
        _, after = lax.fori_loop(0, SUBSTEPS, substep, (GRID * n, now))
        y, v, parts = now
        return after, (y, v, specimen.joint_force(parts))

    return lax.scan(sample, state, jnp.arange(u.shape[0] // GRID))
