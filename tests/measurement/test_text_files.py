"""Text columns in their dialects; what could be misread is refused."""

import contextlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tone_file import DRIVE, FS, LASER, ROLES, UNITS, UNITS_V, N, T, refused

from jbw.errors import JbwError
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
    ["1.5\n2.5\n3.5\n", "1,5\n2,5\n3,5\n", '"1,5","2,5"\n"1,6","2,6"\n', "a;b\n1.234,5;2\n", "hi"],
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
