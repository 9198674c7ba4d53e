r"""The damping matrix in modes in full stick, and dashpots across joints.

$$C = aM + bK_s + \sum_jd_jw_jw_j^T \quad\Rightarrow\quad
  \phi_i^TC\phi_k = (a + b\omega_i^2)\,\delta_{ik} + \sum_jd_jH_{ji}H_{jk}$$

A matrix that a model states as $b$ times the stiffness of the structure with its joints cut,
$C = bK$, has $d_j = -bk_j$. Of a matrix of this form a dashpot $d_j$ across each joint is exact; of
any other one the part beside the diagonal is left out.
"""

import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from jbw.assembly.factorisation import Sparse
from jbw.assembly.stuck_modes import StuckModes
from jbw.errors import ModelError
from jbw.report.messages import matrices as messages

_FORM = 1e-8  # of the norm of C, each row over the root of K_s: what the form may leave
_NONE = 1e-9  # of the largest modal damping: dashpots below are round-off
_COUPLED = 0.1  # off-diagonal damping that is warned of
_SAID = 1e-6  # that is said


class ModalDamping(NamedTuple):
    """Damping of the modes of unit modal mass.

    Attributes:
        zeta: Damping ratios of the kept modes, by the diagonal alone [-]; 0 of rigid-body modes.
        mass_factor: a [1/s]; None where C has not the form above.
        stiffness_factor: b [s].
        dashpots: d_j of every joint [N s/m]; zeros where C has not the form above.
        notes: What was left out, a sentence each.
    """

    zeta: Float[np.ndarray, " kept"]
    mass_factor: float | None
    stiffness_factor: float
    dashpots: Float[np.ndarray, " joint"]
    notes: tuple[str, ...]


def modal_damping(
    damping: Sparse,
    mass: Sparse,
    stiffness: Sparse,
    across: Float[np.ndarray, "dof joint"],
    modes: StuckModes,
    names: Sequence[str],
) -> ModalDamping:
    """Damping ratios by C's diagonal, and dashpots where they are all that is beside it.

    Raises:
        ModelError: C gives energy to a mode.
    """
    elastic = modes.omega > 0
    reduced = modes.shapes.T @ (damping @ modes.shapes)
    diagonal = np.diag(reduced)
    if np.any(diagonal[elastic] < 0):
        raise ModelError(
            "The damping matrix must take energy from every mode, but gives energy to mode "
            f"{int(np.argmax(elastic & (diagonal < 0))) + 1}.",
            remedy="State the damping ratios by `zeta`.",
        )
    zeta = np.where(elastic, diagonal / (2 * np.where(elastic, modes.omega, 1.0)), 0.0)
    none = np.zeros(across.shape[1])
    fitted = _of_form(damping, mass, stiffness, across)
    if fitted is not None:
        a, b, dashpots = fitted[0], fitted[1], fitted[2:]
        motion = across.T @ modes.shapes
        felt = np.abs(dashpots) * (motion**2).max(axis=1)
        dashpots = np.where(felt > _NONE * diagonal.max(initial=0.0), dashpots, 0.0)
        if np.all(a + b * modes.omega[elastic] ** 2 >= 0):
            by_name = dict(zip(names, dashpots.tolist(), strict=True))
            notes = (messages.dashpots(by_name),) if dashpots.any() else ()
            return ModalDamping(zeta, float(a), float(b), dashpots, notes)
    return ModalDamping(zeta, None, 0.0, none, _left_out(reduced, diagonal))


def _of_form(
    damping: Sparse, mass: Sparse, stiffness: Sparse, across: np.ndarray
) -> np.ndarray | None:
    """a, b and d_j by least squares; None where they leave more than round-off of C."""
    size = np.sqrt(np.abs(stiffness.diagonal()))
    scale = sp.diags_array(1 / np.where(size > 0, size, 1.0))
    weights = sp.csc_array(across)
    outer = [weights[:, [j]] @ weights[:, [j]].T for j in range(across.shape[1])]
    parts = [scale @ matrix @ scale for matrix in (mass, stiffness, *outer, damping)]
    columns = sp.csr_array(sp.hstack([part.reshape((-1, 1)) for part in parts]))
    dense = columns[np.unique(columns.nonzero()[0])].toarray()
    basis, target = dense[:, :-1], dense[:, -1]
    norms = np.linalg.norm(basis, axis=0)
    norms = np.where(norms > 0, norms, 1.0)
    factors, *_ = np.linalg.lstsq(basis / norms, target, rcond=None)
    left = np.linalg.norm(basis @ (factors / norms) - target)
    return factors / norms if left <= _FORM * np.linalg.norm(target) else None


def _left_out(reduced: np.ndarray, diagonal: np.ndarray) -> tuple[str, ...]:
    """The largest damping beside the diagonal, with a warning where it is large."""
    size = np.sqrt(np.where(diagonal > 0, diagonal, np.inf))
    coupling = np.abs(reduced) / np.outer(size, size)
    np.fill_diagonal(coupling, 0.0)
    if coupling.max(initial=0.0) <= _SAID:
        return ()
    i, j = np.unravel_index(np.argmax(coupling), coupling.shape)
    note = messages.coupled_damping(int(min(i, j)) + 1, int(max(i, j)) + 1, coupling[i, j])
    if coupling[i, j] > _COUPLED:
        warnings.warn(messages.damping_of_joints(note), stacklevel=5)
    return (note,)
