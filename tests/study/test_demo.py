"""The whole demonstration, as a user runs it."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from dialect import unreadable_units

import jbw
from jbw.cli import run

SAVED = 'study.save("run")'


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """The folder in which the demonstration was run."""
    folder = tmp_path_factory.mktemp("home")
    assert run(["demo", "--out", str(folder / "demo")]) == 0
    return folder


@pytest.mark.slow
def test_demo_of_three_days_finds_the_truth_with_bands_that_are_seen(home):
    summary = json.loads((home / "demo" / "summary.json").read_text())
    assert summary["verdict"]["status"] == "ok"
    joint = summary["steps"]["joint"]["parameters"]
    for name in ("omega_n", "zeta", "alpha", "delta", "gamma", "gain"):
        assert abs(joint[name]["z"]) < 4
    # The population's mean of three days that scatter by 0.18 and 3 %: their error is most of it.
    assert 0.1 < joint["omega_n"]["sd"] / (0.0018 * 118.1 / 3**0.5) < 3
    days = summary["steps"]["joint"]["runs"]["omega_n"]
    truth = json.loads((home / "demo" / "campaign" / "truth.json").read_text())["days"]
    for day, (name, row) in zip(truth, sorted(days.items()), strict=True):
        assert abs(row["mean"] - day["omega_n"]) < 4 * row["sd"], name
    assert {row["fitted"] for row in summary["predictions"].values()} == {True, False}
    for row in summary["predictions"].values():
        assert row["nrmse"] < 0.021  # noise of 2 %, and the model hardly adds to it
    assert (home / "demo" / "report.html").stat().st_size > 100_000
    assert not (home / "demo" / "figures").exists()  # none was asked for


@pytest.mark.release
def test_demo_of_the_paper_from_the_first_record_to_the_report(tmp_path, capsys):
    folder = tmp_path / "paper"
    assert run(["demo", "--paper", "--figures", "png", "--out", str(folder)]) == 0
    # Table 1, the paper's steps among its rows and the truth in a column.
    told = capsys.readouterr().out
    assert "truth" in told
    assert all(step in told for step in ("linear", "third_order_paper", "opening_paper"))
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["verdict"]["status"] == "ok"
    joint = summary["steps"]["joint"]["parameters"]
    for name in ("omega_n", "zeta", "alpha", "delta", "gamma", "gain"):
        assert joint[name]["r_hat"] < 1.01
        assert joint[name]["ess_bulk"] >= 400
        assert abs(joint[name]["z"]) < 4
    # Step 3 by the paper is expected to fail, and to say why.
    assert summary["steps"]["third_order_paper"]["verdict"]["status"] == "failed"
    assert any("alpha*delta" in s for s in summary["steps"]["third_order_paper"]["statements"])
    # 99 % bands over held-out repeats and levels never fitted, some of only ten values: four
    # standard errors of the share inside, and 0.5 % for the noise, which is itself estimated.
    for row in summary["predictions"].values():
        assert abs(row["coverage"] - 0.99) < 0.005 + 4 * (0.99 * 0.01 / row["num_values"]) ** 0.5
    assert {row["fitted"] for row in summary["predictions"].values()} == {True, False}
    for areas in summary["loops"].values():
        low, _, high = areas["model_area_viscous"]
        measured = areas["measured_area_viscous"][1]
        # Noise of the measured loop: 4 repeats of 16 s, differentiated; below 0.1 % of the area.
        assert 0.999 * low < measured < 1.001 * high
    with xr.open_datatree(folder / "posterior.nc", engine="h5netcdf") as tree:
        assert {"posterior", "sample_stats", "log_likelihood", "log_prior"} <= set(tree.children)
        assert unreadable_units(tree) == {}
    assert len(list((folder / "figures").glob("*.png"))) >= 10
    assert (folder / "report.html").stat().st_size > 100_000


@pytest.mark.slow
def test_the_python_of_the_readme_runs_on_the_demo(home, monkeypatch):
    text = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    (source,) = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    assert source.count(SAVED) == 1
    monkeypatch.chdir(home)
    names = executed(source, "README.md")
    assert names["study"].verdict.status == "ok"
    assert names["bands"].attrs["nrmse"] < 0.03  # its laser's noise is 2 % of each record
    assert (home / "run" / "report.html").exists()


def executed(source, name):
    """What Python of a page leaves; the command has just identified, a notebook does it itself."""
    assert "jbw.identify(campaign)" in source
    names = {}
    again = source.replace("jbw.identify(campaign)", 'jbw.load_study("demo")')
    exec(compile(again, name, "exec"), names)
    return names


@pytest.mark.slow
def test_each_step_of_its_page_runs_on_the_demo(home, monkeypatch):
    page = Path(__file__).parents[2] / "docs" / "howto" / "steps.md"
    (source,) = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    monkeypatch.chdir(home)
    # Its last step is the README's, which the test above takes: a page of figures is enough.
    assert source.count(SAVED) == 1
    names = executed(source.replace(SAVED, ""), page.name)
    assert names["study"].verdict.status == "ok"
    error = names["model"].v - names["sweep"].channels["velocity"]
    # The joint of the block is the rig's, its line fit's omega_n 7e-5 low.
    assert np.linalg.norm(error) < 0.2 * np.linalg.norm(names["sweep"].channels["velocity"])


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ["check", "demo/campaign/campaign.toml"],
        # Tests of many joints: test_plan_command.py has a plan of few.
        pytest.param(["plan", "demo"], marks=pytest.mark.release),
        ["predict", "demo", "--sweep", "10:25", "--level", "0.3"],
        ["export", "demo", "--mass", "2.5"],
        # The README's Python above writes this page, and test_storage.py has the command.
        pytest.param(["report", "demo"], marks=pytest.mark.release),
    ],
    ids=lambda words: words[0],
)
def test_the_commands_of_the_readme_run_on_the_demo(home, words, monkeypatch):
    monkeypatch.chdir(home)
    assert run(words) == 0


@pytest.mark.release  # test_quick.py compares the two of the toy campaign
def test_the_fit_alone_has_the_intervals_of_the_posterior(home):
    """Widths of 99 % intervals, of `--quick` and of the demonstration's own draws.

    The command's own folder and report are those of `test_quick.py`.
    """
    campaign = jbw.load_campaign(home / "demo" / "campaign" / "campaign.toml")
    answer = jbw.identify(campaign, quick=True, report=lambda _: None)
    quick = answer.record["steps"]["joint"]["parameters"]
    summary = json.loads((home / "demo" / "summary.json").read_text())
    drawn = summary["steps"]["joint"]["parameters"]
    for name, row in drawn.items():
        if row["kl"] is None:  # products and noise follow from the others
            continue
        ratio = (quick[name]["q995"] - quick[name]["q005"]) / (row["q995"] - row["q005"])
        # The ends of an interval of 4000 draws are known to 3 %, both times. The means of omega_n
        # and zeta over three days have the tails of Student's t with about two degrees of freedom,
        # where the ends of either interval scatter by some 15 %, and the Gaussians of a mixture are
        # straight; 1.24 and 0.83 were seen, and 0.4 with the one Gaussian of the fit.
        assert ratio == pytest.approx(1.0, abs=0.4 if name in ("omega_n", "zeta") else 0.12), name
        apart = abs(quick[name]["mean"] - row["mean"]) / row["sd"]
        assert apart < 0.25, name
