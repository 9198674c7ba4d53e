"""MATLAB files of matrices: v5 by SciPy, v7.3 by h5py; dense and sparse."""

import warnings
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.io
import scipy.sparse as sp

from jbw.assembly.files.contents import MatrixFile, require_sparse
from jbw.assembly.files.dof_table import DOFS, rows_of_table
from jbw.assembly.files.node_table import NODES, positions
from jbw.measurement.files.mat_headers import require_sound
from jbw.memory import require_readable
from jbw.report.messages import matrices as messages


def contents(path: Path) -> MatrixFile:
    """Read a .mat file's matrices and `dofs`, given as "node:direction" or [node, direction].

    If there is a variable `nodes`, it has rows [node, x, y, z].
    """
    variables = _v73(path) if h5py.is_hdf5(path) else _v5(path)
    table = next((variables.pop(name) for name in list(variables) if name.lower() == DOFS), None)
    nodes = next((variables.pop(name) for name in list(variables) if name.lower() == NODES), None)
    matrices = {name: x for name, x in variables.items() if sp.issparse(x) or _is_matrix(x)}
    return MatrixFile(
        matrices,
        {} if table is None else {"": rows_of_table(table)},
        None if nodes is None else positions(nodes),
    )


def _is_matrix(variable: Any) -> bool:
    return isinstance(variable, np.ndarray) and variable.ndim == 2 and variable.dtype.kind in "iufc"


def _v5(path: Path) -> dict[str, Any]:
    require_sound(path)
    with warnings.catch_warnings():
        # SciPy's sparse matrices raise this warning.
        warnings.simplefilter("ignore", DeprecationWarning)
        loaded = scipy.io.loadmat(path, chars_as_strings=True)
    return {name: _cells(x) for name, x in loaded.items() if not name.startswith("__")}


def _cells(variable: Any) -> Any:
    """Return a cell array of texts as a NumPy array of texts; return other variables unchanged."""
    if isinstance(variable, np.ndarray) and variable.dtype == object:
        return np.array([str(np.squeeze(text)) for text in variable.ravel()])
    return variable


def _v73(path: Path) -> dict[str, Any]:
    with h5py.File(path, "r") as file:
        return {name: _read73(file, file[name]) for name in map(str, file) if name[0] != "#"}


def _read73(file: h5py.File, node: Any) -> Any:
    """Read a v7.3 variable: arrays have reversed axes, sparse matrices compressed columns."""
    if isinstance(node, h5py.Group):
        if "MATLAB_sparse" not in node.attrs:
            return None
        size: Any = node.attrs["MATLAB_sparse"]
        of: dict[str, Any] = dict(node.items())
        rows, starts = int(np.ravel(size)[0]), _loaded(of["jc"])
        entries = of["data"].size if "data" in of else 0
        require_sparse(Path(file.filename).name, (rows, starts.size - 1), entries)
        if "data" not in of:  # An entry of this form is a sparse matrix of zeros.
            return sp.csc_array((rows, starts.size - 1))
        parts = (_loaded(of["data"]), _loaded(of["ir"]), starts)
        return sp.csc_array(parts, shape=(rows, starts.size - 1))
    if h5py.check_ref_dtype(node.dtype) is h5py.Reference:
        texts = [np.ravel(np.asarray(file[link])) for link in np.ravel(np.asarray(node))]
        return np.array(["".join(map(chr, codes)) for codes in texts])
    array = _loaded(node).T
    if node.attrs.get("MATLAB_class", b"") == b"char":
        return np.array(["".join(map(chr, row)) for row in np.atleast_2d(array)])
    return array


def _loaded(node: Any) -> np.ndarray:
    takes = f"The array {node.name} of shape {node.shape} needs"
    require_readable(node.nbytes, takes, messages.AS_SPARSE)
    return np.asarray(node)
