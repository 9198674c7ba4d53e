"""Readers of a finite-element program's matrices, from one file or from a file each."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from jbw.assembly.dofs import Dof
from jbw.assembly.factorisation import Sparse
from jbw.assembly.files.contents import MatrixFile
from jbw.assembly.files.dof_table import read_table, rows_of_table
from jbw.assembly.files.node_table import Position, positions, read_nodes
from jbw.assembly.matrices import MatrixModel, matrix_model
from jbw.errors import ConfigError, DataError, JbwError
from jbw.report.messages import matrices as messages

# Each format has a module with a function `contents(path) -> MatrixFile`.
READERS = {
    ".mat": "mat",
    ".npz": "npz",
    ".mtx": "mtx",
    ".pch": "dmig",
    ".dmig": "dmig",
    ".bdf": "dmig",
    ".op4": "nastran",
    ".op2": "nastran",
}
# Names of M, K and C in files, in upper case: those of jbw, of Nastran and of other programs.
_NAMES = {
    "mass": ("M", "MASS", "MAA", "MAAX", "MGG", "MXX", "M_MAT"),
    "stiffness": ("K", "STIFFNESS", "STIF", "KAA", "KAAX", "KGG", "KXX", "K_MAT"),
    "damping": ("C", "DAMPING", "D", "BAA", "BAAX", "BGG", "BXX", "C_MAT"),
}
# In matrices from Abaqus, a larger entry (1e36) on the diagonal of K marks a fixed degree of
# freedom.
_FIXED = 1e30

Source = str | Path | Mapping[str, Any]
Table = Sequence[Dof] | None


def role_of(name: str) -> str:
    """Return what a matrix's name means: mass, stiffness or damping; "" if it is unknown."""
    return next((role for role, names in _NAMES.items() if name.upper() in names), "")


def read_matrices(source: Source, *, units: str, dofs: Any = None) -> MatrixModel:
    """Read the mass, stiffness and, if given, damping matrix of a structure in SI.

    | format | what it holds |
    |---|---|
    | `.mat`, v5 to v7.3 | variables M, K, C, `dofs` and `nodes`, dense or sparse |
    | `.npz` | arrays M, K, C, `dofs` and `nodes`, or one matrix of `scipy.sparse.save_npz` |
    | `.mtx`, Matrix Market | one matrix |
    | `.mtx` of Abaqus' `*MATRIX GENERATE` | one matrix, with node and direction of every row |
    | `.pch`, `.bdf` with DMIG entries of Nastran | matrices by name, with node and direction |
    | `.op4`, `.op2` of Nastran | matrices by name; needs pyNastran |

    Args:
        source: A file with all matrices, or {"mass": ..., "stiffness": ..., "damping": ..., "dofs":
            ..., "nodes": ...} with files or arrays, the last three as needed. `nodes` has the
            columns node, x, y, z in the unit of length of the matrices, and is drawn in reports.
        units: Consistent system of the matrices: "SI", "N-mm-t-s", "kN-mm-kg-ms" or "lbf-in-s". No
            file states it.
        dofs: Table of node and direction: a text file with the columns row, node, direction, or
            such rows; needed if the file has none and joints are named by node.

    Returns:
        The model.

    Raises:
        ConfigError: The system of units or a key of `source` is unknown.
        DataError: A file or matrix is missing, damaged, or fails a check.

    Examples:
        The file that a finite-element program wrote holds mass, stiffness and degrees of freedom:

        >>> import jbw
        >>> import numpy as np
        >>> K = np.array([[2e4, -1e4], [-1e4, 1e4]])
        >>> np.savez("beam.npz", M=np.eye(2), K=K, dofs=["1:x", "2:x"])
        >>> model = jbw.read_matrices("beam.npz", units="SI")
        >>> print(model.dofs[1].node, model.dofs[1].direction, model.units)
        2 x SI
    """
    matrices, table, nodes = _given(source, dofs)
    matrices, table = _in_one_order(matrices, table)
    return _without_fixed(matrices, table, nodes, units)


class _Matrix(NamedTuple):
    """A matrix, with the degree of freedom of each row if its file states them."""

    matrix: Any
    dofs: Table


Matrices = tuple[_Matrix, _Matrix, _Matrix | None]  # mass, stiffness and optional damping


def _given(source: Source, dofs: Any) -> tuple[Matrices, Table, Mapping[str, Position] | None]:
    """Return the matrices with a common table of rows and any node positions."""
    if not isinstance(source, Mapping):
        path = Path(source)
        file = _contents(path)
        mass, stiffness = (_named(file, role, path.name) for role in ("mass", "stiffness"))
        damping = _named(file, "damping", path.name, required=False)
        table = _table(dofs) if dofs is not None else file.dofs.get("")
        return (_required(mass), _required(stiffness), damping), table, file.nodes
    unknown = set(source) - {*_NAMES, "dofs", "nodes"}
    if unknown or not {"mass", "stiffness"} <= set(source):
        raise ConfigError(
            "`matrices` must have the keys mass and stiffness, and may have damping, dofs and "
            f"nodes, but has {', '.join(source) or 'none'}.",
            remedy='Write { mass = "M.mtx", stiffness = "K.mtx", dofs = "dofs.csv" }.',
        )
    mass, stiffness, damping = (_of_source(source.get(role), role) for role in _NAMES)
    table = dofs if dofs is not None else source.get("dofs")
    table = None if table is None else _table(table)
    return (_required(mass), _required(stiffness), damping), table, _nodes(source.get("nodes"))


