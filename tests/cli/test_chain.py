"""From a folder of MATLAB files that jbw has never seen to a report, by what each command names."""

import re
import shlex
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from jbw.cli import run
from jbw.cli.identify import ended
from jbw.results.run import StoredVerdict

sys.path.insert(0, str(Path(__file__).parents[1] / "study"))
from toy_campaign import FS, PLAIN, integrated, sweep

SIZE = 512
OFFERED = re.compile(r"^Next: (jbw .*?)(?:, |$)", re.M)
SETTINGS = "".join(line + "\n" for line in PLAIN.splitlines() if "hold_out" not in line and
                   "fit_" not in line)  # fmt: skip


def matlab_folder(folder):
    """Sweeps at two levels as MATLAB saves them: time, voltage and velocity as columns."""
    rng = np.random.default_rng(4)
    t = np.arange(SIZE) / FS
    for name, level in (("low", 0.3), ("high", 1.0)):
        u = sweep(level, SIZE)
        velocity = integrated(u, SIZE)[1]
        for i in (1, 2):
            noisy = velocity + 2e-3 * rng.standard_normal(SIZE)
            rows = {"t": t, "shaker": u(t), "velocity": noisy}
            savemat(folder / f"{name}_sweep_{i}.mat", {k: v[:, None] for k, v in rows.items()})
    return folder


def named_after(streams):
    """The command that the last line of a command names, and what it wrote."""
    assert streams.err.rstrip().splitlines()[-1].startswith("Next: jbw ")
    return OFFERED.findall(streams.err)[-1]


@pytest.mark.slow
def test_from_matlab_files_to_a_report_by_the_commands_that_are_named(
    tmp_path, monkeypatch, capsys
):
    folder = tmp_path / "measured in May"  # with blanks, as folders have them
    folder.mkdir()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "jbw.report.figures.draw_figures", lambda *_, **__: None
    )  # the page has its own
    command, ran = f"jbw init {shlex.quote(str(matlab_folder(folder)))}", []
    while "identify" not in ran and len(ran) < 6:
        words = shlex.split(command)[1:]
        ran.append(words[0])
        if words[0] == "identify":  # what a person may state, and what keeps this short
            text = (folder / "campaign.toml").read_text().replace("# [identify]", "[identify]")
            (folder / "campaign.toml").write_text(f"{text}\n{SETTINGS}")
        code = run(words)
        streams = capsys.readouterr()
        # Two hundred draws are too few for a verdict of ok; all before it are.
        assert code == (4 if words[0] == "identify" else 0), streams.err
        command = named_after(streams)
    assert ran == ["init", "check", "look", "identify"]
    page = Path(re.findall(r"^Report: (.*)$", streams.out, re.M)[-1])
    assert "What was identified" in page.read_text(encoding="utf-8")
    assert run(shlex.split(command)[1:]) == 0  # what it names last runs as well


@pytest.mark.parametrize(
    ("status", "code", "named"),
    [("ok", 0, "jbw predict 'a run'"), ("failed", 4, "jbw explain r_hat")],
)
def test_a_run_names_what_follows_its_verdict(capsys, status, code, named):
    finding = {"code": "r_hat", "status": status}
    verdict = StoredVerdict.read({"status": status, "findings": [finding]})
    assert ended(verdict, Path("a run")) == code
    assert named_after(capsys.readouterr()) == named


def test_a_check_that_fails_names_itself_after_the_change(tmp_path, capsys):
    t = np.arange(SIZE) / FS
    rows = {"t": t, "shaker": np.sin(t), "velocity": np.full(SIZE, np.nan)}
    savemat(tmp_path / "low_sweep_1.mat", rows)
    assert run(["init", str(tmp_path)]) == 0
    named = named_after(capsys.readouterr())
    assert run(shlex.split(named)[1:]) == 3
    assert named_after(capsys.readouterr()) == named
