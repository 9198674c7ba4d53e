r"""Balance of harmonics condensed to the joint's relative displacement, and what the modes do then.

The modes are linear, so that the joint's displacement answers its own force by receptances,

$$X_n + G_{JJ}(n\omega)\,r_n(X) - G_{JF}(n\omega)\,u_n = 0, \quad
  G_{JJ} = \sum_i \frac{p_i h_i}{d_i}, \quad G_{JF} = \sum_i \frac{b_i h_i}{d_i}, \quad
  d_i = \omega_i^2 - (n\omega)^2 + 2j\zeta_i\omega_i n\omega$$

and the unknowns are as many as with one mode.
"""

from functools import reduce
from operator import add
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Complex

from jbw.oscillator.damper import Damper
from jbw.oscillator.modes.structure import Structure
from jbw.oscillator.parameters import Scalar
from jbw.oscillator.steady.waveform import orders


class StructureHarmonics(eqx.Module):
    """Harmonics of a periodic motion, complex peak amplitudes of orders 1, 3, 5, ...

    Attributes:
        x: Of the joint's relative displacement [m].
        q: Of the modal coordinates [m].
        y: Of the outputs [m].
    """

    x: Complex[Array, "*tone harmonic"]
    q: Complex[Array, "*tone mode harmonic"]
    y: Complex[Array, "*channel harmonic"]


def dynamic_stiffness(
    structure: Structure, omega: Scalar, num_harmonics: int, zeta_eq: Scalar = 0.0
) -> Complex[Array, "mode harmonic"]:
    r"""d_i at the odd harmonics, with the damping $2\zeta_{eq}\omega$ taken from every mode."""
    frequency = omega * orders(num_harmonics)
    omega_n, zeta = structure.omega_n[:, None], structure.zeta[:, None]  # pyright: ignore
    damping = 2.0 * (zeta * omega_n - zeta_eq * omega)
    return omega_n**2 - frequency**2 + 1j * damping * frequency  # pyright: ignore[reportReturnType]


def joint_force(
    laws: tuple, omega: Scalar, x: Complex[Array, " harmonic"], max_turns: int
) -> Complex[Array, " harmonic"]:
    """Harmonics r_n of the laws' remainders along a motion of the joint."""
    parts = [law.harmonics(x, max_turns) for law in laws]
    parts += [law.harmonics_at(omega, x, max_turns) for law in laws if isinstance(law, Damper)]
    return reduce(add, parts, jnp.zeros_like(x))


def modal_imbalance(
    structure: Structure, omega: Scalar, x: Complex[Array, " harmonic"], load: Any, max_turns: int
) -> Complex[Array, " harmonic"]:
    """Residual of the condensed balance at a motion of the joint."""
    d = dynamic_stiffness(structure, omega, x.shape[0])
    joint_receptance = (structure.p * structure.h) @ (1.0 / d)
    drive_receptance = (structure.b * structure.h) @ (1.0 / d)
    return (
        x
        + joint_receptance * joint_force(structure.laws, omega, x, max_turns)
        - drive_receptance * load
    )


def modal_response(
    structure: Structure, omega: Scalar, num_harmonics: int
) -> Complex[Array, " harmonic"]:
    """Displacement of the sticking joint under a unit load at the first harmonic."""
    d = dynamic_stiffness(structure, omega, num_harmonics)
    driven = (structure.b * structure.h) @ (1.0 / d)
    return driven * (orders(num_harmonics) == 1)


def modal_units(
    structure: Structure, omega: Scalar, amplitude: Scalar
) -> tuple[Structure, Array, Array]:
    """Structure, frequency and unit of displacement in units of the first mode's frequency."""
    unit = structure.omega_n[0]  # pyright: ignore[reportIndexIssue]
    length = jnp.asarray(amplitude / unit**2)
    laws = tuple(law.scaled(length, unit**2) for law in structure.laws)
    s = structure
    scaled = Structure(s.omega_n / unit, s.zeta, s.h, s.p, s.b, s.c, laws)
    return scaled, jnp.asarray(omega / unit), length


def modes_of(
    structure: Structure,
    omega: Scalar,
    amplitude: Scalar,
    x: Complex[Array, " harmonic"],
    max_turns: int,
) -> StructureHarmonics:
    r"""All modes of a motion of the joint, $q_{i,n} = (b_i u_n - p_i r_n)/d_i$."""
    num = x.shape[0]
    d = dynamic_stiffness(structure, omega, num)
    r = joint_force(structure.laws, omega, x, max_turns)
    load = amplitude * (orders(num) == 1)
    q = (structure.b[:, None] * load - structure.p[:, None] * r) / d  # pyright: ignore
    return StructureHarmonics(x, q, structure.c @ q)
