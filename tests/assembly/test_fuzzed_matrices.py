"""Any damage to a file of matrices: read as a matrix of finite size, or refused by name."""

import warnings

import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

import jbw
from jbw.errors import JbwError

MATRIX = sp.csc_array(np.array([[300.0, -100, 0], [-100, 200, -100], [0, -100, 100.0]]))
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
}  # fmt: skip
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
