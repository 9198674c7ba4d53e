"""Commands that take long go on where they were killed, by the same command, to equal numbers."""

import json
import signal
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import pytest
from tiers import standing_for_all

from jbw import parts
from jbw.cli import progress, run
from jbw.run.netcdf import read_tree

PLAN = """
[plan]
natural_hz = 18.8
delta = [270.0, 400.0]
noise = 50.0
noise_unit = "um/s"
gain = 15.0
joints = 2
[stepped]
levels = [0.02, 0.03, 0.04]
frequencies = [18.4, 18.8, 19.2]
dwell = 30.0
settle = 20.0
"""
# Kills itself where a part is whole, half a part is written, or pictures or the last numbers are
# begun; tells of every part that it makes and of everything that it finds.
KILLED = """
import os, signal, sys
from jbw import parts
from jbw.cli import run
from jbw.study import store

moment, put, pack, save = sys.argv[1], parts.put_whole, parts.pack, store._save
count = {"parts": 0, "outputs": 0}

def kill():
    sys.stdout.flush()
    os.kill(os.getpid(), signal.SIGKILL)

def put_part(path, content):
    count["parts"] += 1
    if moment == "half a part" and count["parts"] == 2:
        path.with_name(f"{path.name}.part").write_bytes(content[: len(content) // 2])
        kill()
    put(path, content)
    if moment == "a part":
        kill()

def made(*given):
    print("made a part", flush=True)
    return pack(*given)

def save_last(folder, outputs):
    count["outputs"] += 1
    if moment == "the end" and (count["outputs"] == 2 or "plan.json" in outputs):
        kill()
    save(folder, outputs)

parts.put_whole, parts.pack, store._save = put_part, made, save_last
sys.exit(run(sys.argv[2:]))
"""
COMMANDS = {
    "sbc": ["sbc", "--step", "linear", "--replications", "201"],
    "plan": ["plan", "plan.toml"],
}
# Moments of the kills, one process after the other, with the parts kept before and made by each.
KILLS = {"half a part": (0, 2), "a part": (1, 1), "the end": (2, 1)}
GOING_ON = "Continuing with {} saved part"


def killed(folder, command, moment):
    """What a process said before it killed itself."""
    words = [*COMMANDS[command], "--out", "out"]
    ended = subprocess.run(
        [sys.executable, "-c", KILLED, moment, *words],
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert ended.returncode == -signal.SIGKILL, ended.stderr
    return ended.stdout, ended.stderr


def saved(folder):
    """All numbers that were saved but for what clocks say, as JSON and as trees."""
    plain = {path.name: json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))}
    for record in plain.values():
        record.pop("wall_time_s", None)
    return plain, {path.name: read_tree(path) for path in sorted(folder.glob("*.nc"))}


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no such signal on this system")
@pytest.mark.fault(40)
@pytest.mark.parametrize("command", standing_for_all(COMMANDS, "sbc"))
def test_a_killed_command_goes_on_and_makes_no_finished_part_again(
    tmp_path, monkeypatch, capsys, command
):
    (tmp_path / "plan.toml").write_text(PLAN)
    for moment, (before, made) in KILLS.items():
        stdout, stderr = killed(tmp_path, command, moment)
        assert stdout.count("made a part") == made
        assert (GOING_ON.format(before) in stderr) == (before > 0)
    monkeypatch.setattr(progress, "prepare_process", lambda: None)
    monkeypatch.chdir(tmp_path)
    pack = Mock(wraps=parts.pack)
    monkeypatch.setattr(parts, "pack", pack)
    assert run([*COMMANDS[command], "--out", "out"]) == 0
    assert GOING_ON.format(3) in capsys.readouterr().err
    assert pack.call_count == 0
    assert run([*COMMANDS[command], "--out", "uninterrupted"]) == 0
    assert pack.call_count == 3
    (plain, trees), (plain_alone, trees_alone) = saved(Path("out")), saved(Path("uninterrupted"))
    assert plain == plain_alone
    assert trees.keys() == trees_alone.keys()
    assert all(trees[name].identical(trees_alone[name]) for name in trees)
    assert not list(Path("out").glob(".*"))
