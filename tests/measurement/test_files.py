"""Readers: what numpy, scipy and h5py wrote comes back."""

import sys
from contextlib import contextmanager
from types import ModuleType

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.io.wavfile
from hypothesis import given, settings
from hypothesis import strategies as st
from tone_file import DRIVE, FS, LASER, ROLES, UNITS, UNITS_V, T, refused

from jbw.errors import ConfigError
from jbw.measurement.files import read as door
from jbw.measurement.files.hdf5 import write_hdf5
from jbw.measurement.files.paths import select
from jbw.measurement.files.read import read
from jbw.measurement.files.tree import Contents, leaf, load
from jbw.measurement.records import Record


def test_hdf5_round_trip(h5):
    (record,) = read(h5, ROLES)
    np.testing.assert_array_equal(record.channels["velocity"], LASER)
    assert (record.fs, record.units) == (FS, UNITS)
    assert record.provenance["reader"] == "HDF5"
    assert len(record.provenance["sha256"]) == 64


def test_hdf5_written_whole_or_not_at_all(tmp_path, monkeypatch):
    path = tmp_path / "a.h5"
    path.write_bytes(b"old")
    record = Record(FS, {"velocity": LASER}, {}, "no units")
    with pytest.raises(KeyError):
        write_hdf5(path, record)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_float32_file_keeps_24_bits(tmp_path):
    samples = np.round(LASER * 2**23) / 2**23
    write_hdf5(tmp_path / "a.h5", Record(FS, {"velocity": samples}, UNITS), dtype=np.float32)
    (record,) = read(tmp_path / "a.h5")
    np.testing.assert_array_equal(record.channels["velocity"], samples)


@pytest.mark.parametrize("compressed", [False, True])
def test_mat_v5(tmp_path, compressed):
    path = tmp_path / "a.mat"
    scipy.io.savemat(path, {"shaker": DRIVE, "laser": LASER[:, None]}, do_compression=compressed)
    (record,) = read(path, ROLES, UNITS, fs=FS)
    np.testing.assert_array_equal(record.channels["velocity"], LASER)


def test_mat_structs_cells_and_text(tmp_path):
    cells = np.empty((3, 2), dtype=object)
    for i in range(3):
        cells[i] = [T, LASER + i]
    levels = [{"force": DRIVE * k, "note": "x"} for k in (1, 2)]
    path = tmp_path / "a.mat"
    scipy.io.savemat(path, {"xData": cells, "FR": {"levels": levels}})
    repeats = read(path, {"time": "xData[:][0]", "velocity": "xData[:, 1]"}, UNITS_V)
    assert [record.name for record in repeats] == ["a.mat[0]", "a.mat[1]", "a.mat[2]"]
    np.testing.assert_array_equal(repeats[2].channels["velocity"], LASER + 2)
    (one,) = read(path, {"force": "FR.levels[1].force"}, {"force": "N"}, fs=FS)
    np.testing.assert_array_equal(one.channels["force"], 2 * DRIVE)
    error = refused(path, {"velocity": "FR.levels[0].note"}, UNITS_V, fs=FS)
    assert "text" in error.what


def matlab73(path):
    """A file laid out as MATLAB does: 512-byte header, axes reversed, cells and structs by ref."""
    with h5py.File(path, "w", userblock_size=512) as file:
        store = file.create_group("#refs#")
        cells = file.create_dataset("xData", (2, 3), dtype=h5py.ref_dtype)  # 3 x 2 in MATLAB
        cells.attrs["MATLAB_class"] = np.bytes_("cell")
        for i in range(3):
            for j, samples in enumerate((T, LASER + i)):
                item = store.create_dataset(f"{i}{j}", data=samples[None, :])
                item.attrs["MATLAB_class"] = np.bytes_("double")
                cells[j, i] = item.ref
        group = file.create_group("FR")
        group.attrs["MATLAB_class"] = np.bytes_("struct")
        field = group.create_dataset("force", (2, 1), dtype=h5py.ref_dtype)
        for k in range(2):
            item = store.create_dataset(f"f{k}", data=(DRIVE * (k + 1))[:, None])
            item.attrs["MATLAB_class"] = np.bytes_("double")
            field[k, 0] = item.ref
        matrix = file.create_dataset("acc", data=np.stack([DRIVE, LASER], axis=1))  # 2 x N
        matrix.attrs["MATLAB_class"] = np.bytes_("double")
        table = file.create_dataset("tab", data=np.zeros(3, dtype=np.uint32))
        table.attrs["MATLAB_class"] = np.bytes_("table")
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(128))


