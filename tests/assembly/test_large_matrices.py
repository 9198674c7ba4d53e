"""Small files of matrices that ask for gigabytes: refused by their headers, before any is read."""

import tracemalloc

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp

import jbw
from jbw.errors import DataError

FEW = 2**22  # bytes that stand for the limit, so that no test writes gigabytes


def refused(path):
    """The refusal of a file of matrices, and the most memory that it took to find [bytes]."""
    tracemalloc.start()
    try:
        with pytest.raises(DataError) as caught:
            jbw.read_matrices({"mass": path, "stiffness": path}, units="SI")
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert "Internal" not in caught.value.what
    return caught.value, peak


@pytest.mark.fault(54)
@pytest.mark.parametrize(
    ("header", "body"),
    [
        ("coordinate real general", "1000000000 1000000000 1\n1 1 1.0\n"),
        ("coordinate real symmetric", "1000000000 1000000000 1\n1 1 1.0\n"),
        ("coordinate real general", "10 10 1000000000\n1 1 1.0\n"),
        ("array real general", "100000 100000\n1.0\n"),
    ],
)
def test_a_matrix_market_file_of_sixty_bytes_asks_for_no_gigabytes(tmp_path, header, body):
    path = tmp_path / "K.mtx"
    path.write_text(f"%%MatrixMarket matrix {header}\n{body}")
    error, peak = refused(path)
    assert "GiB are read at once" in error.what
    assert error.remedy
    assert peak < 2**24


@pytest.mark.fault(54)
def test_a_row_number_of_ten_digits_asks_for_no_gigabytes(tmp_path):
    path = tmp_path / "K.mtx"
    path.write_text("1 1 1.0\n1000000000 1000000000 1.0\n")  # Abaqus, FORMAT=COORDINATE
    error, peak = refused(path)
    assert "1000000000 x 1000000000 with 2 entries" in error.what
    assert "without gaps" in error.remedy
    assert peak < 2**24


@pytest.fixture(name="_few")
def _limit(monkeypatch):
    monkeypatch.setattr("jbw.memory.MAX_BYTES", FEW)


@pytest.mark.fault(54)
@pytest.mark.usefixtures("_few")
@pytest.mark.parametrize("form", ["dense npz", "sparse npz", "mat 5", "mat 7.3"])
def test_an_archive_is_refused_before_it_is_unpacked(tmp_path, form):
    """Sixteen times the limit of zeros, packed to some kB."""
    side = int(np.sqrt(16 * FEW / 8))
    path = tmp_path / ("K.npz" if "npz" in form else "K.mat")
    if form == "dense npz":
        np.savez_compressed(path, K=np.zeros((side, side)))
    elif form == "sparse npz":  # one entry, and as many rows as memory cannot hold
        sp.save_npz(path, sp.coo_array(([1.0], ([0], [0])), shape=(16 * FEW, 16 * FEW)))
    elif form == "mat 5":
        scipy.io.savemat(path, {"K": np.zeros((side, side))}, do_compression=True)
    else:
        with h5py.File(path, "w") as file:
            file.create_dataset("K", data=np.zeros((side, side)), compression="gzip")
    assert path.stat().st_size < FEW
    error, peak = refused(path)
    assert "read at once" in error.what
    assert peak < FEW


@pytest.mark.usefixtures("_few")
@pytest.mark.parametrize("form", ["npz", "mat", "mtx"])
def test_a_matrix_within_the_limit_is_read_as_before(tmp_path, form):
    matrix = sp.diags_array(np.arange(1.0, 1001.0), format="csc")
    path = tmp_path / f"K.{form}"
    if form == "npz":
        sp.save_npz(path, matrix)
    elif form == "mat":
        scipy.io.savemat(path, {"K": matrix})
    else:
        scipy.io.mmwrite(path, matrix)
    model = jbw.read_matrices({"mass": path, "stiffness": path}, units="SI")
    np.testing.assert_array_equal(model.stiffness.toarray(), matrix.toarray())
