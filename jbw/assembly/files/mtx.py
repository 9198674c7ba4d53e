"""Matrices as text: Matrix Market, and the output of Abaqus' `*MATRIX GENERATE`.

Abaqus writes lines `node, dof, node, dof, entry` (FORMAT=MATRIX INPUT and LABELS) or `row column
entry` (FORMAT=COORDINATE), for one triangle or for both.

Reference:
    Boisvert, Pozo and Remington, The Matrix Market exchange formats, NISTIR 5935 (1996).
"""

import re
import warnings
from io import BytesIO
from pathlib import Path

import numpy as np
import scipy.io

from jbw.assembly.dofs import Dof, dof_of
from jbw.assembly.files.contents import MatrixFile, mirrored, of_labels, require_sparse
from jbw.errors import DataError
from jbw.memory import require_readable
from jbw.report.messages import matrices as messages

# exponents as Fortran writes them, such as 1.5D+3
_EXPONENT = re.compile(r"(?<=[\d.])[dD](?=[+-]?\d)")


def contents(path: Path) -> MatrixFile:
    """Return the matrix of a .mtx file, with degrees of freedom if the file has labels."""
    with path.open(encoding="utf-8", errors="replace") as stream:
        is_market = stream.readline().startswith("%%MatrixMarket")
    if is_market:
        # Add a line break, because SciPy's reader reads beyond an incomplete last line, which ends
        # the process.
        content = path.read_bytes() + b"\n"
        rows, columns, entries, form, *_ = scipy.io.mminfo(BytesIO(content))
        if form == "array":
            takes = f"The dense {rows} x {columns} matrix in {path.name} takes"
            require_readable(8 * rows * columns, takes, messages.AS_SPARSE)
        else:
            require_sparse(path.name, (rows, columns), entries)
        with warnings.catch_warnings():
            # SciPy's sparse matrices raise this warning.
            warnings.simplefilter("ignore", DeprecationWarning)
            return MatrixFile({"": scipy.io.mmread(BytesIO(content))})
    return _abaqus(path)


def _abaqus(path: Path) -> MatrixFile:
    text = path.read_text(encoding="utf-8", errors="replace")
    lines = [line for line in text.splitlines() if line.strip() and line.lstrip()[0] not in "*#%"]
    try:
        table = np.loadtxt((_EXPONENT.sub("e", line).replace(",", " ") for line in lines), ndmin=2)
    except ValueError as error:
        raise DataError(
            f"{path.name} must contain numbers (node, dof, node, dof and entry, or row, column "
            f"and entry), but does not: {error}.",
            remedy="Export the matrix with *MATRIX OUTPUT, FORMAT=MATRIX INPUT, or as Matrix "
            "Market.",
        ) from None
    if table.shape[0] == 0 or table.shape[1] not in (3, 5):
        raise DataError(
            f"{path.name} must have 3 or 5 numbers per line, but has {table.shape[1]}.",
            remedy="Export the matrix with *MATRIX OUTPUT, FORMAT=MATRIX INPUT, or as Matrix "
            "Market.",
        )
    if table.shape[1] == 5:
        matrix, dofs = of_labels(_labels(table[:, :2]), _labels(table[:, 2:4]), table[:, 4])
        return MatrixFile({"": matrix}, {"": dofs})
    row, column = table[:, 0].astype(int), table[:, 1].astype(int)
    if row.min() < 1 or column.min() < 1:
        raise DataError(
            f"Rows and columns of {path.name} must be counted from 1, but one is "
            f"{min(row.min(), column.min())}.",
            remedy="Export the matrix with *MATRIX OUTPUT, FORMAT=COORDINATE.",
        )
    size = int(max(row.max(), column.max()))
    require_sparse(path.name, (size, size), len(table))
    return MatrixFile({"": mirrored(row - 1, column - 1, table[:, 2], size)})


def _labels(columns: np.ndarray) -> list[Dof]:
    """Return the degrees of freedom from two columns, node and direction number."""
    pairs = columns.astype(int).tolist()
    named = {pair: dof_of(*pair) for pair in set(map(tuple, pairs))}
    return [named[tuple(pair)] for pair in pairs]