@pytest.mark.fault(47)
def test_mat_v73(tmp_path):
    path = tmp_path / "a.mat"
    matlab73(path)
    repeats = read(path, {"time": "xData[:][0]", "velocity": "xData[:][1]"}, UNITS_V)
    assert len(repeats) == 3
    assert repeats[0].provenance["reader"] == "MATLAB v7.3"
    np.testing.assert_array_equal(repeats[2].channels["velocity"], LASER + 2)
    (one,) = read(path, {"force": "FR[1].force"}, {"force": "N"}, fs=FS)
    np.testing.assert_array_equal(one.channels["force"], 2 * DRIVE)
    (row,) = read(path, {"velocity": "acc[1]"}, UNITS_V, fs=FS)
    np.testing.assert_array_equal(row.channels["velocity"], LASER)


@pytest.mark.fault(48)
def test_matlab_table_is_named_and_told_how_to_export(tmp_path):
    path = tmp_path / "a.mat"
    matlab73(path)
    error = refused(path, {"velocity": "tab"}, UNITS_V, fs=FS)
    assert "`tab` is a MATLAB table" in error.what
    assert "table2array" in error.remedy


def test_npz_with_its_own_rate_and_names_with_dots(tmp_path):
    path = tmp_path / "a.npz"
    table = np.stack([DRIVE, LASER], axis=1)
    np.savez(path, **{"0.5Hz1.5in": table, "Fs": FS})
    roles = {"input": "0.5Hz1.5in[:, 0]", "velocity": "0.5Hz1.5in[:][1]"}
    (record,) = read(path, roles, UNITS, fs="Fs")
    np.testing.assert_array_equal(record.channels["velocity"], LASER)
    assert record.fs == FS


@pytest.mark.filterwarnings("ignore:.*distinct values")  # 8 bits are few
@pytest.mark.parametrize("dtype", [np.int16, np.int32, np.float32, np.uint8])
def test_wav_needs_a_calibration(tmp_path, dtype):
    path = tmp_path / "a.wav"
    scale, zero = {np.uint8: (100, 128), np.float32: (0.5, 0.0)}.get(dtype, (2**14, 0))
    scipy.io.wavfile.write(path, 1024, (LASER * scale + zero).astype(dtype))
    error = refused(path, {"velocity": "channel[0]"}, UNITS_V, error=ConfigError)
    assert "needs a calibration" in error.what
    assert "scale = { velocity" in error.remedy
    full = {np.uint8: 128, np.int16: 2**15, np.int32: 2**31, np.float32: 1}[dtype]
    (record,) = read(path, {"velocity": "channel"}, UNITS_V, scale={"velocity": 2.0})
    # One step of integer samples; seven digits of float32.
    step = 2.0 / full if full > 1 else 1e-7
    np.testing.assert_allclose(record.channels["velocity"], 2 * scale / full * LASER, atol=step)


@given(
    shape=st.lists(st.integers(1, 4), min_size=1, max_size=4),
    data=st.data(),
)
@settings(max_examples=60, deadline=None)
def test_paths_index_as_numpy_does(shape, data):
    array = np.arange(np.prod(shape)).reshape(shape)
    steps = [data.draw(st.sampled_from([slice(None), *range(n)])) for n in shape]
    if sum(isinstance(step, slice) for step in steps) > 2:
        return
    path = "x" + "".join("[:]" if isinstance(step, slice) else f"[{step}]" for step in steps)
    expected = array[tuple(steps)]
    found = load(select({"x": leaf(array)}, path))
    np.testing.assert_array_equal(found, np.atleast_1d(np.squeeze(expected)))


def test_a_reader_of_one_s_own_is_one_module_and_one_line(tmp_path, monkeypatch):
    reader = ModuleType("tones_reader")

    @contextmanager
    def contents(path):
        if not path.read_text().isdigit():
            raise ValueError("no number")
        yield Contents({"laser": leaf(np.sin(np.arange(int(path.read_text()))))}, "tones", fs=FS)

    reader.contents = contents
    monkeypatch.setitem(sys.modules, reader.__name__, reader)
    monkeypatch.setattr(door, "READERS", dict(door.READERS))
    door.register(reader.__name__, ".tones")
    (tmp_path / "a.tones").write_text("300")
    (record,) = read(tmp_path / "a.tones", {"velocity": "laser"}, UNITS_V)
    np.testing.assert_array_equal(record.channels["velocity"], np.sin(np.arange(300)))
    (tmp_path / "a.tones").write_text("many")
    error = refused(tmp_path / "a.tones", {"velocity": "laser"}, UNITS_V)
    assert "cannot be read by the tones_reader reader: ValueError: no number" in error.what
