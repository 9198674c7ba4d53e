"""Any damage to any file: it is read as it was, or refused by name; nothing else comes out.

What cannot be told is a changed sample where the format has no checksum. Never are samples missing
in silence, never does a reader hang, take the machine's memory, or end the process.
"""

import random
import sys
import warnings
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.io.wavfile
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from uff_files import write_uff

from jbw.errors import JbwError
from jbw.measurement.files.hdf5 import write_hdf5
from jbw.measurement.files.read import read
from jbw.measurement.records import Record

N, FS = 48, 1024.0
VELOCITY = 0.3 * np.sin(0.7 * np.arange(N))
RECORD = Record(
    FS,
    {"velocity": VELOCITY, "input": 0.2 * np.cos(0.7 * np.arange(N))},
    {"velocity": "m/s", "input": "V"},
)
MEMORY = 2**30  # bytes that a reader of these few kilobytes may ask for


def csv(path, delimiter=",", decimal="."):
    rows = ((n / FS, VELOCITY[n], RECORD.channels["input"][n]) for n in range(N))
    text = "\n".join(delimiter.join(f"{x:.9e}" for x in row) for row in rows)
    path.write_text(
        delimiter.join(("time", "velocity", "input")) + "\n" + text.replace(".", decimal) + "\n"
    )


def mat(path, version, packed):
    nested = dict(RECORD.channels) if version == "4" else {"run": {"data": dict(RECORD.channels)}}
    scipy.io.savemat(path, nested, format=version, do_compression=packed)


def mat73(path):
    with h5py.File(path, "w", userblock_size=512) as file:
        group = file.create_group("run")
        group.attrs["MATLAB_class"] = np.bytes_("struct")
        item = group.create_dataset("velocity", data=VELOCITY[None, :])
        item.attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def plain_hdf5(path):
    with h5py.File(path, "w") as file:
        file.create_dataset("velocity", data=VELOCITY).attrs["unit"] = "m/s"


def tdms(path):
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(path) as writer:
        for role, samples in RECORD.channels.items():
            found = {"wf_increment": 1 / FS, "unit_string": RECORD.units[role]}
            writer.write_segment([nptdms.ChannelObject("Log", role, samples, found)])


def lvm(path):
    head = ["LabVIEW Measurement", "Separator\tTab", "Decimal_Separator\t.", "X_Columns\tNo",
            "***End_of_Header***", "Channels\t2", f"Samples\t{N}\t{N}", "Y_Unit_Label\tm/s\tV",
            f"Delta_X\t{1 / FS:.10f}\t{1 / FS:.10f}", "***End_of_Header***",
            "X_Value\tvelocity\tinput"]  # fmt: skip
    rows = [f"\t{v:.9e}\t{u:.9e}" for v, u in zip(*RECORD.channels.values(), strict=True)]
    path.write_text("\n".join(head + rows) + "\n")


def siemens(path):
    signal = {
        "x_values": {"start_value": 0.0, "increment": 1 / FS, "number_of_values": float(N)},
        "y_values": {"values": VELOCITY, "quantity": {"label": "m/s"}},
        "function_record": {"name": "Point1:+Z"},
    }
    scipy.io.savemat(path, {"Signal_0": signal})


def named_table(path):
    with h5py.File(path, "w") as file:
        data = file.create_dataset("data", data=np.stack(list(RECORD.channels.values())))
        data.attrs["channel_names"] = ["velocity", "input"]
        data.attrs["units"] = ["m/s", "V"]
        data.attrs["fs"] = FS


def wav(path, dtype, scale):
    scipy.io.wavfile.write(path, int(FS), np.round(VELOCITY * scale, 6).astype(dtype))


