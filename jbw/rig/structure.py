r"""A structure of several modes with one joint, and the armature of the shaker that drives it.

$$\ddot q = \phi_d F - 2 Z \Omega \dot q - \Omega^2 q - \phi_J (f - K x), \qquad x = \phi_J^T q$$

$$F = g V - (m_a \ddot x_d + c_a \dot x_d + k_a x_d), \qquad x_d = \phi_d^T q$$

in mass-normalised shapes phi of the stuck joint, with the rig's own force f of the joint [N] and
its stiffness K at rest. Nothing here is shared with the identification: the motion is integrated
like that of one mode (`jbw.rig.integrator`), and not with the modes' exact propagators.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

from jbw.errors import ModelError
from jbw.oscillator.attachment import Attachment, attached
from jbw.oscillator.law import Law
from jbw.rig.forces import Force
from jbw.rig.integrator import (
    BLOCK,
    Seen,
    Specimen,
    State,
    doubles,
    integrated,
    require_double,
)
from jbw.units import powers_of

Modal = Float[np.ndarray, " mode"]


class Shapes(NamedTuple):
    """The modes of the structure with a fully stuck joint, with mode shapes in 1/sqrt(kg)."""

    omega: Modal  # natural frequencies [rad/s]
    zeta: Modal  # damping ratios [-]
    drive: Modal  # motion of the point where the shaker pushes, by mode
    joint: Modal  # relative displacement of the joint, by mode
    output: Modal  # motion of the point where the response is measured, by mode


class Armature(NamedTuple):
    """A shaker: its gain, and the mass, damping and stiffness that it adds to the structure."""

    # force per volt with the armature blocked [N/V]; 1 if the source is the force
    gain: float = 1.0
    mass: float = 0.0  # mass of the armature [kg]
    damping: float = 0.0  # damping of the armature, including back-EMF [N s/m]
    stiffness: float = 0.0  # stiffness of the armature's suspension [N/m]


class Assembled(NamedTuple):
    """A structure together with its joint and its shaker."""

    shapes: Shapes
    joint: tuple[Force, ...]  # forces [N] as functions of displacement [m]
    armature: Armature = Armature()

    @property
    def specimen(self) -> Specimen:
        """The joint alone, with its internal states, as a specimen with omega_n = zeta = 0."""
        return Specimen(0.0, 0.0, self.joint)

    def at_rest(self) -> State:
        """Return the state before any motion: (x, q, q', internal states of the joint)."""
        none = jnp.zeros_like(jnp.asarray(self.shapes.omega, float))
        return jnp.zeros(()), none, none, self.specimen.at_rest()

    def settle(self, before: State, after: State) -> State:
        """Return the state after a small step, with the joint's internal states updated."""
        return self.specimen.settle(before, after)

    def state_rate(self, state: State, source: Any) -> State:
        """Return the time derivative of the state under a source [V or N]."""
        x, q, rate, parts = state
        shapes, shaker, joint = self.shapes, self.armature, self.specimen
        v = shapes.joint @ rate
        held = shaker.damping * (shapes.drive @ rate) + shaker.stiffness * (shapes.drive @ q)
        bare = shapes.drive * (shaker.gain * source - held)
        bare -= 2 * shapes.zeta * shapes.omega * rate + shapes.omega**2 * q
        bare -= shapes.joint * (joint.joint_force(x, v, parts) + joint.k * x)
        # The inverse with the armature's mass follows from the Sherman-Morrison formula.
        share = shaker.mass / (1 + shaker.mass * (shapes.drive @ shapes.drive))
        return v, rate, bare - share * shapes.drive * (shapes.drive @ bare), joint.rates(v, parts)


class RigMotion(NamedTuple):
    """The sampled motions of structure, drive point and joint, and the shaker force."""

    displacement: Float[np.ndarray, " time"]  # displacement of the output [m]
    velocity: Float[np.ndarray, " time"]  # velocity of the output [m/s]
    acceleration: Float[np.ndarray, " time"]  # acceleration of the output [m/s^2]
    drive_point: Float[np.ndarray, " time"]  # acceleration where the shaker pushes [m/s^2]
    force: Float[np.ndarray, " time"]  # force between shaker and structure [N]
    joint: Float[np.ndarray, " time"]  # relative displacement of the joint [m]


def move(
    structure: Assembled,
    source: Callable[[int, int], NDArray[np.float64]],
    num_samples: int,
    fs: float,
) -> RigMotion:
    """Simulate a structure from rest under a source [V or N] with `GRID` points per sample."""
    require_double()
    doubled = doubles(structure)
    # Records of similar length share a compilation.
    size = min(BLOCK, 1 << (num_samples - 1).bit_length())
    x, q, rate, change, played = integrated(
        _motion_and_source, doubled, doubled.at_rest(), source, num_samples, fs, block=size
    )
    if not np.isfinite(q).all():
        raise ModelError(
            "The simulated response of the structure must be finite, but is not.",
            remedy="Lower the level of the source, or raise `fs`.",
        )
    shapes, shaker = structure.shapes, structure.armature
    tied = (shaker.stiffness * q + shaker.damping * rate + shaker.mass * change) @ shapes.drive
    force = shaker.gain * played - tied
    y, v, a = (modal @ shapes.output for modal in (q, rate, change))
    return RigMotion(y, v, a, change @ shapes.drive, force, x)


def _motion_and_source(structure: Assembled, state: State, source: Array) -> Seen:
    """Return x, q, q', q'' and the source."""
    return *state[:3], structure.state_rate(state, source)[2], source


def of_day(shapes: Shapes, specimen: Specimen) -> Shapes:
    """Return the modes, rescaled so that the first has the frequency and damping of a specimen."""
    omega = shapes.omega * (specimen.omega_n / shapes.omega[0])
    return shapes._replace(omega=omega, zeta=shapes.zeta * (specimen.zeta / shapes.zeta[0]))


def first_mode_truth(shapes: Shapes, armature: Armature) -> dict[str, float]:
    """Return the true omega_n, zeta and gain of the first mode in voltage-driven tests."""
    added = Attachment(armature.mass, armature.damping, armature.stiffness)
    omega, zeta = attached(shapes.omega, shapes.zeta, shapes.drive, added)
    gain = float(shapes.drive[0] * shapes.output[0])
    share = 1 + armature.mass * float(shapes.drive[0]) ** 2
    fed = {"omega_n": float(omega[0]), "zeta": float(zeta[0]), "gain": gain * armature.gain / share}
    return {f"{name}_voltage": value for name, value in fed.items()}


def modal_truth(shapes: Shapes, mode: int = 0) -> dict[str, Modal]:
    r"""Return the true modal parameters; joint motions are relative to that in mode `mode`.

    $$b_i = \phi_{d,i}\,\phi_{r,i}, \qquad
      h_i = \frac{\phi_{J,i}/\phi_{r,i}}{\phi_{J,1}/\phi_{r,1}}, \qquad
      p_i = \frac{\phi_{J,i}\,\phi_{r,i}}{\phi_{J,1}\,\phi_{r,1}}$$

    with c_i = 1 at the output r, per newton of the source.
    """
    across, along = shapes.joint / shapes.output, shapes.joint * shapes.output
    truth = {"omega_n": shapes.omega, "zeta": shapes.zeta}
    truth |= {"h": across / across[mode], "p": along / along[mode]}
    return truth | {"b": shapes.drive * shapes.output, "c": np.ones_like(across)}


def law_of_mode(law: Law, shapes: Shapes, mode: int = 0) -> dict[str, float]:
    r"""Convert a law's parameters to those of one mode's oscillator, whose displacement is y.

    $$x = s\,y, \qquad s = \phi_J/\phi_r, \qquad \text{force per unit mass}\ \phi_J \phi_r f$$

    so that a parameter per length is multiplied by s, a length by 1/s, and a stiffness also by
    phi_J^2.
    """
    push, stretch = float(shapes.joint[mode]), float(shapes.joint[mode] / shapes.output[mode])
    if push == 0:
        raise ModelError(f"Mode {mode} must move the joint, but its shape there is 0.")
    across_joint = {name: float(value) for name, value in law.parameters().items()}
    powers = {quantity.name: powers_of(quantity.unit) for quantity in law.table}
    return {name: x * _factor(powers[name], push, abs(stretch)) for name, x in across_joint.items()}


def _factor(powers: Mapping[str, int], push: float, stretch: float) -> float:
    """Return the factor on a parameter whose unit has given powers; s^-2 means a stiffness."""
    stiff = push**2 if powers.get("s") == -2 else 1.0
    return stiff * stretch ** -powers.get("m", 0)
