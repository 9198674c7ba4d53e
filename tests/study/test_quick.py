"""A first answer: the fit with the Gaussian about it, as a run folder that can be gone on with."""

import json
import shutil

import numpy as np
import pytest
import toy_campaign
from finished import finished

import jbw
from jbw.cli import run

pytestmark = pytest.mark.slow


def answer(folder):
    """The toy campaign, with its first answer in `quick`."""
    campaign = toy_campaign.write_toy(folder, toy_campaign.PLAIN)
    out = folder / "quick"
    asked = ["identify", str(campaign), "--quick", "--brief", "--seed", "1", "--out", str(out)]
    assert run(asked) == 0


@pytest.fixture(scope="module")
def quick():
    """The folder of the first answer, made once for a state of the source; only read."""
    return finished("quick", answer)


@pytest.fixture
def again(quick, tmp_path):
    """A copy of it, to be written over; its campaign file stays where it was."""
    shutil.copytree(quick / "quick", tmp_path / "quick")
    return tmp_path / "quick"


def summary_of(folder):
    return json.loads((folder / "summary.json").read_text(encoding="utf-8"))


def test_a_first_answer_has_parameters_and_bands_and_is_not_assessed(quick):
    summary = summary_of(quick / "quick")
    assert summary["verdict"]["status"] == "not assessed"
    assert [one["code"] for one in summary["verdict"]["findings"]] == ["not_sampled"]
    rows = summary["steps"]["joint"]["parameters"]
    for name, true in toy_campaign.TRUTH.items():
        if name in rows:  # five parameters at 99 %: a wrong one in twenty runs of a right interval
            assert rows[name]["q005"] < true < rows[name]["q995"], name
            assert rows[name]["r_hat"] is None
    study = jbw.load_study(quick / "quick")
    curve = study.tree["verification/backbone"]
    assert curve["frequency"].dims == ("quantile", "amplitude")
    low, middle, high = curve["damping"].values
    assert np.all((low <= middle) & (middle <= high))
    assert "no other test is predicted yet" in " ".join(summary["opening"])


def test_a_brief_lies_beside_the_answer_where_it_was_asked_for(quick):
    assert (quick / "quick" / "brief.pdf").read_bytes().startswith(b"%PDF")


def test_intervals_are_those_of_the_posterior(quick, toy):
    """Beside the finished run of the same campaign, drawn by importance sampling of 200 draws."""
    rows = summary_of(quick / "quick")["steps"]["joint"]["parameters"]
    drawn = summary_of(toy / "run")["steps"]["joint"]["parameters"]
    for name in toy_campaign.TRUTH:
        if name in drawn:
            ratio = rows[name]["sd"] / drawn[name]["sd"]
            # A standard deviation of 200 draws is known to 5 %: 3.5 of these, and a tenth for what
            # the posterior bends.
            assert ratio == pytest.approx(1.0, abs=0.28), name
            apart = abs(rows[name]["mean"] - drawn[name]["mean"]) / drawn[name]["sd"]
            assert apart < 0.5, name


def test_its_report_and_its_exports_can_be_written(quick, tmp_path):
    assert run(["report", str(quick / "quick"), "--out", str(tmp_path / "page.html")]) == 0
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "not assessed" in page
    assert run(["export", str(quick / "quick"), "--out", str(tmp_path / "export")]) == 0
    assert (tmp_path / "export" / "parameters.csv").is_file()


def test_the_same_command_takes_its_place_and_strict_ends_with_4(quick, again):
    before = summary_of(again)["steps"]["joint"]["parameters"]["zeta"]
    asked = ["identify", str(quick / "campaign.toml"), "--quick", "--strict", "--seed", "1"]
    assert run([*asked, "--out", str(again)]) == 4
    assert summary_of(again)["steps"]["joint"]["parameters"]["zeta"] == before


def test_a_folder_with_more_than_a_first_answer_is_left_alone(quick, again, capsys):
    (again / "notes.txt").write_text("mine", encoding="utf-8")
    assert run(["identify", str(quick / "campaign.toml"), "--out", str(again)]) == 1
    assert "jbw resume" in capsys.readouterr().err
    assert "quick" in summary_of(again)


def test_resume_draws_the_posterior_of_a_first_answer(again, toy, capsys):
    assert run(["resume", str(again)]) in (0, 4)
    assert (
        "Identified from the fit alone (the posterior is not assessed): " in capsys.readouterr().err
    )
    rows = summary_of(again)["steps"]["joint"]["parameters"]
    assert rows == summary_of(toy / "run")["steps"]["joint"]["parameters"]
    assert "quick" not in summary_of(again)
    assert (again / "report.html").is_file()
    assert not (again / ".run").exists()
