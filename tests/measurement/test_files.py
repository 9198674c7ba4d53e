"""Readers: what numpy, scipy and h5py wrote comes back; every damaged or odd file is refused."""

import contextlib
import os
import re
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.io.wavfile
from hypothesis import given, settings
from hypothesis import strategies as st

from jbw.errors import ConfigError, DataError, JbwError
from jbw.measurement.files.csv import sniff
from jbw.measurement.files.door import read
from jbw.measurement.files.hdf5 import write_hdf5
from jbw.measurement.files.paths import select
from jbw.measurement.files.tree import leaf, load
from jbw.measurement.records import Record

FS = 1024.0
N = 3000
T = np.arange(N) / FS
DRIVE = np.sin(2 * np.pi * 5.1 * T + 1.0)
LASER = 0.3 * np.cos(2 * np.pi * 5.1 * T)
ROLES = {"input": "shaker", "velocity": "laser"}
UNITS = {"input": "V", "velocity": "m/s"}


def refused(path, *args, error=DataError, **kwargs):
    """The error of reading, with its what and remedy."""
    with pytest.raises(error) as caught:
        read(path, *args, **kwargs)
    return caught.value


@pytest.fixture
def h5(tmp_path):
    path = tmp_path / "sweep.h5"
    record = Record(FS, {"input": DRIVE, "velocity": LASER}, UNITS, "sweep")
    write_hdf5(path, record, names=ROLES)
    return path


# --- every format gives the samples back ---


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


UNITS_V = {"velocity": "m/s"}


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


DIALECTS = {
    "comma": (",", ".", "time,shaker,laser\n", ""),
    "semicolon, decimal comma": (";", ",", "time;shaker;laser\n", ""),
    "semicolon, decimal point": (";", ".", "time;shaker;laser\n", ""),
    "tab": ("\t", ".", "time\tshaker\tlaser\n", ""),
    "tab, decimal comma": ("\t", ",", "time\tshaker\tlaser\n", ""),
    "spaces": (" ", ".", "time shaker laser\n", ""),
    "byte order mark": (";", ",", "\ufefftime;shaker;laser\n", ""),
    "units line and preamble": (",", ".", "Rig 7\nDate, 3 May\ntime,shaker,laser\ns,V,m/s\n", ""),
    "trailing delimiter": (";", ".", "time;shaker;laser;\n", ";"),
    "quoted names": (",", ".", '"time","shaker","laser"\n', ""),
    "comment mark": (" ", ".", "# time shaker laser\n", ""),
}


@pytest.mark.parametrize("dialect", DIALECTS)
def test_csv_dialects(tmp_path, dialect):
    delimiter, decimal, header, tail = DIALECTS[dialect]
    path = tmp_path / "a.csv"
    rows = (
        delimiter.join((f"{t:.9f}", f"{u:.9e}", f"{v:.9e}")) + tail
        for t, u, v in zip(T, DRIVE, LASER, strict=True)
    )
    path.write_text(header + "\n".join(rows).replace(".", decimal), encoding="utf-8")
    (record,) = read(path, {"time": "time", **ROLES}, UNITS)
    assert record.fs == FS
    # Ten printed digits.
    np.testing.assert_allclose(record.channels["velocity"], LASER, rtol=1e-9, atol=1e-18)
    assert record.provenance["decimal mark"] == decimal
    assert "header lines" in record.provenance


def test_csv_in_utf16_and_without_header(tmp_path):
    path = tmp_path / "a.txt"
    rows = "\n".join(f"{u:.9e}\t{v:.9e}" for u, v in zip(DRIVE, LASER, strict=True))
    path.write_text(rows, encoding="utf-16")
    (record,) = read(path, {"velocity": "column[1]"}, UNITS_V, fs=FS)
    np.testing.assert_allclose(record.channels["velocity"], LASER, rtol=1e-9, atol=1e-18)


