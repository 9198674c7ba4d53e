"""Faults of the place where jbw runs: disks, folders, encodings, displays."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from tiers import standing_for_all

from jbw.cli import run
from jbw.errors import RunError
from jbw.run.folder import begin
from jbw.run.manifest import Manifest

PACKAGE = Path(__file__).parents[2] / "jbw"
COMMAND = "import sys; from jbw.cli import main; main(sys.argv[1:])"


def called(*arguments, program=COMMAND, **environment):
    """A process of its own: its exit code, and what it printed as text."""
    ended = subprocess.run(
        [sys.executable, "-c", program, *map(str, arguments)],
        capture_output=True, check=False, timeout=120, env={**os.environ, **environment},
    )  # fmt: skip
    return ended.returncode, ended.stdout, ended.stderr.decode(errors="replace")


# --- row 42 ---

TOO_LITTLE_SPACE = """
import resource, sys
from pathlib import Path
from jbw.errors import RunError
from jbw.run.files import write_whole
path = Path(sys.argv[1])
write_whole(path, b"old")
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
try:
    write_whole(path, bytes(100_000))
except RunError as error:
    print(error)
"""


@pytest.mark.fault(42)
@pytest.mark.skipif(sys.platform == "win32", reason="limits of file sizes are for Unix")
def test_a_file_that_does_not_fit_leaves_the_old_one_whole(tmp_path):
    code, printed, stderr = called(tmp_path / "a.checkpoint", program=TOO_LITTLE_SPACE)
    assert code == 0, stderr
    message = printed.decode()
    assert f"{tmp_path / 'a.checkpoint'} cannot be written" in message
    assert "All files that were saved before are complete" in message
    assert "Free some space" in message
    assert (tmp_path / "a.checkpoint").read_bytes() == b"old"
    assert [path.name for path in tmp_path.iterdir()] == ["a.checkpoint"]


@pytest.mark.fault(42)
@pytest.mark.skipif(not Path("/proc/self").exists(), reason="/proc can be written by nobody")
def test_a_folder_that_cannot_be_written_is_said_before_the_work():
    with pytest.raises(RunError) as caught:
        begin(Path("/proc/jbw-run"), Manifest("jbw identify beam.toml", "/data/beam.toml"))
    assert "/proc/jbw-run cannot be written" in caught.value.what
    assert "--out" in caught.value.remedy


# --- rows 52, 56 ---

CAMPAIGN = """
[campaign]
name = "Prüfstand 振动"
[[test]]
name = "Rauschen ü"
kind = "noise"
files = "mess *.npz"
fs = 100.0
channels = { input = "u", velocity = "v" }
units = { input = "V", velocity = "m/s" }
"""


@pytest.fixture
def campaign(tmp_path):
    folder = tmp_path / "Prüfstand 振动"
    folder.mkdir()
    rng = np.random.default_rng(0)
    np.savez(folder / "mess ü.npz", u=rng.normal(size=2000), v=rng.normal(size=2000))
    (folder / "käm pagne.toml").write_text(CAMPAIGN, encoding="utf-8")
    return folder / "käm pagne.toml"


LOCALES = {
    "C": {"LC_ALL": "C"},
    "POSIX": {"LC_ALL": "POSIX", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"},
    "a pipe of Windows": {"PYTHONIOENCODING": "cp1252"},
}


@pytest.mark.fault(56)
@pytest.mark.parametrize("locale", standing_for_all(LOCALES, "POSIX", "a pipe of Windows"))
def test_other_scripts_spaces_and_locales(campaign, locale):
    environment = {"PYTHONIOENCODING": "", **LOCALES[locale]}
    code, printed, stderr = called("check", campaign, **environment)
    assert code == 0, stderr
    assert b"Rauschen" in printed
    code, printed, stderr = called("check", "--json", campaign, **environment)
    assert code == 0, stderr
    assert b'"repeats": 1' in printed
    code, _, stderr = called("check", campaign.parent / "nix ü.toml", **environment)
    assert code == 2
    assert "nix" in stderr
    assert "does not exist" in stderr
    assert "Internal error" not in stderr


@pytest.mark.fault(52)
@pytest.mark.parametrize(
    "name", ['"[/x]"', '"[red]<script>alert(1)</script>"', '"\\u001b[31m"', '"a\\nb"']
)
def test_names_steer_neither_table_nor_terminal(campaign, capsys, name):
    campaign.write_text(CAMPAIGN.replace('"Prüfstand 振动"', name), encoding="utf-8")
    code = run(["check", str(campaign)])
    streams = capsys.readouterr()
    if "\\" in name:
        assert code == 2
        assert "[campaign] name: must be printable, on one line" in streams.err
    else:
        assert code == 0
        assert f"Campaign {json.loads(name)}" in streams.out
    assert "\x1b" not in streams.out + streams.err


# --- row 57 ---


@pytest.mark.fault(57)
def test_no_figure_opens_a_window():
    code = "\n".join(path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.py"))
    assert "plt.show" not in code
    assert "import matplotlib.pyplot" not in code
    assert "from matplotlib import pyplot" not in code


# --- row 55 ---


@pytest.mark.fault(55)
def test_a_run_records_what_its_draws_depend_on(tmp_path):
    begin(tmp_path, Manifest("jbw identify beam.toml --seed 7", "/data/beam.toml", seed=7)).close()
    manifest = json.loads((tmp_path / ".run" / "manifest.json").read_text())
    assert manifest["seed"] == 7
    assert {"jbw", "jax", "jaxlib", "numpyro", "blackjax", "numpy"} <= set(manifest["versions"])
    assert set(manifest["machine"]) == {"name", "processors"}


def refused(capsys, *arguments):
    """Exit code and the one message of a command that refuses, without a traceback."""
    code = run([str(argument) for argument in arguments])
    stderr = capsys.readouterr().err
    assert "Traceback" not in stderr
    assert "Internal error" not in stderr
    return code, stderr


def test_a_folder_without_records_is_said_with_the_suffixes(tmp_path, capsys):
    (tmp_path / "notes.docx").write_bytes(b"none")
    code, stderr = refused(capsys, "init", tmp_path)
    assert code == 3
    assert "has no measurement file that can be read" in stderr
    assert ".mat" in stderr


def test_a_folder_that_may_not_be_read_is_said(tmp_path, capsys, monkeypatch):
    """Whoever runs the tests may read everything: the system's refusal is played."""

    def forbidden(self):
        raise PermissionError(13, "Permission denied", str(self))

    monkeypatch.setattr(Path, "iterdir", forbidden)
    code, stderr = refused(capsys, "init", tmp_path)
    assert code == 3
    assert f"Folder `{tmp_path}` cannot be read: Permission denied." in stderr
    assert "copy the records" in stderr


