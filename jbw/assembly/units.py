r"""Consistent systems of units for finite-element matrices, and conversion of matrices to SI.

A length unit of $\ell$ metres, a time unit of $\tau$ seconds and an energy unit of $e$ joules give

$$K_{ij}^{SI} = \frac{e K_{ij}}{s_i s_j}, \qquad C_{ij}^{SI} = \frac{e\tau C_{ij}}{s_i s_j}, \qquad
  M_{ij}^{SI} = \frac{e\tau^2 M_{ij}}{s_i s_j}$$

with $s_i = \ell$ for a translation, and $s_i = 1$ for a rotation [rad] or a scalar coordinate,
whose unit is arbitrary.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from jbw.assembly.dofs import ROW, TRANSLATIONS, Dof
from jbw.assembly.factorisation import Sparse
from jbw.errors import ConfigError
from jbw.units import INCH, POUND_FORCE


class ConsistentUnits(NamedTuple):
    """A system of units in which force = mass x length / time^2 has no additional factor."""

    length: float  # unit of length [m]
    time: float  # unit of time [s]
    energy: float  # unit of energy, force x length [J]
    names: tuple[str, str, str]  # names of the units of force, length and time


SYSTEMS = {
    "SI": ConsistentUnits(1.0, 1.0, 1.0, ("N", "m", "s")),
    "N-mm-t-s": ConsistentUnits(1e-3, 1.0, 1e-3, ("N", "mm", "s")),
    "kN-mm-kg-ms": ConsistentUnits(1e-3, 1e-3, 1.0, ("kN", "mm", "ms")),
    "lbf-in-s": ConsistentUnits(INCH, 1.0, POUND_FORCE * INCH, ("lbf", "in", "s")),
}


def system_named(units: str) -> ConsistentUnits:
    """Return the system of units with a name from `SYSTEMS`.

    Raises:
        ConfigError: There is no such system.
    """
    if units not in SYSTEMS:
        raise ConfigError(
            f"`units` of matrices must be one of {', '.join(SYSTEMS)}, but is {units!r}.",
            why="Matrix files do not state their units.",
            remedy="Give the system in which force = mass x length / time^2: for N and mm this "
            "is N-mm-t-s, with tonnes.",
        )
    return SYSTEMS[units]


def in_si(
    matrix: Sparse, dofs: Sequence[Dof], system: ConsistentUnits, power_of_time: int
) -> Sparse:
    """Return a matrix in SI; `power_of_time` is 0 for stiffness, 1 for damping and 2 for mass.

    Raises:
        ConfigError: The matrix is not in SI, and it is unknown which rows are rotations.
    """
    if system == SYSTEMS["SI"]:
        return matrix
    if any(dof.direction == ROW for dof in dofs):
        raise ConfigError(
            "Matrices in units other than SI must have a table of degrees of freedom, but there "
            "is none.",
            why="Rows of rotations are converted by other factors than rows of translations.",
            remedy="Give the table of degrees of freedom as `dofs`, or the matrices in SI.",
        )
    length = np.array([system.length if d.direction in TRANSLATIONS else 1.0 for d in dofs])
    scale = sp.diags_array(1.0 / length)
    factor = system.energy * system.time**power_of_time
    return sp.csc_array(factor * (scale @ matrix @ scale))
