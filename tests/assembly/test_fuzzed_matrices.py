"""Any damage to a file of matrices: read as a matrix of finite size, or refused by name."""

import warnings

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

import jbw
from jbw.errors import JbwError

MATRIX = sp.csc_array(np.array([[300.0, -100, 0], [-100, 200, -100], [0, -100, 100.0]]))
ENTRIES = [(0, 0), (1, 0), (1, 1), (2, 1), (2, 2)]  # of the lower triangle
HEAD = "DMIG    K       0       6       2       0\n"
WRITERS = {
    "market.mtx": lambda path: scipy.io.mmwrite(path, MATRIX),
    "abaqus.mtx": lambda path: path.write_text("".join(
        f"{i + 1},1,{j + 1},1,{x:.9e}\n" for (i, j), x in zip(
            zip(*MATRIX.nonzero(), strict=True), MATRIX.data, strict=True
        )
    )),
    "dense.npz": lambda path: np.savez(path, K=MATRIX.toarray()),
    "sparse.npz": lambda path: sp.save_npz(path, MATRIX),
    "five.mat": lambda path: scipy.io.savemat(path, {"K": MATRIX}),
    "dense.mat": lambda path: matlab73(path, dense=True),
    "seven.mat": lambda path: matlab73(path, dense=False),
    "short.pch": lambda path: path.write_text("DMIG,K,0,6,1,0,,,4\n" + "".join(
        f"DMIG,K,{j + 1},1,,{i + 1},1,{MATRIX[i, j]}\n" for i, j in ENTRIES
    )),
    "long.pch": lambda path: path.write_text(HEAD + "".join(
        f"DMIG*   {'K':16}{j + 1:16}{1:16}\n*       {i + 1:16}{1:16}{MATRIX[i, j]:16.9E}\n"
        for i, j in ENTRIES
    )),
}  # fmt: skip


def matlab73(path, *, dense):
    """A matrix as MATLAB lays it out in HDF5: columns of row indices, or the array in reverse."""
    with h5py.File(path, "w") as file:
        if dense:
            file["K"] = MATRIX.toarray()
            return
        group = file.create_group("K")
        group.attrs["MATLAB_sparse"] = np.uint64(MATRIX.shape[0])
        for name in ("data", "indices", "indptr"):
            group[{"indices": "ir", "indptr": "jc"}.get(name, name)] = getattr(MATRIX, name)


FUZZED = settings(max_examples=60, deadline=5000, suppress_health_check=list(HealthCheck))
CHANGES = st.one_of(
    st.tuples(st.just("cut"), st.integers(0, 2**16)),
    st.tuples(st.just("flip"), st.integers(0, 2**16)),
    st.tuples(st.just("digit"), st.integers(0, 2**16)),
    st.tuples(st.just("junk"), st.binary(max_size=200)),
)


def changed(data, change):
    how, what = change
    if how == "junk":
        return what
    place = what % len(data)
    if how == "cut":
        return data[:place]
    new = b"9" if how == "digit" else bytes([data[place] ^ 1 << what % 8])
    return data[:place] + new + data[place + 1 :]


@pytest.mark.fault(46, 54)
@pytest.mark.parametrize("name", WRITERS)
@FUZZED
@given(change=CHANGES)
@example(change=("junk", b""))
@example(change=("cut", 62))  # within the last line of a Matrix Market file
@example(change=("junk", b"PK\x05\x06" + b"\0" * 18))
@example(change=("junk", b"%%MatrixMarket matrix array real general\n-3 4\n"))
@example(change=("junk", b"1 1 1e400\n2 2 nan\n"))
@example(change=("junk", b"1e30 1e30 1\n"))
@example(change=("junk", b"DMIG,K,0,6,1,0\nDMIG,K,1,1,,1,1,1e400\nDMIG,K,1e30,x,,nan\n"))
def test_damage_is_refused_or_a_matrix(tmp_path_factory, name, change):
    path = tmp_path_factory.mktemp("matrix") / name
    WRITERS[name](path)
    path.write_bytes(changed(path.read_bytes(), change))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            model = jbw.read_matrices({"mass": path, "stiffness": path}, units="SI")
        except JbwError:
            return
    assert model.stiffness.shape[0] == model.stiffness.shape[1]
    assert np.all(np.isfinite(model.stiffness.data))