def _in_one_order(matrices: Matrices, table: Table) -> tuple[Matrices, Table]:
    """Sort matrices with labelled rows into the order of one table; return others unchanged."""
    rows = [matrix.dofs for matrix in matrices if matrix is not None]
    if not any(row is not None for row in rows):
        return matrices, table
    if table is None and any(row is None for row in rows):
        raise DataError(
            "Either all matrices or none must state their degrees of freedom, but only some do.",
            remedy="Export all matrices in one format, or give the table as `dofs`.",
        )
    named = dict.fromkeys(dof for row in rows for dof in row or ())
    table = list(named) if table is None else table
    absent = [dof for dof in named if dof not in set(table)]
    if absent:
        raise DataError(
            "The table of degrees of freedom must contain those of the matrices, but lacks "
            f"`{absent[0]}` and {len(absent) - 1} more.",
            remedy="Leave the table out, since the matrices state their degrees of freedom.",
        )
    mass, stiffness, damping = matrices
    placed = None if damping is None else _placed(damping, table)
    return (_placed(mass, table), _placed(stiffness, table), placed), table


def _required(matrix: _Matrix | None) -> _Matrix:
    if matrix is None:
        raise DataError("Mass and stiffness must be given, but one is missing.")
    return matrix


def _table(table: Any) -> list[Dof]:
    """Return the degrees of freedom of a table, from a file or in memory."""
    if isinstance(table, str | Path):
        path = Path(table)
        return _attempted(path, read_table)
    return rows_of_table(table)


def _nodes(table: Any) -> Mapping[str, Position] | None:
    """Return the positions of the nodes, from a file or in memory; None if none are given."""
    if table is None:
        return None
    if isinstance(table, str | Path):
        return _attempted(Path(table), read_nodes)
    return positions(table)


def _of_source(entry: Any, role: str) -> _Matrix | None:
    """Return a mass, stiffness or damping matrix, from a file or in memory; None if not given."""
    if entry is None:
        return None
    if not isinstance(entry, str | Path):
        return _Matrix(entry, None)
    path = Path(entry)
    file = _contents(path)
    if len(file.matrices) == 1:
        (name,) = file.matrices
        return _Matrix(file.matrices[name], file.dofs.get(name) or file.dofs.get(""))
    return _named(file, role, path.name)


def _named(file: MatrixFile, role: str, where: str, *, required: bool = True) -> _Matrix | None:
    """Return the mass, stiffness or damping matrix from a file, found by its name."""
    for name, matrix in file.matrices.items():
        if role_of(name) == role:
            return _Matrix(matrix, file.dofs.get(name))
    if not required:
        return None
    names = ", ".join(name for name in file.matrices if name)
    raise DataError(
        f"{where} must hold the {role} matrix as {_NAMES[role][0]}, but holds "
        f"{names or 'a matrix without a name' if file.matrices else 'no matrix'}.",
        remedy="Use one of these names, or give one file for each matrix: "
        '{ mass = "M.mtx", stiffness = "K.mtx" }.',
    )


def _contents(path: Path) -> MatrixFile:
    suffix = path.suffix.lower()
    if suffix not in READERS:
        raise DataError(
            f"Matrices must be in a file of type {', '.join(READERS)}, but `{path.name}` is not.",
            remedy="Export the matrices as Matrix Market (.mtx); in Ansys use *EXPORT, ..., MMF.",
        )
    return _attempted(path, import_module(f"jbw.assembly.files.{READERS[suffix]}").contents)


def _attempted[Read](path: Path, read: Callable[[Path], Read]) -> Read:
    """Return a reader's result for a file; report an error of a library in one sentence."""
    if not path.is_file():
        raise DataError(
            f"File `{path}` does not exist.",
            remedy="Check the path; paths in a campaign file are relative to the file's folder.",
        )
    try:
        return read(path)
    except JbwError:
        raise
    except Exception as error:
        raise DataError(
            f"{path.name} cannot be read: {type(error).__name__}: {error}.",
            remedy="Export the file again, or export it in another format.",
        ) from error


def _placed(matrix: _Matrix, table: Sequence[Dof]) -> _Matrix:
    """Return a matrix in the order of a table of rows; rows that the matrix lacks are zero."""
    if matrix.dofs is None:
        return matrix
    number = {dof: i for i, dof in enumerate(table)}
    rows = np.array([number[dof] for dof in matrix.dofs])
    entries: Sparse = sp.coo_array(matrix.matrix)
    placed = sp.csc_array(
        (entries.data, (rows[entries.row], rows[entries.col])), shape=(len(table),) * 2
    )
    return _Matrix(placed, table)


def _without_fixed(
    matrices: Matrices, table: Table, nodes: Mapping[str, Position] | None, units: str
) -> MatrixModel:
    """Return the model without fixed rows, which have 1e36 on the diagonal of the stiffness K."""
    columns: list[Sparse] = [
        None if part is None else sp.csc_array(part.matrix) for part in matrices
    ]
    mass, stiffness, damping = columns
    square = stiffness.ndim == 2 and stiffness.shape[0] == stiffness.shape[1] == mass.shape[0]
    fixed = np.flatnonzero(stiffness.diagonal() >= _FIXED) if square else np.array([])
    if fixed.size == 0:
        return matrix_model(mass, stiffness, units=units, dofs=table, damping=damping, nodes=nodes)
    free = np.setdiff1d(np.arange(stiffness.shape[0]), fixed)
    mass, stiffness = (matrix[free][:, free] for matrix in (mass, stiffness))
    damping = None if damping is None else damping[free][:, free]
    free_dofs = None if table is None else [table[i] for i in free.tolist()]
    model = matrix_model(mass, stiffness, units=units, dofs=free_dofs, damping=damping, nodes=nodes)
    note = messages.fixed_dofs(_FIXED, fixed.size)
    return replace(model, notes=(note, *model.notes))