@pytest.mark.parametrize(
    "text",
    ["1.5\n2.5\n3.5\n", "1,5\n2,5\n3,5\n", '"1,5","2,5"\n"1,6","2,6"\n', "a;b\n1.234,5;2\n", "hi"],
)
def test_csv_that_could_be_misread_is_refused(tmp_path, text):
    path = tmp_path / "a.csv"
    path.write_text(text)
    error = refused(path, {"velocity": "column[0]"}, UNITS_V, fs=FS)
    assert "columns" in error.what
    assert "semicolon" in error.remedy


def test_csv_with_a_broken_line(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("a,b\n" + "1.5,2.5\n" * 1000 + "1.5\n" + "1.5,2.5\n" * 1000)
    error = refused(path, {"velocity": "a"}, UNITS_V, fs=FS)
    assert "a.csv" in error.what
    assert "csv reader" in error.what


@pytest.mark.parametrize("cut", [1, 3, 9, 12])
def test_csv_cut_in_its_last_number_is_refused(tmp_path, cut):
    path = tmp_path / "a.csv"
    whole = "a,b\n" + "\n".join(f"{t:.9f},{v:+.9e}" for t, v in zip(T, LASER, strict=True))
    path.write_text(whole)
    (record,) = read(path, {"time": "a", "velocity": "b"}, UNITS_V)
    assert record.num_samples == N
    path.write_text(whole[:-cut])
    error = refused(path, {"time": "a", "velocity": "b"}, UNITS_V)
    assert f"({path.stat().st_size} bytes)" in error.what
    assert "again" in error.remedy


# No exotic characters: the dialect is what is tried here, not the decoding.
NUMBERS = st.floats(-1e6, 1e6, allow_nan=False, width=32).map(lambda x: round(x, 6) + 0.5**20)


@settings(max_examples=60, deadline=None)
@given(
    table=st.lists(st.lists(NUMBERS, min_size=3, max_size=3), min_size=3, max_size=8),
    dialect=st.sampled_from([(",", "."), (";", ","), ("\t", ","), (" ", ".")]),
)
def test_sniffed_dialect_is_the_written_one(table, dialect):
    delimiter, decimal = dialect
    lines = [delimiter.join(f"{x:.9f}".replace(".", decimal) for x in row) for row in table]
    found = sniff(lines, "x")
    assert (found.delimiter or " ", found.decimal, found.columns) == (delimiter, decimal, 3)


@settings(max_examples=60, deadline=None)
@given(text=st.text(max_size=200))
def test_any_text_is_read_or_refused_plainly(tmp_path_factory, text):
    path = tmp_path_factory.mktemp("text") / "a.csv"
    path.write_text(text, encoding="utf-8", errors="replace")
    with contextlib.suppress(JbwError):  # anything else is a bare traceback
        read(path, {"velocity": "column[0]"}, UNITS_V, fs=FS)


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


# --- faults, by their rows ---


@pytest.mark.parametrize("share", [1, 30, N])
def test_nan_is_counted_and_placed(tmp_path, share):
    laser = LASER.copy()
    laser[7 : 7 + share] = np.nan
    np.savez(tmp_path / "a.npz", laser=laser)
    error = refused(tmp_path / "a.npz", {"velocity": "laser"}, UNITS_V, fs=FS)
    assert "`velocity`" in error.what
    assert f"{min(share, N - 7)} of {N}" in error.what
    assert "first at 7" in error.what
    assert "exclude" in error.remedy


@pytest.mark.parametrize("laser", [np.zeros(N), np.full(N, 0.3), 0.3 + (np.arange(N) % 2) * 1e-7])
def test_dead_channel(tmp_path, laser):
    np.savez(tmp_path / "a.npz", laser=laser)
    error = refused(tmp_path / "a.npz", {"velocity": "laser"}, UNITS_V, fs=FS)
    assert "`velocity`: The channel is constant" in error.what
    assert "exclude" in error.remedy


def test_missing_sampling_frequency(tmp_path):
    np.savez(tmp_path / "a.npz", laser=LASER)
    error = refused(tmp_path / "a.npz", {"velocity": "laser"}, UNITS_V)
    assert "sampling frequency is missing" in error.what
    assert "fs = <Hz>" in error.remedy


@pytest.mark.parametrize(
    ("where", "what"), [("attribute", "`shaker` is 2048"), ("argument", "the argument is 2048")]
)
def test_sampling_frequencies_that_disagree(h5, where, what):
    if where == "attribute":
        with h5py.File(h5, "a") as file:
            file["shaker"].attrs["fs"] = 2048.0
    error = refused(h5, ROLES, fs=None if where == "attribute" else 2048.0)
    assert what in error.what
    assert "is 1024 Hz" in error.what
    assert "resample" in error.remedy


def test_rounded_interval_is_snapped_and_said(h5):
    with h5py.File(h5, "a") as file:
        for name in ("shaker", "laser"):
            del file[name].attrs["fs"]
            file[name].attrs["dt"] = 0.000976562  # six digits, as UFF keeps them
    (record,) = read(h5, ROLES)
    assert abs((N - 1) / record.fs - (N - 1) / 1024.0) < 1e-9  # drift [s]
    assert "snapped from 1024.0005" in record.provenance["fs"]


@pytest.mark.parametrize(
    ("spoil", "what", "remedy"),
    [
        (lambda t: t[[*range(100), 101, 100, *range(102, N)]], "sample 101", "span"),
        (lambda t: np.insert(t, 100, t[100])[:N], "sample 101", "span"),
        (lambda t: np.delete(np.append(t, N / FS), 100), "1 gap(s): 0.0966797-0.0986328", "span"),
        (lambda t: t + 0.02 / FS * np.sin(np.arange(N) * 7.0), "0.0131 off", "Resample"),
        (lambda t: np.where(np.arange(N) == 5, np.nan, t), "sample 5", ""),
    ],
)
def test_bad_time_column(tmp_path, spoil, what, remedy):
    np.savez(tmp_path / "a.npz", t=spoil(T.copy()), laser=LASER)
    error = refused(tmp_path / "a.npz", {"time": "t", "velocity": "laser"}, UNITS_V)
    assert "`t`" in error.what
    assert what in error.what
    assert remedy in error.remedy


@pytest.mark.parametrize(("fs", "form"), [(1024.0, "%.6f"), (1000.0, "%.3f"), (51200.0, "%.8f")])
def test_printed_time_column_gives_the_round_rate(tmp_path, fs, form):
    path = tmp_path / "a.csv"
    lines = (f"{form % (n / fs)},{v:.6f}" for n, v in enumerate(LASER))
    path.write_text("time,laser\n" + "\n".join(lines))
    (record,) = read(path, {"time": "time", "velocity": "laser"}, UNITS_V)
    assert record.fs == fs


def test_unit_is_required_known_and_not_contradicted(tmp_path, h5):
    np.savez(tmp_path / "a.npz", laser=LASER)
    error = refused(tmp_path / "a.npz", {"velocity": "laser"}, fs=FS, error=ConfigError)
    assert "unit of role `velocity` is missing" in error.what
    error = refused(h5, ROLES, {"velocity": "m/sec"}, error=ConfigError)
    assert "Role `velocity`: Unit `m/sec`" in error.what
    assert "`m/s`" in error.remedy
    error = refused(h5, ROLES, {"velocity": "mm/s"})
    assert "`mm/s` by the campaign but in `m/s` by the file" in error.what


def test_units_are_converted_and_said(tmp_path):
    np.savez(tmp_path / "a.npz", laser=LASER)
    (record,) = read(tmp_path / "a.npz", {"velocity": "laser"}, {"velocity": "mm/s"}, fs=FS)
    np.testing.assert_array_equal(record.channels["velocity"], LASER * 1e-3)
    assert record.units == {"velocity": "m/s"}
    assert record.provenance["unit of velocity"] == "mm/s, times 0.001"


def test_implausible_unit_is_doubted(tmp_path):
    np.savez(tmp_path / "a.npz", laser=LASER * 1e3)  # mm/s, taken for m/s
    with pytest.warns(UserWarning, match="is the file in mm/s"):
        read(tmp_path / "a.npz", {"velocity": "laser"}, UNITS_V, fs=FS)


def test_missing_channel_lists_what_is_there(h5):
    error = refused(h5, {"velocity": "lazer"}, UNITS_V)
    assert "role `velocity`: Channel `lazer` is not in the file" in error.what
    assert "Did you mean `laser`?" in error.remedy
    assert "shaker" in error.remedy


def test_unknown_role(h5):
    error = refused(h5, {"speed": "laser"}, error=ConfigError)
    assert "Role `speed`" in error.what
    assert "velocity" in error.remedy


@pytest.mark.parametrize("length", [N - 1, N + 1, N // 2])
def test_unequal_lengths(tmp_path, length):
    np.savez(tmp_path / "a.npz", shaker=DRIVE, laser=np.resize(LASER, length))
    error = refused(tmp_path / "a.npz", ROLES, UNITS, fs=FS)
    assert f"`input` has {N}" in error.what
    assert f"`velocity` has {length}" in error.what


def test_clipped_channel(tmp_path):
    np.savez(tmp_path / "a.npz", laser=np.clip(LASER, -1, 0.27))
    error = refused(tmp_path / "a.npz", {"velocity": "laser"}, UNITS_V, fs=FS)
    assert "% of the samples are clipped, at " in error.what
    assert "exclude" in error.remedy
    once = np.concatenate([LASER, 2 * LASER[:3] / LASER[:3] * 0.3, LASER])
    np.savez(tmp_path / "a.npz", laser=once)
    with pytest.warns(UserWarning, match=r"0\.05 % of the samples are clipped, at 2\.930-2\.933 s"):
        read(tmp_path / "a.npz", {"velocity": "laser"}, UNITS_V, fs=FS)


def test_smooth_peak_of_few_bits_is_not_clipped_but_quantised(tmp_path):
    np.savez(tmp_path / "a.npz", laser=np.round(LASER / 0.3 * 100) * 0.003)
    with pytest.warns(UserWarning, match="distinct values, fewer than 256") as caught:
        read(tmp_path / "a.npz", {"velocity": "laser"}, UNITS_V, fs=FS)
    assert len(caught) == 1


def test_pulse_train_source_is_no_fault(tmp_path, recwarn):
    np.savez(tmp_path / "a.npz", shaker=np.sign(DRIVE), laser=LASER)
    read(tmp_path / "a.npz", ROLES, UNITS, fs=FS)
    assert not recwarn.list


def test_missing_file_names_the_nearest(h5):
    error = refused(h5.parent / "swep.h5", ROLES)
    assert "does not exist" in error.what
    assert "Did you mean `sweep.h5`?" in error.remedy


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


@pytest.mark.parametrize("how", ["half", "junk", "empty", "flipped"])
@pytest.mark.parametrize("suffix", [".h5", ".mat", ".npz", ".wav"])
def test_damaged_file_is_refused(tmp_path, suffix, how):
    path = tmp_path / f"record{suffix}"
    roles = {"velocity": "channel" if suffix == ".wav" else "laser"}
    if suffix == ".h5":
        write_hdf5(path, Record(FS, {"velocity": LASER}, UNITS), names=roles)
    elif suffix == ".mat":
        scipy.io.savemat(path, {"laser": LASER}, do_compression=True)
    elif suffix == ".npz":
        np.savez_compressed(path, laser=LASER)
    else:
        scipy.io.wavfile.write(path, 1024, LASER.astype(np.float32))
    damaged(path, how)
    if (suffix, how) == (".wav", "flipped"):
        return  # WAV has no checksum; a flipped sample is a sample
    size = path.stat().st_size
    error = refused(path, roles, UNITS_V, fs=FS, scale={"velocity": 1.0})
    assert "record" in error.what
    assert f"({size} bytes)" in error.what
    assert "reader" in error.what
    assert "again" in error.remedy


def test_flipped_exponent_in_uncompressed_mat_is_seen_by_its_size(tmp_path):
    path = tmp_path / "a.mat"
    laser = LASER.copy()
    laser[40] = 4e284  # what a flipped bit of an exponent makes
    scipy.io.savemat(path, {"laser": laser})
    error = refused(path, {"velocity": "laser"}, UNITS_V, fs=FS)
    assert "Sample 40 is 4e+284" in error.what


@pytest.mark.parametrize("name", ["a.pkl", "a.pickle", "a.joblib"])
def test_pickle_is_never_opened(tmp_path, name):
    (tmp_path / name).write_bytes(b"cos\nsystem\n(S'false'\ntR.")
    error = refused(tmp_path / name, ROLES)
    assert "pickle" in error.what
    assert "savez" in error.remedy


def test_object_array_is_refused(tmp_path):
    np.savez(tmp_path / "a.npz", laser=np.array([{}], dtype=object))
    assert "npz reader" in refused(tmp_path / "a.npz", {"velocity": "laser"}, UNITS_V, fs=FS).what


def test_no_pickle_in_the_package():
    root = Path(__file__).parents[2] / "jbw"
    code = "\n".join(path.read_text() for path in root.rglob("*.py"))
    assert not re.search(r"pickle\.loads?|allow_pickle=True|import pickle", code)


def test_unknown_suffix(tmp_path):
    (tmp_path / "a.xyz").write_text("1")
    assert "`.xyz`" in refused(tmp_path / "a.xyz", ROLES).what


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
    assert "links out of the HDF5 file" in error.what


def test_soft_link_inside_the_file_is_followed(h5):
    with h5py.File(h5, "a") as file:
        file["ldv"] = h5py.SoftLink("/laser")
    (record,) = read(h5, {"velocity": "ldv"})
    np.testing.assert_array_equal(record.channels["velocity"], LASER)


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
    for module in ("tree", "npz", "mat"):
        monkeypatch.setattr(f"jbw.measurement.files.{module}.MAX_BYTES", 2**22)
    assert "GiB" in refused(path, {"velocity": "laser"}, UNITS_V, fs=FS).what


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


def test_rows_are_repeats(tmp_path):
    rows = np.stack([LASER, 2 * LASER, 3 * LASER])
    np.savez(tmp_path / "a.npz", laser=rows, t=T)
    error = refused(tmp_path / "a.npz", {"velocity": "laser"}, UNITS_V, fs=FS)
    assert f"(3, {N})" in error.what
    assert "`laser[0]`" in error.remedy
    roles = {"time": "t", "velocity": "laser"}
    repeats = read(tmp_path / "a.npz", roles, UNITS_V, repeats="rows", exclude=[1])
    assert [record.name for record in repeats] == ["a.npz[0]", "a.npz[2]"]
    np.testing.assert_array_equal(repeats[1].channels["velocity"], 3 * LASER)


def test_paths_with_spaces_and_other_scripts(tmp_path, h5):
    folder = tmp_path / "Prüfstand 振动"
    folder.mkdir()
    moved = h5.rename(folder / "mess ung ü.h5")
    assert read(moved, ROLES)[0].name == "mess ung ü.h5"


@pytest.mark.parametrize("path", ["laser[9999999]", "laser[x]", "laser[0].a", "laser[0][0]", ""])
def test_paths_that_lead_nowhere(h5, path):
    assert "velocity" in refused(h5, {"velocity": path}, UNITS_V).what


# --- universal files ---


def test_uff_round_trip_and_damage(tmp_path):
    pyuff = pytest.importorskip("pyuff")
    path = tmp_path / "a.uff"
    for i, (name, data) in enumerate((("shaker", DRIVE), ("laser", LASER))):
        record = pyuff.prepare_58(return_full_dict=True, func_type=1, data=data, x=T, id1=name)
        # pyuff writes no set with a key left open: 4 is real, double precision; the rest is free.
        record |= {key: 0 for key, value in record.items() if value is None}
        record |= {"binary": 0, "ord_data_type": 4, "abscissa_spacing": 1, "abscissa_inc": 1 / FS}
        record |= {key: "NONE" for key in record if re.search("id[2-5]|name|lab", key)}
        pyuff.UFF(str(path)).write_sets(record, mode="add" if i else "overwrite")
    (record,) = read(path, ROLES, UNITS)
    assert record.fs == FS
    # ASCII keeps eleven digits of a double.
    np.testing.assert_allclose(record.channels["velocity"], LASER, atol=1e-10)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 2 // 3])
    assert "uff" in refused(path, ROLES, UNITS).what
