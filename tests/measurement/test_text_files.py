"""Text columns in their dialects; what could be misread is refused."""

import contextlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tone_file import DRIVE, FS, LASER, ROLES, UNITS, UNITS_V, N, T, refused

from jbw.errors import ConfigError, JbwError
from jbw.measurement.files.csv import sniff
from jbw.measurement.files.read import read

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


@pytest.mark.fault(49)
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


@pytest.mark.fault(49)
@pytest.mark.parametrize(
    "text",
    ["1,5\n2,5\n3,5\n", '"1,5","2,5"\n"1,6","2,6"\n', "a;b\n1.234,5;2\n", "hi"],
)
def test_csv_that_could_be_misread_is_refused(tmp_path, text):
    path = tmp_path / "a.csv"
    path.write_text(text)
    error = refused(path, {"velocity": "column[0]"}, UNITS_V, fs=FS)
    assert "columns" in error.what
    assert "semicolon" in error.remedy


@pytest.mark.fault(46, 49)
def test_csv_with_a_broken_line(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("a,b\n" + "1.5,2.5\n" * 1000 + "1.5\n" + "1.5,2.5\n" * 1000)
    error = refused(path, {"velocity": "a"}, UNITS_V, fs=FS)
    assert "a.csv" in error.what
    assert "csv reader" in error.what


@pytest.mark.fault(46)
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


# --- units behind the names, and times that nobody named ---


def columns(path, header, *values, delimiter=","):
    rows = [delimiter.join(f"{x:.9e}" for x in row) for row in zip(*values, strict=True)]
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


MS = 1e3 * np.arange(512) / 1000.0
FORCE, SPEED = np.sin(0.1 * np.arange(512)), np.cos(0.1 * np.arange(512))


@pytest.mark.parametrize(
    ("header", "names"),
    [
        ("time [ms];force [kN];velocity [mm/s]", ("time", "force", "velocity")),
        ("Time (ms);Force (kN);Velocity (mm/s)", ("Time", "Force", "Velocity")),
        ('"t [ms]";"F1 [kN]";"Laser head (mm/s)"', ("t", "F1", "Laser head")),
    ],
)
def test_units_behind_the_names_are_read(tmp_path, header, names):
    path = columns(tmp_path / "a.csv", header, MS, FORCE, SPEED, delimiter=";")
    roles = dict(zip(("time", "force", "velocity"), names, strict=True))
    (record,) = read(path, roles)
    assert record.fs == 1000.0
    np.testing.assert_allclose(record.channels["force"], 1e3 * FORCE, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(record.channels["velocity"], 1e-3 * SPEED, rtol=1e-8, atol=1e-12)
    # The title as it stands there names the column as well.
    titles = [text.strip('"') for text in header.split(";")]
    (whole,) = read(path, dict(zip(roles, titles, strict=True)))
    np.testing.assert_array_equal(whole.channels["force"], record.channels["force"])


@pytest.mark.parametrize(("role", "unit"), [("time", "s"), ("force", "N")])
def test_a_unit_that_contradicts_the_header_is_refused(tmp_path, role, unit):
    path = columns(tmp_path / "a.csv", "time [ms],force [kN],velocity [mm/s]", MS, FORCE, SPEED)
    roles = {"time": "time", "force": "force", "velocity": "velocity"}
    error = refused(path, roles, {role: unit})
    assert f"role `{role}` has the unit `{unit}` in the campaign" in error.what


def test_an_unknown_unit_of_the_time_is_asked_for(tmp_path):
    path = columns(tmp_path / "a.csv", "time [ticks],velocity [mm/s]", MS, SPEED)
    with pytest.raises(ConfigError, match="Unit `ticks`"):
        read(path, {"time": "time", "velocity": "velocity"})


def test_brackets_that_hold_no_unit_belong_to_the_name(tmp_path):
    path = columns(tmp_path / "a.csv", "time [s],velocity (left)", MS / 1e3, SPEED)
    (record,) = read(path, {"time": "time", "velocity": "velocity (left)"}, UNITS_V)
    assert record.fs == 1000.0


def test_a_rate_against_an_unnamed_column_of_times_is_refused(tmp_path):
    rng = np.random.default_rng(0)
    even = np.arange(512) / 100.0
    jitter = np.cumsum(0.01 * (1 + 0.3 * rng.standard_normal(512)))
    roles = {"velocity": "velocity"}
    for time, fs, says in ((even, 99.0, "contradict 99 Hz"), (jitter, 100.0, "contradict 100 Hz")):
        path = columns(tmp_path / "a.csv", "Time (s),velocity", time, SPEED)
        error = refused(path, roles, UNITS_V, fs=fs)
        assert says in error.what
        assert 'time = "Time"' in error.remedy
    path = columns(tmp_path / "a.csv", "Time (s),velocity", even, SPEED)
    assert read(path, roles, UNITS_V, fs=100.0)[0].fs == 100.0
    # A column of another meaning speaks against nothing.
    path = columns(tmp_path / "a.csv", "uptime,velocity", 7 * even, SPEED)
    assert read(path, roles, UNITS_V, fs=100.0)[0].fs == 100.0


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_a_header_that_shares_its_line_with_the_first_row_is_refused(tmp_path, delimiter):
    path = tmp_path / "a.csv"
    columns(path, delimiter.join(["time", "force", "velocity"]), MS, FORCE, SPEED,
            delimiter=delimiter)  # fmt: skip
    path.write_text(path.read_text().replace("\n", "", 1))
    error = refused(path, {"velocity": "column[2]"}, UNITS_V, fs=FS)
    assert "its header and its first row share line 1" in error.what
