r"""Harmonic balance of several modes with the joints' displacements as the only unknowns.

The modes are linear, so the joints' displacements follow from the joints' forces by receptances,

$$X_{jn} + \sum_l G_{jl}(n\omega)\,r_{ln}(X_l) - G_{jF}(n\omega)\,u_n = 0, \quad
  G_{jl} = \sum_i \frac{h_{ji} p_{il}}{d_i}, \quad G_{jF} = \sum_i \frac{h_{ji} b_i}{d_i}, \quad
  d_i = \omega_i^2 - (n\omega)^2 + 2j\zeta_i\omega_i n\omega$$

and the only unknowns are the joints' displacements, however many modes there are. All functions
take an admitted structure with an axis of joints.
"""

from dataclasses import replace
from functools import partial, reduce
from operator import add
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from jbw.oscillator.modes.structure import Structure, first_frequency, map_joint_laws
from jbw.oscillator.parameters import Scalar
from jbw.oscillator.steady.waveform import orders


class StructureHarmonics(eqx.Module):
    """The harmonics of a periodic motion, complex peak amplitudes of orders 1, 3, 5, ...

    Attributes:
        x: Harmonics of every joint's relative displacement [m]; the axis of joints exists if the
            structure's `h` has one row per joint.
        q: Harmonics of the modal coordinates [m].
        y: Harmonics of the outputs [m].
    """

    x: Complex[Array, "*tone_joint harmonic"]
    q: Complex[Array, "*tone mode harmonic"]
    y: Complex[Array, "*channel harmonic"]


def of_one_joint(harmonics: StructureHarmonics) -> StructureHarmonics:
    """Return the harmonics of a structure with one joint, without the axis of joints."""
    return replace(harmonics, x=harmonics.x[..., 0, :])


def dynamic_stiffness(
    structure: Structure, omega: Scalar, num_harmonics: int, zeta_eq: Scalar = 0.0
) -> Complex[Array, "mode harmonic"]:
    r"""Return the dynamic stiffness d_i of the modes at the odd harmonics.

    $2\zeta_{eq}\omega$ is subtracted from the damping of every mode.
    """
    frequency = omega * orders(num_harmonics)
    omega_n, zeta = structure.omega_n[:, None], structure.zeta[:, None]  # pyright: ignore
    damping = 2.0 * (zeta * omega_n - zeta_eq * omega)
    return omega_n**2 - frequency**2 + 1j * damping * frequency  # pyright: ignore[reportReturnType]


def joint_forces(
    laws: tuple, omega: Scalar, x: Complex[Array, "joint harmonic"], max_turns: int
) -> Complex[Array, "joint harmonic"]:
    """Return the harmonics r_n of each joint's nonlinear force along its motion.

    Joints with laws of the same kinds are computed side by side, by one program.
    """
    alike: dict[Any, list[int]] = {}
    for j, of_joint in enumerate(laws):
        shapes = tuple(jnp.shape(leaf) for leaf in jax.tree.leaves(of_joint))
        alike.setdefault((jax.tree.structure(of_joint), shapes), []).append(j)
    rows: dict[int, Array] = {}
    for joints in alike.values():
        if len(joints) == 1:
            rows[joints[0]] = _joint_force(laws[joints[0]], x[joints[0]], omega, max_turns)
            continue
        same = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(laws[j] for j in joints))
        forces = jax.vmap(lambda law, q: _joint_force(law, q, omega, max_turns))(
            same, x[np.array(joints)]
        )
        rows |= dict(zip(joints, forces, strict=True))
    return jnp.stack([rows[j] for j in range(len(laws))])


@partial(jax.custom_jvp, nondiff_argnums=(2,))
def law_harmonics(
    law: Any, x: Complex[Array, " harmonic"], max_turns: int
) -> Complex[Array, " harmonic"]:
    r"""Return the harmonics of one law's F - K x, with a hand-written derivative.

    $$dr = \partial_x r\,dx + \partial_{law} r\,d\mathrm{law}$$

    The first term is computed once, in 2 H columns, however many directions are needed: a Jacobian
    by the motions of J joints then costs J times that, and not J^2.
    """
    return law.harmonics(x, max_turns)