# Name to suffix, how it is written, and the path of the velocity in it.
FORMATS = {
    "npy": (".npy", lambda path: np.save(path, VELOCITY), "data"),
    "npz": (".npz", lambda path: np.savez(path, **RECORD.channels), "velocity"),
    "mat v4": (".mat", lambda path: mat(path, "4", False), "velocity"),
    "mat v5": (".mat", lambda path: mat(path, "5", False), "run.data.velocity"),
    "mat v7": (".mat", lambda path: mat(path, "5", True), "run.data.velocity"),
    "mat v7.3": (".mat", mat73, "run.velocity"),
    "hdf5": (".h5", plain_hdf5, "velocity"),
    "hdf5 with checksums": (".h5", lambda path: write_hdf5(path, RECORD), "velocity"),
    "csv": (".csv", csv, "velocity"),
    "csv of Europe": (".csv", lambda path: csv(path, ";", ","), "velocity"),
    "wav": (".wav", lambda path: wav(path, np.int16, 2**15), "channel"),
    "wav of floats": (".wav", lambda path: wav(path, np.float32, 1), "channel"),
    "uff": (".uff", lambda path: write_uff(path, RECORD), "velocity"),
    "uff, binary": (".uff", lambda path: write_uff(path, RECORD, binary=True), "velocity"),
    "tdms": (".tdms", tdms, "Log.velocity"),
    "lvm": (".lvm", lvm, "velocity"),
    "siemens": (".mat", siemens, "Signal_0.y_values.values"),
    "named table": (".h5", named_table, "velocity"),
}
WRITTEN: dict[str, bytes] = {}  # what each format's own library wrote, once

CUT, FLIP, INSERT, REMOVE, JUNK = "cut", "flip", "insert", "remove", "junk"
DAMAGE = st.one_of(
    st.tuples(st.just(CUT), st.integers(0)),
    st.tuples(
        st.just(FLIP),
        st.lists(st.tuples(st.integers(0), st.integers(1, 255)), min_size=1, max_size=4),
    ),
    st.tuples(st.just(INSERT), st.tuples(st.integers(0), st.binary(min_size=1, max_size=40))),
    st.tuples(st.just(REMOVE), st.tuples(st.integers(0), st.integers(1, 40))),
    st.tuples(st.just(JUNK), st.tuples(st.integers(0, 600), st.binary(max_size=600))),
)


def damaged(data, damage):
    """The bytes after the damage; places count round the end, so that any number is one."""
    how, what = damage
    if how == CUT:
        return data[: what % len(data)]
    if how == JUNK:
        kept, junk = what
        return data[:kept] + junk
    changed = bytearray(data)
    if how == FLIP:
        for place, bits in what:
            changed[place % len(data)] ^= bits
    elif how == INSERT:
        changed[what[0] % len(data) : what[0] % len(data)] = what[1]
    else:
        place = what[0] % len(data)
        del changed[place : place + what[1]]
    return bytes(changed)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzzed")


@pytest.fixture(autouse=True)
def _little_memory():
    """A limit on the address space, a little above what the process has now."""
    if sys.platform != "linux":
        yield
        return
    import resource

    before = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + MEMORY, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, before)


def written(name, folder):
    suffix, write, _ = FORMATS[name]
    if name not in WRITTEN:
        path = folder / f"whole{suffix}"
        path.unlink(missing_ok=True)  # universal files are appended to
        write(path)
        WRITTEN[name] = path.read_bytes()
    return WRITTEN[name]


def found_in(name, folder, data):
    """The record that a file of these bytes gives, or None where it is refused by its name."""
    suffix, _, channel = FORMATS[name]
    path = folder / f"record{suffix}"
    path.unlink(missing_ok=True)  # an array that is mapped must not change under its reader
    path.write_bytes(data)
    roles = {"velocity": channel, **({"time": "time"} if suffix == ".csv" else {})}
    fs = None if suffix == ".csv" else FS
    refused = None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            (found,) = read(path, roles, {"velocity": "m/s"}, fs=fs, scale={"velocity": 1.0})
        except JbwError as error:
            found, refused = None, error
    if refused is not None:
        assert path.name in refused.what
        assert "MemoryError" not in refused.what
    return found


def lines_touched(data, damage):
    """Lines of a text that a damage lies in: these may be lost with their samples."""
    how, what = damage
    places = [place for place, _ in what] if how == FLIP else [what[0]]
    more = what[1] if how == REMOVE else 0
    begin = [data.count(b"\n", 0, place % len(data)) for place in places]
    return sum(2 + data.count(b"\n", place % len(data), place % len(data) + more)
               for place, _ in zip(places, begin, strict=True))  # fmt: skip


