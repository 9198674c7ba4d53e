"""The content of a file of matrices."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.sparse as sp

from jbw.assembly.dofs import Dof
from jbw.assembly.factorisation import Sparse
from jbw.assembly.files.node_table import Position
from jbw.memory import require_readable
from jbw.report.messages import matrices as messages

INDEX, ENTRY = 8, 16  # bytes that a column and an entry of a sparse matrix need


@dataclass(frozen=True)
class MatrixFile:
    """The matrices of a file by name, with the file's table of degrees of freedom if any.

    Attributes:
        matrices: Matrices by their names in the file; "" if the format has no names.
        dofs: Degree of freedom of every row, by matrix name; under "" that of all matrices.
        nodes: Position of every node; None if the file states none.
    """

    matrices: Mapping[str, Any]
    dofs: Mapping[str, Sequence[Dof]] = field(default_factory=dict)
    nodes: Mapping[str, Position] | None = None

    def __post_init__(self) -> None:
        # A corrupt index would end the process, because SciPy's compiled loops do not check
        # indices.
        for matrix in self.matrices.values():
            if sp.issparse(matrix) and matrix.format in ("csr", "csc", "bsr"):
                matrix.check_format(full_check=True)
                # SciPy does not check the shape of a matrix without entries.
                if np.any(np.diff(matrix.indptr) < 0):
                    raise ValueError("the row or column pointers do not rise")


def require_sparse(name: str, shape: Sequence[int], entries: int) -> None:
    """Raise if a sparse matrix needs more memory than allowed; call it before reading the matrix.

    Args:
        name: Name of the file.
        shape: Rows and columns.
        entries: Number of stored entries.
    """
    takes = f"The matrix in {name}, {shape[0]} x {shape[1]} with {entries} entries, needs"
    require_readable(INDEX * max(shape) + ENTRY * entries, takes, messages.WITHOUT_GAPS)


def of_labels(
    rows: Sequence[Dof], columns: Sequence[Dof], entries: np.ndarray
) -> tuple[Sparse, list[Dof]]:
    """Return a symmetric matrix from labelled entries, and its degrees of freedom in order.

    If only one triangle has entries, they are mirrored.
    """
    dofs = list(dict.fromkeys([*rows, *columns]))
    number = {dof: i for i, dof in enumerate(dofs)}
    row = np.array([number[dof] for dof in rows], int)
    column = np.array([number[dof] for dof in columns], int)
    return mirrored(row, column, entries, len(dofs)), dofs


def mirrored(row: np.ndarray, column: np.ndarray, entries: np.ndarray, size: int) -> Sparse:
    """Build a symmetric matrix from entries; if these fill only one triangle, mirror them."""
    keys = set(zip(row.tolist(), column.tolist(), strict=True))
    off = row != column
    if not any((j, i) in keys for i, j in keys if i != j):
        row, column = np.concatenate((row, column[off])), np.concatenate((column, row[off]))
        entries = np.concatenate((entries, entries[off]))
    return sp.csc_array((entries, (row, column)), shape=(size, size))