@law_harmonics.defjvp
def _law_harmonics_jvp(max_turns: int, primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    law, x = primals
    force, by_law = jax.jvp(lambda law: law.harmonics(x, max_turns), (law,), tangents[:1])

    def real_parts(parts: Float[Array, "two harmonic"]) -> Float[Array, "two harmonic"]:
        harmonics = law.harmonics(jax.lax.complex(*parts), max_turns)
        return jnp.stack([harmonics.real, harmonics.imag])

    slope = jax.jacfwd(real_parts)(jnp.stack([x.real, x.imag]))
    change = jnp.einsum("rnsm,sm->rn", slope, jnp.stack([tangents[1].real, tangents[1].imag]))
    return force, by_law + jax.lax.complex(*change)


def _joint_force(laws: tuple, x: Array, omega: Scalar, max_turns: int) -> Array:
    """Return the harmonics of the nonlinear force of one joint's laws."""
    parts = [
        law.harmonics(x, max_turns, omega) if law.feels_rate else law_harmonics(law, x, max_turns)
        for law in laws
    ]
    return reduce(add, parts, jnp.zeros_like(x))


def modal_imbalance(
    structure: Structure,
    omega: Scalar,
    x: Complex[Array, "joint harmonic"],
    load: Any,
    max_turns: int,
) -> Complex[Array, "joint harmonic"]:
    """Return the residual of harmonic balance for a given motion of the joints."""
    return x - structure.h @ _coordinates(structure, omega, x, load, max_turns)  # pyright: ignore


def _coordinates(
    structure: Structure, omega: Scalar, x: Array, load: Any, max_turns: int
) -> Complex[Array, "mode harmonic"]:
    r"""Return modal coordinates, $q_{i,n} = (b_i u_n - \sum_j p_{ij} r_{jn})/d_i$."""
    r = joint_forces(structure.laws, omega, x, max_turns)
    push = structure.b[:, None] * load - structure.p @ r  # pyright: ignore
    return push / dynamic_stiffness(structure, omega, x.shape[-1])


def modal_response(
    structure: Structure, omega: Scalar, num_harmonics: int
) -> Complex[Array, "joint harmonic"]:
    """Return the displacements of fully stuck joints under a unit load at the first harmonic."""
    d = dynamic_stiffness(structure, omega, num_harmonics)
    driven = (structure.h * structure.b) @ (1.0 / d)  # pyright: ignore
    return driven * (orders(num_harmonics) == 1)


def modal_units(
    structure: Structure, omega: Scalar, amplitude: Scalar
) -> tuple[Structure, Array, Array]:
    r"""Return structure, frequency and joints' displacements in units of the first mode.

    $$q = \ell\hat q, \qquad x_j = \ell_j\hat x_j, \qquad \ell = A/\omega_1^2, \qquad
      \ell_j = \ell \sum_i |h_{ji} b_i|$$
    """
    unit = first_frequency(structure)
    length = jnp.asarray(amplitude / unit**2)
    reach = jnp.abs(structure.h) @ jnp.abs(structure.b)  # pyright: ignore[reportArgumentType]
    reach = jnp.where(reach > 0.0, reach, 1.0)
    laws = map_joint_laws(
        lambda law, its_reach: law.scaled(length * its_reach, unit**2), structure.laws, reach
    )
    scaled = replace(
        structure,
        omega_n=structure.omega_n / unit,
        h=structure.h / reach[:, None],
        p=structure.p * reach,  # pyright: ignore[reportOptionalOperand]
        laws=laws,
    )
    return scaled, jnp.asarray(omega / unit), (length * reach)[:, None]


def modes_of(
    structure: Structure,
    omega: Scalar,
    amplitude: Scalar,
    x: Complex[Array, "joint harmonic"],
    max_turns: int,
) -> StructureHarmonics:
    """Return the harmonics of joints, modes and outputs for a given motion of the joints."""
    load = amplitude * (orders(x.shape[-1]) == 1)
    q = _coordinates(structure, omega, x, load, max_turns)
    return StructureHarmonics(x, q, structure.c @ q)  # pyright: ignore
