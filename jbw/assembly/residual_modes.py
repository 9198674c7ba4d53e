r"""Residual attachment modes, made orthogonal: the solver takes them for further modes.

With the generalised eigenvectors Y of $(\Psi^TK_s\Psi, \Psi^TM\Psi)$ the shapes $\Psi Y$ are
orthogonal to each other and to the kept modes in M and in K_s.

Reference:
    Rubin, AIAA J. 13 (1975) 995.
"""

from typing import NamedTuple

import numpy as np
import scipy.linalg
from jaxtyping import Float

_DEPENDENT = 1e-10  # of the largest: columns and combinations below are left out


class ResidualModes(NamedTuple):
    """Residual modes of unit modal mass.

    Attributes:
        omega: Frequencies, ascending [rad/s].
        combinations: Columns Y: shapes are Psi Y [1/sqrt(kg) per unit of Psi].
        slowed: Those frequencies before they were lowered to the limit [rad/s].
    """

    omega: Float[np.ndarray, " residual"]
    combinations: Float[np.ndarray, "load residual"]
    slowed: Float[np.ndarray, " slowed"]


def residual_modes(
    flexibility: Float[np.ndarray, "load load"],
    mass: Float[np.ndarray, "load load"],
    whole: Float[np.ndarray, " load"],
    slowest_limit: float,
) -> ResidualModes:
    r"""Residual modes of attachment modes Psi.

    A mode beyond the limit is slowed, $\omega_p \to s\omega_p$, $h_p \to sh_p$, which keeps what it
    adds statically, $h_p^2/\omega_p^2$.

    Args:
        flexibility: Psi^T K_s Psi, which is the residual flexibility W^T Psi.
        mass: Psi^T M Psi.
        whole: Flexibility of each load, kept modes included [m/N]; what is round-off beside it is
            left out.
        slowest_limit: Frequency above which modes are slowed [rad/s].
    """
    size = flexibility.shape[0]
    diagonal = np.diag(flexibility)
    present = np.flatnonzero(diagonal > _DEPENDENT * whole)
    if present.size == 0:
        return ResidualModes(np.zeros(0), np.zeros((size, 0)), np.zeros(0))
    scale = 1 / np.sqrt(diagonal[present])
    pick = np.ix_(present, present)
    scaled = scale[:, None] * flexibility[pick] * scale
    shares, directions = np.linalg.eigh(scaled)
    independent = shares > _DEPENDENT * shares[-1]
    columns = scale[:, None] * directions[:, independent] / np.sqrt(shares[independent])
    # Unit stiffness; the reduced mass is 1/omega^2.
    reciprocals, turn = scipy.linalg.eigh(columns.T @ mass[pick] @ columns)
    limited = np.maximum(reciprocals, slowest_limit**-2)
    omega = 1 / np.sqrt(limited)
    combinations = np.zeros((size, omega.size))
    combinations[present] = (columns @ turn) * omega
    order = np.argsort(omega, kind="stable")
    beyond = reciprocals < slowest_limit**-2
    with np.errstate(divide="ignore"):
        slowed = 1 / np.sqrt(np.maximum(reciprocals[beyond], 0.0))
    return ResidualModes(omega[order], combinations[:, order], np.sort(slowed))
