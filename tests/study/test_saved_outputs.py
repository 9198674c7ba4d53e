"""Numbers outlive figures that fail, and a killed writer leaves nothing in the way."""

import signal
import subprocess
import sys

import pytest

from jbw.errors import RunError
from jbw.run import files
from jbw.study.store import claim, claimed, save_outputs

WRITER = """
import os, signal, sys
from pathlib import Path
from jbw.study import store

def write(path):
    path.write_text("half")
    if path.name == sys.argv[2]:
        os.kill(os.getpid(), signal.SIGKILL)

folder = store.claim(Path(sys.argv[1]))
store.save_outputs(folder, {"a.json": write, "b.nc": write}, {"c.png": write})
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no such signal on this system")
@pytest.mark.fault(40, 42)
@pytest.mark.parametrize(
    ("moment", "saved"), [("a.json", set()), ("b.nc", set()), ("c.png", {"a.json", "b.nc"})]
)
def test_a_killed_writer_leaves_numbers_whole_or_nothing(tmp_path, moment, saved):
    out = tmp_path / "out"
    killed = subprocess.run([sys.executable, "-c", WRITER, str(out), moment], check=False)
    assert killed.returncode == -signal.SIGKILL
    names = {path.name for path in out.iterdir()}
    (left,) = {name for name in names if name.startswith(".part-")}
    assert names - {left} == saved
    if not saved:  # the same command again is not refused, and cleans up
        save_outputs(claim(out), {"a.json": lambda path: path.write_text("whole")}, {})
        assert [path.name for path in out.iterdir()] == ["a.json"]


@pytest.mark.fault(42)
def test_a_figure_that_fails_costs_no_number(tmp_path):
    numbers = {"laws.json": lambda path: path.write_text("{}")}
    with pytest.raises(RunError, match=r"The figures in .* failed: ZeroDivisionError") as caught:
        save_outputs(tmp_path, numbers, {"laws.png": lambda _: 1 / 0})
    assert "laws.json are saved completely" in caught.value.why
    assert [path.name for path in tmp_path.iterdir()] == ["laws.json"]


@pytest.mark.fault(42)
def test_a_full_disk_is_said_before_any_work(tmp_path, monkeypatch):
    total, free = 2 * files.ROOM, files.ROOM - 1
    monkeypatch.setattr(files.shutil, "disk_usage", lambda _: (total, total - free, free))
    with pytest.raises(RunError, match=r"has 50 MB left, but a run may need 50 MB"):
        claim(tmp_path / "a" / "out")
    assert not list(tmp_path.iterdir())


def test_work_that_fails_before_it_writes_leaves_no_folder(tmp_path):
    with pytest.raises(ZeroDivisionError), claimed(tmp_path / "out"):
        _ = 1 / 0
    assert not (tmp_path / "out").exists()