def test_a_folder_that_may_not_be_written_names_the_way_round(tmp_path, capsys, monkeypatch):
    t = np.arange(512) / 256.0
    np.savez(tmp_path / "sweep_1.npz", time=t, input=np.sin(t), velocity=np.cos(t))
    open_of_path = Path.open

    def forbidden(self, mode="r", *rest, **more):
        if mode == "xb":
            raise PermissionError(13, "Permission denied", str(self))
        return open_of_path(self, mode, *rest, **more)

    monkeypatch.setattr(Path, "open", forbidden)
    code, stderr = refused(capsys, "init", tmp_path)
    assert code == 1  # nothing that was typed is wrong
    assert f"jbw init --print {tmp_path}" in stderr
    assert run(["init", "--print", str(tmp_path)]) == 0


def test_ten_thousand_files_are_refused_without_reading_them(tmp_path, capsys, monkeypatch):
    for i in range(10_000):
        (tmp_path / f"take_{i}_left.npz").touch()
    monkeypatch.setattr("jbw.campaign.draft.opened", lambda path: pytest.fail("was read"))
    code, stderr = refused(capsys, "init", tmp_path)
    assert code == 3
    assert "10000 measurement files of 10000 names" in stderr
    assert "separate folder" in stderr


def test_ten_thousand_repeats_are_one_test(tmp_path, capsys):
    t = np.arange(64) / 256.0
    for i in range(10_000):
        (tmp_path / f"sweep_{i}.npz").touch()
    np.savez(tmp_path / "sweep_0.npz", time=t, input=np.sin(t), velocity=np.cos(t))
    assert run(["init", "--print", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert printed.count("[[test]]\n") == 1
    assert "10000 file(s)" in printed


def test_a_report_of_a_run_that_failed_names_what_finishes_it(tmp_path, capsys):
    folder = tmp_path / "my run"
    begin(folder, Manifest("jbw identify c.toml", "c.toml")).close()
    code, stderr = refused(capsys, "report", folder)
    assert code == 3
    assert f"jbw resume '{folder}'" in stderr
    (tmp_path / "empty").mkdir()
    code, stderr = refused(capsys, "report", tmp_path / "empty")
    assert code == 3
    assert "jbw identify CAMPAIGN.toml --out DIR" in stderr


def test_a_terminal_of_sixty_columns_and_none_at_all(monkeypatch):
    """Tables of a check: folded into the terminal's width, plain and whole in a file."""
    import io

    from rich.console import Console

    from jbw.cli import printing
    from jbw.report.table import table, words

    rows = [{"test": f"sweep_0p05V_day{i}_with_a_long_name", "what": "word " * 20} for i in (1, 2)]
    shown = table("Campaign", rows, words("test", "test"), words("what", "what", "left wrap"))
    for terminal in (True, False):
        stream = io.StringIO()
        screen = Console(file=stream, width=60, force_terminal=terminal, highlight=False)
        monkeypatch.setattr(printing, "console", lambda screen=screen: screen)
        printing.show(
            shown, "A sentence that is longer than sixty columns, as most of ours are: yes."
        )
        lines = stream.getvalue().splitlines()
        if terminal:
            visible = [re.sub(r"\x1b\[[\d;]*m", "", line) for line in lines]
            assert max(map(len, visible)) <= 60
        else:
            assert "\x1b" not in stream.getvalue()
            assert lines[-1].startswith("A sentence")
            assert lines[-1].endswith("yes.")


@pytest.mark.parametrize("command", ["check", "look", "identify", "identifiability"])
def test_a_folder_stands_for_the_campaign_file_in_it(command, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "my records"
    folder.mkdir()
    assert run([command, str(folder)]) == 2
    stderr = capsys.readouterr().err
    assert "must be a file, but it is a folder" in stderr
    assert f"jbw init '{folder}'" in stderr
    assert "Loading" not in stderr
    np.savetxt(folder / "noise.csv", np.ones((64, 3)), delimiter=",", header="t,u,v", comments="")
    assert run(["init", str(folder)]) == 0  # the remedy, as it is typed
    capsys.readouterr()
    (folder / "campaign.toml").write_text("[campaign]\nname = 3\n")
    assert run([command, str(folder)]) == 2
    assert "name" in capsys.readouterr().err  # the file was read
    (folder / "campaign.toml").rename(folder / "a.toml")
    (folder / "b.toml").touch()
    assert run([command, str(folder)]) == 2
    assert f"Name the file in this folder: '{folder / 'a.toml'}'" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["my records"]  # and no run's folder


def test_a_campaign_file_without_permission_is_said_to_be_unreadable(tmp_path, capsys, monkeypatch):
    def denied(path):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "is_file", denied)
    assert run(["check", str(tmp_path / "campaign.toml")]) == 2
    assert "must be readable, but permission is denied" in capsys.readouterr().err
