"""NumPy archives: dense matrices stored by name, or one matrix of `scipy.sparse.save_npz`."""

from pathlib import Path

import numpy as np
import scipy.sparse as sp

from jbw.assembly.files.contents import MatrixFile, require_sparse
from jbw.assembly.files.dof_table import DOFS, rows_of_table
from jbw.assembly.files.node_table import NODES, positions
from jbw.measurement.files.npz import require_unpackable
from jbw.report.messages import matrices as messages


def contents(path: Path) -> MatrixFile:
    """Read an .npz file's matrices and `dofs`, given as "node:direction" or [node, direction].

    If there is an array `nodes`, it has rows [node, x, y, z].
    """
    require_unpackable(path, messages.AS_SPARSE)
    with path.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
        names = list(archive.files)
        if {"format", "data", "shape"} <= set(names):
            require_sparse(path.name, archive["shape"].tolist(), archive["data"].size)
            return MatrixFile({"": sp.load_npz(path)})
        arrays = {name: archive[name] for name in names}
    table = next((arrays.pop(name) for name in names if name.lower() == DOFS), None)
    nodes = next((arrays.pop(name) for name in list(arrays) if name.lower() == NODES), None)
    matrices = {name: x for name, x in arrays.items() if x.ndim == 2 and x.dtype.kind in "iufc"}
    return MatrixFile(
        matrices,
        {} if table is None else {"": rows_of_table(table)},
        None if nodes is None else positions(nodes),
    )
