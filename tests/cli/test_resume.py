"""Runs that are killed, torn and interrupted, and end as if nothing had happened."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from jbw.cli import run
from jbw.results.run import RunSummary
from jbw.study import resumable

sys.path.insert(0, str(Path(__file__).parents[1] / "study"))
from damper_campaign import write_campaign

# Chains, which take so many steps that there is time to die; points weighed in rounds are gone on
# from in tests/inference/test_amis.py.
SETTINGS = 'num_samples = 1000\nsubsteps = 1\nsampler = "elliptical_slice"'
# Chunks of moments instead of seconds, no figures, and a death at a checkpoint if one is asked for.
DRIVER = """
import os, signal, sys
from jbw.cli.progress import prepare_process
prepare_process()
from jbw.inference.samplers import chunked_run as growing
from jbw.run import checkpoints
from jbw.report import figures, page

growing.CHUNK_S, checkpoints.EVERY_S, checkpoints.COST = 0.02, 0.0, 1.0
figures.draw_figures = lambda *_: None
page.write_page = lambda *of: of[2].write_text("page")
death, count, write = os.environ.get("DEATH"), 0, checkpoints.write_whole

def write_and_die(path, content):
    global count
    count += 1
    if f"torn {count}" == death:
        path.write_bytes(content[: len(content) // 2])
        os.kill(os.getpid(), signal.SIGKILL)
    write(path, content)
    if f"whole {count}" == death:
        os.kill(os.getpid(), signal.SIGKILL)

checkpoints.write_whole = write_and_die
from jbw.cli import main
main(sys.argv[1:])
"""


def start(*arguments, death=""):
    return subprocess.Popen(
        [sys.executable, "-c", DRIVER, *map(str, arguments)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "DEATH": death},
    )  # fmt: skip


def ended(*arguments, death=""):
    """Exit code and stderr of a process that is left alone."""
    process = start(*arguments, death=death)
    _, said = process.communicate(timeout=300)
    return process.returncode, said


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    folder = tmp_path_factory.mktemp("campaign")
    return write_campaign(folder, 5e-3, settings=SETTINGS)


@pytest.fixture(scope="module")
def whole(campaign):
    """The folder of a run without a break."""
    folder = campaign.parent / "whole"
    code, said = ended("identify", campaign, "--out", folder)
    assert code in (0, 4), said
    return folder


def assert_same_run(folder, whole):
    """Every number of two results is the same, to the last bit."""
    with (
        xr.open_datatree(folder / "posterior.nc", engine="h5netcdf") as found,
        xr.open_datatree(whole / "posterior.nc", engine="h5netcdf") as expected,
    ):
        assert found.groups == expected.groups
        for group in expected.groups:
            for name, values in expected[group].to_dataset().data_vars.items():
                np.testing.assert_array_equal(found[group][name], values, err_msg=str(name))
    names = {"posterior.nc", "summary.json", "report.html"}
    assert {path.name for path in folder.iterdir()} == names


@pytest.mark.fault(40, 41, 43, 44)
@pytest.mark.slow
def test_a_run_survives_kills_a_torn_checkpoint_and_ctrl_c(campaign, whole, tmp_path, capsys):
    folder = tmp_path / "run"
    assert ended("identify", campaign, "--out", folder, death="torn 4")[0] == -signal.SIGKILL
    code, said = ended("resume", folder, death="whole 3")
    assert code == -signal.SIGKILL
    assert "the previous checkpoint is used" in said

    process = start("resume", folder)
    chains = [folder / ".run" / f"joint.{i}.checkpoint" for i in (0, 1)]
    before = [path.stat().st_mtime_ns for path in chains]
    while process.poll() is None and [path.stat().st_mtime_ns for path in chains] == before:
        time.sleep(0.005)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=120)
    assert process.returncode == 5, said
    assert f"continue: jbw resume {folder}" in said

    text = campaign.read_text()
    campaign.write_text(text.replace("num_samples = 1000", "num_samples = 999"))
    assert run(["resume", str(folder)]) == 2
    assert "'num_samples = 1000' and is 'num_samples = 999'" in capsys.readouterr().err
    campaign.write_text(text)
    data = campaign.parent / "loop_1.h5"
    content = data.read_bytes()
    data.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    assert run(["resume", str(folder)]) == 3
    assert "loop_1.h5 changed" in capsys.readouterr().err
    data.write_bytes(content)
    assert run(["identify", str(campaign), "--out", str(folder)]) == 1
    assert f"jbw resume {folder}" in capsys.readouterr().err

    code, said = ended("resume", folder)
    assert code in (0, 4), said
    assert_same_run(folder, whole)
    assert run(["resume", str(folder)]) == 0
    assert "is finished" in capsys.readouterr().out


def test_a_run_that_cannot_begin_leaves_no_folder(tmp_path, capsys):
    out = tmp_path / "run"
    assert run(["identify", str(tmp_path / "none.toml"), "--out", str(out)]) == 2
    assert "none.toml" in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.fault(41)
def test_a_demo_goes_on_from_its_first_second(tmp_path, monkeypatch, capsys):
    asked = []

    def measure(preset, *, seed):
        asked.append((preset, seed))
        raise KeyboardInterrupt

    monkeypatch.setattr("jbw.rig.measure", measure)
    assert run(["demo", "--out", str(tmp_path / "run"), "--preset", "paper", "--seed", "7"]) == 5
    assert f"jbw resume {tmp_path / 'run'}" in capsys.readouterr().err
    assert run(["resume", str(tmp_path / "run")]) == 5
    assert asked == [("paper", 7)] * 2


def test_a_failed_report_is_tried_again_by_its_command(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(resumable, "identified", lambda run, say: (xr.DataTree(), RunSummary()))
    monkeypatch.setattr("jbw.report.page.write_page", lambda *_: 1 / 0)
    out = tmp_path / "run"
    (tmp_path / "x.toml").touch()
    assert run(["identify", str(tmp_path / "x.toml"), "--out", str(out)]) == 1
    assert f"jbw report {out}" in capsys.readouterr().err
    assert {path.name for path in out.iterdir()} == {"posterior.nc", "summary.json"}
    assert run(["resume", str(out)]) == 0
    assert f"to write its report: jbw report {out}" in capsys.readouterr().out


@pytest.mark.fault(40)
@pytest.mark.release
def test_twenty_kills_at_random_moments_change_no_bit(campaign, whole, tmp_path):
    moments, kills, finished, folder = random.Random(0), 0, 0, tmp_path / "run"
    while kills < 20 or folder.exists():
        marks = (folder / ".run" / "manifest.json", folder / "summary.json")
        began = any(mark.exists() for mark in marks)
        arguments = ("resume", folder) if began else ("identify", campaign, "--out", folder)
        process = start(*arguments)
        try:
            moment = moments.uniform(1.0, 9.0) if kills < 20 else None
            _, said = process.communicate(timeout=moment)
            assert process.returncode in (0, 4), said
            assert_same_run(folder, whole)
            folder.rename(tmp_path / f"finished_{finished}")
            finished += 1
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            kills += 1
