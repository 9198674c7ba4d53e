"""Damaged, crafted and forbidden files: refused by name, never half read."""

import os
import re
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.io.wavfile
from tone_file import FS, LASER, ROLES, UNITS, UNITS_V, N, T, refused

from jbw.measurement.files.hdf5 import write_hdf5
from jbw.measurement.files.read import read
from jbw.measurement.records import Record


def damaged(path: Path, how: str) -> None:
    data = path.read_bytes()
    if how == "half":
        path.write_bytes(data[: len(data) // 2])
    elif how == "junk":
        path.write_bytes(np.random.default_rng(0).bytes(len(data)))
    elif how == "empty":
        path.write_bytes(b"")
    else:  # inside the samples, which every format here checks or we bound
        middle = len(data) // 2
        path.write_bytes(data[:middle] + bytes([data[middle] ^ 0xFF]) + data[middle + 1 :])


@pytest.mark.fault(46)
@pytest.mark.parametrize("how", ["half", "junk", "empty", "flipped"])
@pytest.mark.parametrize("suffix", [".h5", ".mat", ".npz", ".npy", ".wav", ".csv"])
def test_damaged_file_is_refused(tmp_path, suffix, how):
    path = tmp_path / f"record{suffix}"
    roles = {"velocity": {".wav": "channel", ".npy": "data"}.get(suffix, "laser")}
    if suffix == ".h5":
        write_hdf5(path, Record(FS, {"velocity": LASER}, UNITS), names=roles)
    elif suffix == ".mat":
        scipy.io.savemat(path, {"laser": LASER}, do_compression=True)
    elif suffix == ".npz":
        np.savez_compressed(path, laser=LASER)
    elif suffix == ".npy":
        np.save(path, LASER)
    elif suffix == ".csv":
        np.savetxt(path, np.stack([T, LASER], axis=1), delimiter=",", header="t,laser", comments="")
    else:
        scipy.io.wavfile.write(path, 1024, LASER.astype(np.float32))
    damaged(path, how)
    if how == "flipped" and suffix in (".wav", ".npy", ".csv"):
        return  # without a checksum a flipped sample is a sample, judged by its size alone
    size = path.stat().st_size
    error = refused(path, roles, UNITS_V, fs=FS, scale={"velocity": 1.0})
    assert "record" in error.what
    if (suffix, how) == (".csv", "junk"):  # any text may be a table; this one is not
        assert "columns of numbers" in error.what
        return
    assert f"({size} bytes)" in error.what
    assert "reader" in error.what
    assert "again" in error.remedy


@pytest.mark.fault(46)
def test_flipped_exponent_in_uncompressed_mat_is_seen_by_its_size(tmp_path):
    path = tmp_path / "a.mat"
    laser = LASER.copy()
    laser[40] = 4e284  # what a flipped bit of an exponent makes
    scipy.io.savemat(path, {"laser": laser})
    error = refused(path, {"velocity": "laser"}, UNITS_V, fs=FS)
    assert "Sample 40 is 4e+284" in error.what


@pytest.mark.fault(51)
@pytest.mark.parametrize("name", ["a.pkl", "a.pickle", "a.joblib"])
def test_pickle_is_never_opened(tmp_path, name):
    (tmp_path / name).write_bytes(b"cos\nsystem\n(S'false'\ntR.")
    error = refused(tmp_path / name, ROLES)
    assert "pickle" in error.what
    assert "savez" in error.remedy


@pytest.mark.fault(51)
def test_object_array_is_refused(tmp_path):
    np.savez(tmp_path / "a.npz", laser=np.array([{}], dtype=object))
    assert "npz reader" in refused(tmp_path / "a.npz", {"velocity": "laser"}, UNITS_V, fs=FS).what


@pytest.mark.fault(51)
def test_no_pickle_in_the_package():
    root = Path(__file__).parents[2] / "jbw"
    code = "\n".join(path.read_text() for path in root.rglob("*.py"))
    assert not re.search(r"pickle\.loads?|allow_pickle=True|import pickle", code)


def test_unknown_suffix(tmp_path):
    (tmp_path / "a.xyz").write_text("1")
    assert "`.xyz`" in refused(tmp_path / "a.xyz", ROLES).what


@pytest.mark.fault(54)
@pytest.mark.parametrize("kind", ["external", "soft chain", "external storage", "virtual"])
def test_links_out_of_the_file_are_refused(tmp_path, h5, kind):
    path = tmp_path / "crafted.h5"
    with h5py.File(path, "w") as file:
        if kind == "external":
            file["laser"] = h5py.ExternalLink(str(h5), "/laser")
        elif kind == "soft chain":
            file["out"] = h5py.ExternalLink(str(h5), "/")
            file["laser"] = h5py.SoftLink("/out/laser")
        elif kind == "external storage":
            outside = [(str(tmp_path / "raw.bin"), 0, 8 * N)]
            file.create_dataset("laser", (N,), dtype="f8", external=outside)
        else:
            layout = h5py.VirtualLayout((N,), dtype="f8")
            layout[:] = h5py.VirtualSource(str(h5), "laser", (N,))
            file.create_virtual_dataset("laser", layout)
    error = refused(path, {"velocity": "laser"}, UNITS_V, fs=FS)
    assert "is a link out of the HDF5 file" in error.what


def test_soft_link_inside_the_file_is_followed(h5):
    with h5py.File(h5, "a") as file:
        file["ldv"] = h5py.SoftLink("/laser")
    (record,) = read(h5, {"velocity": "ldv"})
    np.testing.assert_array_equal(record.channels["velocity"], LASER)


@pytest.mark.fault(54)
@pytest.mark.parametrize("suffix", [".npz", ".mat", ".h5"])
def test_decompression_bomb_is_refused_by_its_declared_size(tmp_path, monkeypatch, suffix):
    path = tmp_path / f"a{suffix}"
    zeros = np.zeros(2**20)
    if suffix == ".npz":
        np.savez_compressed(path, laser=zeros)
    elif suffix == ".mat":
        scipy.io.savemat(path, {"laser": zeros}, do_compression=True)
    else:
        with h5py.File(path, "w") as file:
            file.create_dataset("laser", data=zeros, compression="gzip")
    assert path.stat().st_size < zeros.nbytes / 100
    monkeypatch.setattr("jbw.memory.MAX_BYTES", 2**22)
    assert "GiB" in refused(path, {"velocity": "laser"}, UNITS_V, fs=FS).what


def test_bytes_that_unpack_to_eight_times_as_many_are_refused(tmp_path):
    """4 GiB of uint8 may be stored, but are 32 GiB as the numbers that jbw computes with."""
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        laser = file.create_dataset("laser", (2**32 - 8,), dtype="u1", chunks=(2**20,))
        laser.attrs.update(fs=FS, unit="m/s")
    assert "takes 32.0 GiB" in refused(path, {"velocity": "laser"}).what


@pytest.mark.fault(50)
def test_huge_file_is_read_in_part(tmp_path):
    """A day at 51.2 kHz, 35 GB: sparse on disk, only the asked second in memory."""
    path = tmp_path / "day.h5"
    fs, hours = 51200, 24
    with h5py.File(path, "w") as file:
        laser = file.create_dataset("laser", (fs * 3600 * hours,), dtype="f8", chunks=(fs,))
        laser.attrs.update(fs=float(fs), unit="m/s")
        laser[fs * 7200 : fs * 7201] = np.sin(np.arange(fs) * 0.01)
    assert os.stat(path).st_size < 2**21
    error = refused(path, {"velocity": "laser"})
    assert "GiB" in error.what
    assert "span" in error.remedy
    (record,) = read(path, {"velocity": "laser"}, span=(7200.0, 7201.0))
    np.testing.assert_array_equal(record.channels["velocity"], np.sin(np.arange(fs) * 0.01))
    assert record.provenance["span"] == "7200-7201 s"
