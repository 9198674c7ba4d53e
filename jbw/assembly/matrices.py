r"""The mass, stiffness and damping of a model in SI, as a value that is checked once.

Dashpots across joints are determined from the damping matrix in the modes with stuck joints:

$$C = aM + bK_s + \sum_jd_jw_jw_j^T \quad\Rightarrow\quad
  \phi_i^TC\phi_k = (a + b\omega_i^2)\,\delta_{ik} + \sum_jd_jH_{ji}H_{jk}$$

A matrix that a model states as $b$ times the stiffness of the structure with its joints cut, $C =
bK$, has $d_j = -bk_j$. For a matrix of this form, a dashpot $d_j$ across each joint is exact; for
any other matrix the off-diagonal part is neglected.
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from jbw.assembly.dofs import Dof, dof_of, numbered_rows, require_distinct
from jbw.assembly.factorisation import Sparse, negative_pivots
from jbw.assembly.stuck_modes import StuckModes
from jbw.assembly.units import in_si, system_named
from jbw.errors import DataError, ModelError
from jbw.report.messages import matrices as messages

# limits of the asymmetry of entries, relative to sqrt(A_ii A_jj): below the first limit it is
# round-off, above the second limit it is an error
_ROUND_OFF, _ASYMMETRIC = 1e-10, 1e-6
# Fraction of the diagonal that is added before negative pivots of a mass matrix are counted.
_SEMIDEFINITE = 1e-12
_POWER_OF_TIME = {"K": 0, "C": 1, "M": 2}
# largest residual of a damping matrix of mass, stiffness and dashpot terms, relative to the norm of
# C, with rows divided by the root of K_s
_FORM = 1e-8
_NONE = 1e-9  # A dashpot smaller than this fraction of the largest modal damping is round-off.
_COUPLED = 0.1  # relative off-diagonal damping above which a warning is given
_SAID = 1e-6  # relative off-diagonal damping above which a note is made


@dataclass(frozen=True, eq=False, repr=False)
class MatrixModel:
    r"""A linear model in physical coordinates, $M\ddot q + C\dot q + Kq = Bu$, in SI.

    Attributes:
        mass: M, symmetric [kg, kg m, kg m^2].
        stiffness: K, symmetric [N/m, N/rad, N m/rad].
        dofs: Node and direction of every row.
        damping: C; None if the model has none.
        units: System of units in which the matrices were given.
        notes: Sentences on changes and assumptions.
        positions: Positions of the nodes [m]; None if unknown.

    Examples:
        Matrices in N, mm, t and s are kept in SI, so that 0.001 t is 1 kg and 10 N/mm is 1e4 N/m:

        >>> import jbw
        >>> import numpy as np
        >>> K = np.array([[20.0, -10.0], [-10.0, 10.0]])
        >>> model = jbw.matrix_model(1e-3 * np.eye(2), K, units="N-mm-t-s", dofs=["1:x", "2:x"])
        >>> print(model.mass.toarray()[0], model.stiffness.toarray()[0])
        [1. 0.] [ 20000. -10000.]
    """

    mass: Sparse
    stiffness: Sparse
    dofs: tuple[Dof, ...]
    damping: Sparse | None = None
    units: str = "SI"
    notes: tuple[str, ...] = ()
    positions: Mapping[str, tuple[float, float, float]] | None = None

    @property
    def num_dofs(self) -> int:
        """The number of rows, or degrees of freedom."""
        return len(self.dofs)

    @property
    def massless(self) -> np.ndarray:
        """The indices of the rows (degrees of freedom) that have no mass."""
        return np.flatnonzero(abs(self.mass).sum(axis=0) == 0)

    def __repr__(self) -> str:
        nodes = len({dof.node for dof in self.dofs})
        matrices = "M, K" if self.damping is None else "M, C, K"
        return messages.shown(matrices, self.num_dofs, nodes)


def matrix_model(
    mass: Any,
    stiffness: Any,
    *,
    units: str,
    dofs: Sequence[Dof | tuple[Any, Any] | str] | None = None,
    damping: Any = None,
    nodes: Mapping[str, tuple[float, float, float]] | None = None,
) -> MatrixModel:
    """Return a model from dense or sparse matrices, with all checks that `read_matrices` makes.

    Args:
        mass: Mass matrix M.
        stiffness: Stiffness matrix K.
        units: A system of `jbw.assembly.units.SYSTEMS`, such as "SI" or "N-mm-t-s".
        dofs: Node and direction of every row, as pairs or "node:direction"; without a table, rows
            are counted from 1 and named "1:row".
        damping: Damping matrix C, if any.
        nodes: Positions of nodes, in the unit of length of the matrices; used only for pictures.

    Raises:
        ConfigError: The system of units is unknown, or needs a table of degrees of freedom.
        DataError: Shapes differ, a number is not finite, a matrix is not symmetric, or M is
            indefinite.

    Examples:
        Two masses of 1 kg hang on springs of 1e4 N/m, with one degree of freedom each:

        >>> import jbw
        >>> import numpy as np
        >>> K = np.array([[2e4, -1e4], [-1e4, 1e4]])
        >>> model = jbw.matrix_model(np.eye(2), K, units="SI", dofs=["1:x", "2:x"])
        >>> print(model.dofs[1].node, model.dofs[1].direction, model.damping)
        2 x None
    """
    system = system_named(units)
    raw = {"M": mass, "K": stiffness} | ({} if damping is None else {"C": damping})
    matrices = {name: _square(name, matrix) for name, matrix in raw.items()}
    size = next(iter(matrices.values())).shape[0]
    rows = numbered_rows(size) if dofs is None else tuple(map(_row, dofs))
    for name, matrix in matrices.items():
        if matrix.shape[0] != size:
            raise DataError(
                f"M and {name} must have the same size, but M has {size} rows and {name} has "
                f"{matrix.shape[0]}.",
                remedy="Export both matrices from the same step of the same model.",
            )
    if len(rows) != size:
        raise DataError(
            f"The table of degrees of freedom must have a line for each of the {size} rows of "
            f"the matrices, but has {len(rows)}.",
            remedy="Export the table together with the matrices.",
        )
    require_distinct(rows)
    notes = []
    for name, matrix in matrices.items():
        symmetric, note = _symmetrised(name, matrix, rows)
        matrices[name] = in_si(symmetric, rows, system, _POWER_OF_TIME[name])
        notes += [note] if note else []
    _require_semidefinite_mass(matrices["M"], rows)
    positions = None if nodes is None else {
        node: (system.length * x, system.length * y, system.length * z)
        for node, (x, y, z) in nodes.items()
    }  # fmt: skip
    return MatrixModel(
        matrices["M"], matrices["K"], rows, matrices.get("C"), units, tuple(notes), positions
    )


def _row(dof: Dof | tuple[Any, Any] | str) -> Dof:
    if isinstance(dof, str):
        node, _, direction = dof.rpartition(":")
        return dof_of(node, direction)
    return dof_of(*dof)


def _square(name: str, matrix: Any) -> Sparse:
    """Return a matrix in sparse float64 form, after checks of shape and finite numbers."""
    stored = _sparse(matrix if sp.issparse(matrix) else np.atleast_2d(np.asarray(matrix)))
    if np.iscomplexobj(stored.data):
        raise DataError(
            f"Matrix {name} must be real, but is complex.",
            remedy="Give structural damping as a damping ratio of every mode instead.",
        )
    if stored.ndim != 2 or stored.shape[0] != stored.shape[1] or stored.shape[0] == 0:
        raise DataError(
            f"Matrix {name} must be square, but has the shape {stored.shape}.",
            remedy="Export the whole assembled matrix, not a triangle as a vector.",
        )
    stored = _sparse(stored.astype(float))
    if not np.isfinite(stored.data).all():
        raise DataError(
            f"All numbers of matrix {name} must be finite, but one is not.",
            remedy="Export the matrix again.",
        )
    stored.sum_duplicates()
    stored.eliminate_zeros()
    return stored


def _sparse(matrix: Any) -> Sparse:
    return sp.csc_array(matrix)


def _symmetrised(name: str, matrix: Sparse, dofs: Sequence[Dof]) -> tuple[Sparse, str]:
    """Return the symmetric part of a matrix, and a sentence if it was clearly asymmetric."""
    size = np.sqrt(np.abs(matrix.diagonal()))
    largest = max(float(size.max()), float(np.sqrt(abs(matrix).max())) if matrix.nnz else 0.0)
    size[size == 0.0] = largest or 1.0
    skew = sp.coo_array(matrix - matrix.T)
    relative = np.abs(skew.data) / (size[skew.row] * size[skew.col])
    worst = int(np.argmax(relative)) if relative.size else 0
    if not relative.size or relative[worst] == 0.0:
        return matrix, ""
    i, j = int(skew.row[worst]), int(skew.col[worst])
    if relative[worst] > _ASYMMETRIC:
        triangle = sp.tril(matrix, -1).nnz == 0 or sp.triu(matrix, 1).nnz == 0
        raise DataError(
            f"Matrix {name} must be symmetric, but {name}[{dofs[i]}, {dofs[j]}] is "
            f"{matrix[i, j]:.9g} and {name}[{dofs[j]}, {dofs[i]}] is {matrix[j, i]:.9g}.",
            why="The modes of an unsymmetric matrix do not decouple the equations of motion.",
            remedy=f"If only a triangle was exported, mirror the triangle: {name} + {name}.T - "
            f"diag({name})."
            if triangle
            else "Export the linear model without friction, follower loads and gyroscopic terms.",
        )
    symmetric = sp.csc_array((matrix + matrix.T) / 2)
    if relative[worst] <= _ROUND_OFF:
        return symmetric, ""
    return symmetric, messages.asymmetric(name, relative[worst], str(dofs[i]), str(dofs[j]))


def _require_semidefinite_mass(mass: Sparse, dofs: Sequence[Dof]) -> None:
    """Raise if a mass matrix has a negative eigenvalue; rows without mass are allowed."""
    diagonal = mass.diagonal()
    carries = np.flatnonzero(abs(mass).sum(axis=0) > 0)
    if carries.size == 0:
        raise DataError("All entries of matrix M are zero, but the structure must have mass.")
    negative = carries[diagonal[carries] <= 0]
    if negative.size == 0:
        massive = sp.csc_array(mass[carries][:, carries])
        massive = massive + _SEMIDEFINITE * sp.diags_array(massive.diagonal())
        negative = carries[negative_pivots(sp.csc_array(massive))]
    if negative.size:
        dof = dofs[int(negative[0])]
        raise DataError(
            f"Matrix M must be positive definite, but is indefinite at node {dof.node}, direction "
            f"{dof.direction}.",
            why="With an indefinite mass matrix, some motion has negative kinetic energy.",
            remedy="Check whether M and K were exchanged, and check the mass elements at node "
            f"{dof.node}.",
        )


class ModalDamping(NamedTuple):
    """The damping of the modes of unit modal mass.

    Attributes:
        zeta: Damping ratios of the kept modes, from the diagonal alone [-]; 0 for rigid-body modes.
        mass_factor: a [1/s]; None if C does not have the form above.
        stiffness_factor: b [s].
        dashpots: d_j of every joint [N s/m]; zeros if C does not have the form above.
        notes: Sentences on what was neglected.
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
    """Return damping ratios from C's diagonal, and dashpots if they explain the off-diagonal part.

    Raises:
        ModelError: C supplies energy to a mode.
    """
    elastic = modes.omega > 0
    reduced = modes.shapes.T @ (damping @ modes.shapes)
    diagonal = np.diag(reduced)
    if np.any(diagonal[elastic] < 0):
        raise ModelError(
            "The damping matrix must dissipate energy in every mode, but adds energy to mode "
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
    """Fit mass, stiffness and dashpot terms to a damping matrix; None if the residual is large."""
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
    residual = np.linalg.norm(basis @ (factors / norms) - target)
    return factors / norms if residual <= _FORM * np.linalg.norm(target) else None


def _left_out(reduced: np.ndarray, diagonal: np.ndarray) -> tuple[str, ...]:
    """Return a note on the largest neglected off-diagonal damping, if any; warn if it is large."""
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
