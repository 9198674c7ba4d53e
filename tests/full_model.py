"""The motion of all degrees of freedom of a structure, with joints read from OpenSees' commands.

The method is Newmark's average acceleration, implicit in the stuck stiffness, with OpenSees'
Bouc-Wen material

    F = a k0 x + (1 - a) k0 z,   dz/dx = A - |z|^n (gamma + beta sgn(z dx))

integrated by Runge-Kutta steps of order four along x. No code of jbw integrates here.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
import scipy.signal

ITERATIONS = 6  # of the joints' forces in each step
DIRECTIONS = ("x", "y", "z", "rx", "ry", "rz")


class Read(NamedTuple):
    """A joint read from a file: motion by degree of freedom, parallel spring and material."""

    weights: dict[str, float]
    spring: float
    material: tuple[float, ...]  # a, k0, n, gamma, beta, A


def joints_read(text):
    """Return the joints in OpenSees' commands, in the order of their elements."""
    commands = [line.split() for line in text.splitlines() if line and line[0] != "#"]
    constraints = {c[1]: c[2:] for c in commands if c[0] == "equationConstraint"}
    materials = {c[2]: (c[1], c[3:]) for c in commands if c[0] == "uniaxialMaterial"}
    found = []
    for element in (c for c in commands if c[:2] == ["element", "zeroLength"]):
        _, _, _, ground, node, _, tag, _, direction = element
        assert (constraints[node][:2], direction) == (["1", "1.0"], "1")
        assert ["fix", ground, *"111111"] in commands
        terms = np.reshape(constraints[node][2:], (-1, 3))
        weights = {f"{n}:{DIRECTIONS[int(d) - 1]}": -float(w) for n, d, w in terms}
        kind, parts = materials[tag]
        assert kind == "Parallel"
        spring, bouc_wen = (materials[part] for part in parts)
        assert (spring[0], bouc_wen[0]) == ("Elastic", "BoucWen")
        numbers = tuple(map(float, bouc_wen[1]))
        assert numbers[6:] == (0.0, 0.0, 0.0)  # This material does not degrade.
        found.append(Read(weights, float(spring[1][0]), numbers[:6]))
    return found


def moved(rig, joints, u, fs, *, zeta, factor, modes=()):
    """Return the output's velocity and the joints' motion, with steps of 1/(fs factor).

    The input is band-limited between its samples. The damping ratio is that of every stuck mode,
    except for the first ones, whose `modes` (omega, zeta) replace those of the matrices.
    """
    names = [str(dof) for dof in rig.model.dofs]
    across = np.zeros((len(names), len(joints)))
    for column, joint in zip(across.T, joints, strict=True):
        for dof, weight in joint.weights.items():
            column[names.index(dof)] = weight
    (output,) = (names.index(place) for place in rig.outputs.values())
    stuck = np.array([j.spring + j.material[1] * j.material[5] for j in joints])
    mass = rig.model.mass.toarray()
    stiffness = rig.model.stiffness.toarray() + (across * stuck) @ across.T
    omega_squared, shapes = scipy.linalg.eigh(stiffness, mass)
    modal = mass @ shapes
    ratios, updated = np.full(len(names), zeta), omega_squared.copy()
    for i, (omega, ratio) in enumerate(modes):
        updated[i], ratios[i] = omega**2, ratio
    stiffness = stiffness + (modal * (updated - omega_squared)) @ modal.T
    damping = (modal * (2 * ratios * np.sqrt(updated))) @ modal.T
    fine = scipy.signal.resample(u, len(u) * factor)
    push = np.zeros(len(names))
    push[names.index(rig.input)] = 1.0
    step = partial(
        _step, 1 / (fs * factor), mass, damping, stiffness, across, push, stuck,
        np.array([j.spring for j in joints]), np.array([j.material for j in joints]).T,
    )  # fmt: skip
    start = (*(jnp.zeros(len(names)) for _ in range(3)), *(jnp.zeros(len(joints)),) * 2)
    _, (v, x) = jax.lax.scan(step, start, jnp.asarray(fine))
    return np.asarray(v)[::factor, output], np.asarray(x)[::factor]


def _step(h, mass, damping, stiffness, across, push, stuck, spring, material, state, force):
    q, v, a, x, z = state
    inverse = np.linalg.inv(mass + h / 2 * damping + h**2 / 4 * stiffness)
    lagging = damping @ (v + h / 2 * a) + stiffness @ (q + h * v + h**2 / 4 * a)
    freely = inverse @ (push * force - lagging)
    by_joints = inverse @ across

    def with_joints(remainder):
        a1 = freely - by_joints @ remainder
        x1 = across.T @ (q + h * v + h**2 / 4 * (a + a1))
        return a1, x1

    def remainder_at(x1):
        z1 = _bouc_wen(material, z, x1 - x)
        ratio, k0 = material[:2]
        return spring * x1 + k0 * (ratio * x1 + (1 - ratio) * z1) - stuck * x1, z1

    x1 = x
    for _ in range(ITERATIONS):
        a1, x1 = with_joints(remainder_at(x1)[0])
    z1 = remainder_at(x1)[1]
    q1, v1 = q + h * v + h**2 / 4 * (a + a1), v + h / 2 * (a + a1)
    return (q1, v1, a1, x1, z1), (v1, x1)


def _bouc_wen(material, z, dx):
    _, _, n, gamma, beta, A = material

    def slope(z):
        return dx * (A - jnp.abs(z) ** n * (gamma + beta * jnp.sign(z * dx)))

    k1 = slope(z)
    k2 = slope(z + k1 / 2)
    k3 = slope(z + k2 / 2)
    k4 = slope(z + k3)
    return z + (k1 + 2 * k2 + 2 * k3 + k4) / 6
