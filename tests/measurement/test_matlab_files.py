"""MATLAB files as MATLAB writes them: paths in its own notation, objects skipped by name."""

from pathlib import Path

import numpy as np
import pytest
import scipy.io

from jbw.errors import DataError
from jbw.measurement.files.read import opened, read
from jbw.measurement.files.tree import Leaf, Opaque, names

# Files that MATLAB itself wrote; scipy ships them with its own tests.
WRITTEN = Path(scipy.io.__file__).parent / "matlab" / "tests" / "data"
FS = 1024.0
T = np.arange(3000) / FS
LASER = 0.3 * np.cos(2 * np.pi * 5.1 * T)
UNITS = {"velocity": "m/s"}


def written(name):
    if not (WRITTEN / name).is_file():
        pytest.skip(f"scipy was installed without its test file {name}")
    return WRITTEN / name


@pytest.fixture
def nested(tmp_path):
    """Levels in a struct array, each with a matrix of 3 channels, and a cell array beside it."""
    levels = [{"acc": np.stack([LASER * k, LASER + k, LASER - k])} for k in (1, 2, 3, 4)]
    cells = np.empty((2, 2), dtype=object)
    for i in range(2):
        cells[i] = [T, LASER * (i + 1)]
    scipy.io.savemat(tmp_path / "a.mat", {"FR": {"Level": levels}, "xData": cells})
    return tmp_path / "a.mat"


@pytest.mark.parametrize(
    ("from_zero", "as_in_matlab"),
    [
        ("FR.Level[3].acc[2]", "FR.Level(4).acc(3,:)"),
        ("FR.Level[3].acc[2, :]", "FR.Level(4).acc(3, :)"),
        ("FR.Level[0].acc[0]", "FR.Level(1).acc(1,:)"),
        ("FR/Level[1]/acc[1]", "FR.Level(2).acc(2,:)"),
        ("xData[1, 1]", "xData{2,2}"),
        ("xData[0][1]", "xData{1}{2}"),
    ],
)
def test_a_path_copied_from_matlab_means_the_same(nested, from_zero, as_in_matlab):
    one, other = (
        read(nested, {"velocity": path}, UNITS, fs=FS)[0].channels["velocity"]
        for path in (from_zero, as_in_matlab)
    )
    np.testing.assert_array_equal(one, other)


def test_the_fourth_level_is_the_fourth(nested):
    (record,) = read(nested, {"velocity": "FR.Level(4).acc(2,:)"}, UNITS, fs=FS)
    np.testing.assert_array_equal(record.channels["velocity"], LASER + 4)
    repeats = read(nested, {"velocity": "FR.Level(:).acc(2,:)"}, UNITS, fs=FS)
    assert len(repeats) == 4


@pytest.mark.parametrize(
    ("path", "says"),
    [
        ("FR.Level(5).acc(1,:)", "selects item [4], counted from zero, but there are 4 items"),
        ("FR.Level[4].acc[0]", "selects item [4], counted from zero, but there are 4 items"),
        ("FR.Level(0).acc(1,:)", "has an index below 1"),
        ("FR.Level(4).acc(4,:)", "on an axis of 3"),
        ("FR.Level.acc", "has 4 items before"),
        ("FR.Level(4)", "is a group, not an array"),
        ("FR.Level(end).acc", "cannot be read"),
        ("xData{3,1}", "there are 2 items"),
    ],
)
def test_index_out_of_range_says_what_there_is(nested, path, says):
    with pytest.raises(DataError) as caught:
        read(nested, {"velocity": path}, UNITS, fs=FS)
    assert says in caught.value.what
    assert "a.mat" in caught.value.what


def test_difference_of_two_channels(tmp_path):
    payload = np.sin(2 * np.pi * 3.0 * T)
    scipy.io.savemat(tmp_path / "a.mat", {"acc": np.stack([LASER, payload])})
    for path in ("acc(1,:) - acc(2,:)", "acc[0] - acc[1]"):
        (record,) = read(tmp_path / "a.mat", {"velocity": path}, UNITS, fs=FS)
        np.testing.assert_array_equal(record.channels["velocity"], LASER - payload)
        assert record.provenance["channel of velocity"] == path


def test_difference_of_integers_does_not_wrap_around(tmp_path):
    one = np.arange(3000, dtype=np.int16) * 10
    np.savez(tmp_path / "a.npz", one=one, other=-one)
    (record,) = read(tmp_path / "a.npz", {"displacement": "one - other"}, {"displacement": "um"},
                     fs=FS)  # fmt: skip
    np.testing.assert_allclose(record.channels["displacement"], 2e-6 * one.astype(float))


def test_difference_of_unlike_channels_is_refused(tmp_path):
    np.savez(tmp_path / "a.npz", one=LASER, other=LASER[:-1])
    with pytest.raises(DataError, match=r"a\.npz: Channels that are subtracted must agree"):
        read(tmp_path / "a.npz", {"velocity": "one - other"}, UNITS, fs=FS)


@pytest.mark.fault(48)
def test_functions_are_named_beside_the_numbers_that_are_read():
    with opened(written("some_functions.mat")) as contents:
        found = dict(names(contents.root))
    assert isinstance(found["sqr"], Opaque)
    assert "function handle" in found["sqr"].kind
    assert "table2array" in found["sqr"].remedy
    assert {name for name, item in found.items() if isinstance(item, Leaf)} == {"a", "b", "c"}


@pytest.mark.fault(48)
@pytest.mark.parametrize(
    ("file", "path"),
    [
        ("testmatlabstring_7_WIN64.mat", "matstring1"),
        ("testobject_7.4_GLNX86.mat", "testobject.expr"),
        ("testfunc_7.4_GLNX86.mat", "testfunc"),
        ("testsparse_7.4_GLNX86.mat", "testsparse"),
    ],
)
def test_what_is_no_array_is_refused_by_name(file, path):
    with pytest.raises(DataError) as caught:
        read(written(file), {"velocity": path}, UNITS, fs=FS)
    assert f"`{path}` is " in caught.value.what
    assert "MATLAB" in caught.value.remedy or "text" in caught.value.what


@pytest.mark.parametrize(
    "file",
    [f"{name}.mat" for name in ("testhdf5_7.4_GLNX86", "testdouble_7.4_GLNX86",
                                "testdouble_6.1_SOL2", "testdouble_4.2c_SOL2")],
)  # fmt: skip
def test_every_version_gives_the_same_numbers(file):
    # Nine points of a full turn, as its authors made it.
    (record,) = read(
        written(file), {"displacement": "testdouble"}, {"displacement": "mm"}, fs=1.0, span=(0, 9)
    )
    expected = np.linspace(0, 2e-3 * np.pi, 9)
    np.testing.assert_allclose(record.channels["displacement"], expected, rtol=1e-14)


@pytest.mark.fault(54)
def test_a_bomb_inside_a_struct_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "a.mat"
    inside = {"test": {"laser": np.zeros(2**20)}}
    scipy.io.savemat(path, inside, do_compression=True)
    monkeypatch.setattr("jbw.memory.MAX_BYTES", 2**22)
    with pytest.raises(DataError, match=r"declares 0\.0 GiB"):
        read(path, {"velocity": "test.laser"}, UNITS, fs=FS)