def look(name, folder, damage):
    """Damage a file, and require that it is whole as far as can be told, or refused."""
    data = written(name, folder)
    record = found_in(name, folder, damaged(data, damage))
    if record is None or damage[0] == JUNK:
        return
    velocity = record.channels["velocity"]
    assert np.isfinite(velocity).all()
    if name == "lvm":  # which says how many samples there are
        assert damage[0] != CUT or len(velocity) == N
        assert damage[0] in (CUT, INSERT) or len(velocity) >= N - lines_touched(data, damage)
        return
    if name.startswith("csv"):
        if damage[0] == CUT:  # at the end of a line a text is as good as whole
            rows = data[: damage[1] % len(data)].count(b"\n")
            assert rows - 1 <= len(velocity) <= rows
            np.testing.assert_allclose(velocity, VELOCITY[: len(velocity)], rtol=1e-9)
        elif damage[0] != INSERT:
            assert len(velocity) >= N - lines_touched(data, damage)
        return
    if damage[0] == CUT:
        whole = found_in(name, folder, data)
        assert whole is not None
        np.testing.assert_array_equal(velocity, whole.channels["velocity"])
    elif damage[0] == FLIP and name == "tdms":  # of another type: several chunks of as many bytes
        assert len(velocity) % N == 0
    elif damage[0] == FLIP:
        assert len(velocity) == N


@pytest.mark.fault(46, 54)
@pytest.mark.parametrize("name", FORMATS)
@settings(max_examples=60, deadline=5000, suppress_health_check=list(HealthCheck))
@given(damage=DAMAGE)
# A type of samples that does not exist, a class of another kind, and 2**29 fields of a struct.
@example(damage=(FLIP, [(336, 1)]))
@example(damage=(FLIP, [(304, 3)]))
@example(damage=(FLIP, [(163, 32)]))
# In HDF5 the type of an attribute, the heap of texts, and fewer samples in the header than stored.
@example(damage=(FLIP, [(1177, 2)]))
@example(damage=(FLIP, [(2057, 2)]))
@example(damage=(FLIP, [(1576, 32)]))
@example(damage=(FLIP, [(62, 8)]))
# A line of a table that is broken, and one joined to the next.
@example(damage=(FLIP, [(500, 64)]))
@example(damage=(REMOVE, (68, 1)))
# The flag that a segment has metadata of its own.
@example(damage=(FLIP, [(1606, 2)]))
# Where its samples begin.
@example(damage=(FLIP, [(21, 1)]))
# A WAV's samples declared half a sample short, and one.
@example(damage=(FLIP, [(40, 63)]))
@example(damage=(FLIP, [(40, 62)]))
def test_damage_is_refused_or_without_consequence(folder, name, damage):
    look(name, folder, damage)


@pytest.mark.release  # the same with fewer examples stands above
@pytest.mark.fault(46, 54)
@pytest.mark.parametrize("name", FORMATS)
@settings(
    max_examples=3000, deadline=5000, derandomize=True, suppress_health_check=list(HealthCheck)
)
@given(damage=DAMAGE)
def test_much_damage_is_refused_or_without_consequence(folder, name, damage):
    look(name, folder, damage)


@pytest.mark.fault(46)
@pytest.mark.parametrize("name", FORMATS)
def test_a_file_cut_anywhere_never_gives_other_samples(folder, name):
    size = len(written(name, folder))
    for kept in (*random.Random(0).sample(range(size), min(size, 60)), size - 1, size - 2):
        look(name, folder, (CUT, kept))


@pytest.mark.fault(51, 54)
@settings(max_examples=100, deadline=5000, suppress_health_check=list(HealthCheck))
@given(
    suffix=st.sampled_from([".pkl", ".npy", ".npz", ".mat", ".h5", ".csv", ".wav", ".uff",
                            ".tdms", ".txt", ".xyz", ""]),
    junk=st.binary(max_size=2000),
)  # fmt: skip
def test_junk_is_refused_by_its_name(folder, suffix, junk):
    path = folder / f"junk{suffix}"
    path.write_bytes(junk)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(JbwError) as caught:
            read(path, {"velocity": "velocity"}, {"velocity": "m/s"}, fs=FS)
    assert path.name in caught.value.what
