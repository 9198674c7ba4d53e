"""The log of a watch: whole lines, and what a crash cut off set aside."""

import json
import os

import pytest

import jbw
from jbw.report.messages.watch import torn_line
from jbw.watch.watch import TORN, append, locked_log, read_log, set_aside

ENTRIES = [{"kind": "settings", "false_alarms": 1e-3}, {"kind": "reading", "record": "Größe"}]


@pytest.fixture
def path(tmp_path):
    with locked_log(tmp_path) as path:
        for entry in ENTRIES:
            append(path, entry)
    return path


def test_entries_are_read_as_they_were_appended(path):
    assert read_log(path) == ENTRIES
    assert path.read_bytes().count(b"\n") == 2
    assert set_aside(path) is None
    assert read_log(path.with_name("none")) == []


def test_a_last_line_cut_by_a_crash_is_set_aside_and_told(path):
    uncut = path.read_bytes()
    line = json.dumps({"kind": "reading", "record": "third"}).encode() + b"\n"
    for length in range(1, len(line)):
        path.write_bytes(uncut + line[:length])
        warning = set_aside(path)
        assert warning is not None
        assert warning == torn_line(str(path), length, str(path.with_name(TORN)))
        assert path.read_bytes() == uncut
        assert path.with_name(TORN).read_bytes() == line[:length] + b"\n"
        path.with_name(TORN).unlink()


def test_several_torn_lines_are_all_kept(path):
    for part in (b'{"kind": "rea', b'{"ki'):
        with path.open("ab") as stream:
            stream.write(part)
        set_aside(path)
    assert path.with_name(TORN).read_bytes() == b'{"kind": "rea\n{"ki\n'


@pytest.mark.parametrize("line", [b"no json", b"[1]", b'{"kind": 3}', b"{}", b"\xff\xfe", b""])
def test_a_damaged_line_before_the_last_is_refused(path, line):
    first, rest = path.read_bytes().split(b"\n", 1)
    path.write_bytes(first + b"\n" + line + b"\n" + rest)
    with pytest.raises(jbw.RunError, match=r"Line 2 of .* is not valid in the log of a watch"):
        read_log(path)


def test_a_disk_that_takes_half_a_line_is_told_and_repaired(path, monkeypatch):
    write = os.write
    monkeypatch.setattr(os, "write", lambda handle, content: write(handle, content[:7]))
    with pytest.raises(jbw.RunError, match="only 7 of"):
        append(path, {"kind": "reading"})
    monkeypatch.undo()
    warning = set_aside(path)
    assert warning is not None
    assert read_log(path) == ENTRIES


def test_numbers_that_json_does_not_know_are_never_written(path):
    with pytest.raises(ValueError, match="not JSON compliant"):
        append(path, {"kind": "reading", "squared": float("nan")})
    assert read_log(path) == ENTRIES


def test_two_processes_do_not_write_at_once(path, tmp_path):
    """A lock of another open file, which the system keeps apart as that of another process."""
    with (
        locked_log(tmp_path),
        pytest.raises(jbw.RunError, match="Another process"),
        locked_log(tmp_path),
    ):
        pass
