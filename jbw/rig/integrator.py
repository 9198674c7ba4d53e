"""The specimen: an oscillator with a joint, whose response to an analog force is integrated.

Nothing here is shared with the solvers of the identification: the rig takes the numbers of a joint
and has its own code for each law (`jbw.rig.law_forces`).

The time step is much finer than the sampling: sixteen classical Runge-Kutta steps per sample, under
the true force between the samples and not under a hold of the samples. With the joint of Teloli et
al. the velocity of a sweep is accurate to 2e-7 of its rms, at most 0.02 um/s in the laboratory's:
300 times below the resolution of 48 averaged repeats of a laser with 50 um/s.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float
from numpy.typing import NDArray

from jbw.errors import ModelError
from jbw.oscillator.oscillator import Joint
from jbw.rig.forces import Force, Scalar
from jbw.rig.law_forces import forces_of

SUBSTEPS = 16  # number of Runge-Kutta steps per sample
GRID = 2 * SUBSTEPS  # number of force values per sample: at the ends and in the middle of each step
# Number of samples per compiled call. It limits the memory of the force, and one compilation is
# enough.
BLOCK = 16_384

Parts = tuple[Any, ...]  # internal states of the rig's forces, which form the joint's memory
State = Any  # a tuple (y, ..., v, internal states of the forces)
Seen = tuple[Array, ...]


class Specimen(NamedTuple):
    """The oscillator and its joint, per unit modal mass."""

    omega_n: Scalar  # natural frequency at small amplitude [rad/s]
    zeta: Scalar  # viscous damping ratio [-]
    forces: tuple[Force, ...]  # forces of the joint

    @property
    def k(self) -> Scalar:
        """The stiffness in parallel to the joint [1/s^2]."""
        return self.omega_n**2 - sum(force.stiffness for force in self.forces)

    def at_rest(self) -> Parts:
        """Return the internal states of the forces before any motion."""
        return tuple(force.at_rest() for force in self.forces)

    def joint_force(self, y: Scalar, v: Scalar, parts: Parts) -> Array:
        """Return the force of the joint without the spring k [N/kg]."""
        pairs = zip(self.forces, parts, strict=True)
        return jnp.asarray(sum((force.exerted(y, v, z) for force, z in pairs), 0.0))

    def rates(self, v: Scalar, parts: Parts) -> Parts:
        """Return the time derivatives of the forces' internal states at a velocity v."""
        return tuple(force.rate(v, z) for force, z in zip(self.forces, parts, strict=True))

    def state_rate(self, state: State, u: Scalar) -> State:
        """Return the time derivative of the state under a force per unit mass u [N/kg]."""
        y, v, parts = state
        a = u - 2 * self.zeta * self.omega_n * v - self.k * y
        return v, a - self.joint_force(y, v, parts), self.rates(v, parts)

    def settle(self, before: State, after: State) -> State:
        """Return the state after a small step, with the forces' internal states corrected."""
        dy = after[0] - before[0]
        pairs = zip(self.forces, before[-1], after[-1], strict=True)
        return (*after[:-1], tuple(force.settle(was, dy, now) for force, was, now in pairs))


def specimen_of(joint: Joint | Specimen) -> Specimen:
    """Return the rig's specimen of a joint, with numbers in double precision."""
    if isinstance(joint, Specimen):
        return joint
    require_double()
    return Specimen(float(joint.omega_n), float(joint.zeta), forces_of(joint.laws))


def require_double() -> None:
    """Raise a ModelError if JAX works in float32."""
    if not jax.config.jax_enable_x64:
        raise ModelError(
            "The rig must be simulated in float64, but JAX works in float32.",
            remedy="Call jbw.enable_x64() before any array is made.",
        )


def doubles(numbers: Any) -> Any:
    """Return a specimen, or any numbers, as arrays of double precision for compiled code."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), numbers)


def runge_kutta(
    rate: Callable[[State, Array], State],
    settle: Callable[[State, State], State],
    now: State,
    inputs: tuple[Array, Array, Array],
    h: Scalar,
) -> State:
    """Take one classical Runge-Kutta step of h seconds, given the inputs at start, middle, end."""
    # `settle` corrects the internal states that are not integrated, after a small step from `now`.

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
    """Return displacement [m], velocity [m/s] and joint force [N/kg] of a motion from rest."""
    # `force(i, j)` is the analog force per unit mass at points i .. j - 1, `GRID` per sample
    # [N/kg].
    specimen = doubles(specimen_of(joint))
    start = doubles((0.0, 0.0, specimen.at_rest()))
    y, v, z = integrated(_motion_and_force, specimen, start, force, num_samples, fs)
    if not np.isfinite(v).all():
        raise ModelError(
            f"The response of `joint` must stay finite, but it is not from sample "
            f"{int(np.argmin(np.isfinite(v)))} on.",
            remedy="Check the joint's parameters, the gain and the sampling frequency.",
        )
    return y, v, z


def _motion_and_force(specimen: Specimen, state: State, u: Array) -> Seen:
    y, v, parts = state
    return y, v, specimen.joint_force(y, v, parts)


def integrated(
    seen: Callable[[Any, State, Array], Seen],
    system: Any,
    state: State,
    source: Callable[[int, int], NDArray[np.float64]],
    num_samples: int,
    fs: float,
    *,
    block: int = BLOCK,
) -> list[NDArray[np.float64]]:
    """Integrate a system in time; return the output `seen` of its state and source at each sample.

    The system has `state_rate` and `settle`; `source(i, j)` gives points i .. j - 1, `GRID` per
    sample.
    """
    saved = []
    for first in range(0, num_samples, block):
        u = source(first * GRID, (first + block) * GRID + 1)
        state, now = _advance(seen, system, state, u, 1.0 / (fs * SUBSTEPS))
        saved.append([np.asarray(channel) for channel in now])
    return [np.concatenate(blocks)[:num_samples] for blocks in zip(*saved, strict=True)]


@partial(jax.jit, static_argnums=0)
def _advance(
    seen: Callable[[Any, State, Array], Seen],
    system: Any,
    state: State,
    u: Float[Array, " grid"],
    h: float,
) -> tuple[State, Seen]:
    """Advance one block; return its final state and the outputs at the start of each sample."""

    def substep(i: Array, carry: tuple[Array, State]) -> tuple[Array, State]:
        start, now = carry
        at = start + 2 * i
        inputs = (u[at], u[at + 1], u[at + 2])
        return start, runge_kutta(system.state_rate, system.settle, now, inputs, h)

    def sample(now: State, n: Array) -> tuple[State, Seen]:
        _, after = lax.fori_loop(0, SUBSTEPS, substep, (GRID * n, now))
        return after, seen(system, now, u[GRID * n])

    return lax.scan(sample, state, jnp.arange(u.shape[0] // GRID))
