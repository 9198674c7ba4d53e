"""All tests fitted for use, beside what the law was worth on those that were held out before."""

import json

import numpy as np
import pytest
import toy_campaign
import xarray as xr
from finished import finished

import jbw
from jbw.campaign.load import Campaign
from jbw.campaign.settings import Identify
from jbw.cli import run
from jbw.inference.posterior.finding import Finding, judge
from jbw.report.opening import opening
from jbw.report.tables import table_of_tests
from jbw.study.finishing import adequate_as, for_use
from jbw.study.study import Study


def finding(code, status, reason=""):
    return Finding(code, status, reason or code, float("nan"))


def test_the_held_out_answer_decides_on_the_model_and_the_last_fit_on_all_else():
    held = judge([finding("r_hat", "failed"), finding("held_out_coverage", "failed")])
    final = judge([finding("r_hat", "ok"), finding("at_bound", "ok")])
    verdict = adequate_as(held, final)
    statuses = {one.code: one.status for one in verdict.findings}
    assert statuses == {"r_hat": "ok", "at_bound": "ok", "held_out_coverage": "failed"}
    assert verdict.status == "failed"


def test_of_one_finding_the_worse_answer_counts_and_of_equal_ones_the_held_out():
    held = judge([finding("misfit", "ok"), finding("chi_square", "usable", "before")])
    final = judge([finding("misfit", "failed"), finding("chi_square", "usable", "after")])
    reasons = {one.code: (one.status, one.reason) for one in adequate_as(held, final).findings}
    assert reasons == {"misfit": ("failed", "misfit"), "chi_square": ("usable", "before")}


def answer_of(campaign, kept):
    """An answer whose numbers tell which tests were fitted for it."""
    every = campaign.settings.hold_out == ()
    kept("joint")
    rows = {"weak": {"fitted": True, "nrmse": 0.01}, "strong": {"fitted": every, "nrmse": 0.02}}
    record = {
        "predictions": rows,
        "verdict": judge([finding("r_hat", "usable" if every else "ok")]).stored().plain(),
        "main": "joint",
        "steps": {"joint": {"parameters": {"zeta": {"mean": 2.0 if every else 1.0}}}},
        "wall_time_s": 3.0 if every else 5.0,
    }
    return Study(xr.DataTree(), record)


def campaign_of(**settings):
    """Of no test: what is fitted is told by the settings alone."""
    return Campaign("toy", None, (), settings=Identify(**settings))


def answered(campaign):
    places, said = [], []
    return for_use(answer_of, campaign, places.append, said.append), places, said


def test_the_answer_for_use_keeps_what_was_held_out_beside_the_parameters_of_all():
    campaign = campaign_of(hold_out=("strong",))
    study, places, _ = answered(campaign)
    assert places == ["joint", "final_joint"]  # a checkpoint of its own for each
    assert study.record["held_out_answer"] == {
        "verdict": "ok",
        "predictions": {"strong": {"fitted": False, "nrmse": 0.02}},
        "parameters": {"zeta": {"mean": 1.0}},
    }
    assert study.record["steps"]["joint"]["parameters"] == {"zeta": {"mean": 2.0}}
    assert study.record["wall_time_s"] == 8.0
    assert study.verdict.status == "usable"


def test_where_nothing_is_held_out_one_answer_is_all():
    study, places, said = answered(campaign_of())
    assert places == ["joint"]
    assert "held_out_answer" not in study.record
    assert said == ["No test is held out: this result uses all tests."]


def final_run(folder):
    campaign = toy_campaign.write_toy(folder, toy_campaign.PLAIN)
    out = folder / "run"
    assert run(["identify", str(campaign), "--final", "--seed", "1", "--out", str(out)]) in (0, 4)


@pytest.fixture(scope="module")
def final():
    """The toy campaign, identified for use."""
    return finished("final", final_run) / "run"


@pytest.mark.slow
def test_every_test_is_fitted_and_the_held_out_answer_stays(final, toy):
    summary = json.loads((final / "summary.json").read_text(encoding="utf-8"))
    before = json.loads((toy / "run" / "summary.json").read_text(encoding="utf-8"))
    assert {row["test"]: row["fitted"] for row in summary["tests"]} == {
        "weak": 3, "strong": 3, "pull": 2
    }  # fmt: skip
    # The same tests, draws and seed as without --final.
    held_out = {n: row for n, row in before["predictions"].items() if not row["fitted"]}
    assert set(summary["held_out_answer"]["predictions"]) == set(held_out)
    for name, row in held_out.items():
        again = summary["held_out_answer"]["predictions"][name]
        assert again["nrmse"] == pytest.approx(row["nrmse"], rel=1e-6)
    rows, rows_before = (one["steps"]["joint"]["parameters"] for one in (summary, before))
    # Three repeats of both levels in place of two of one: no interval is wider.
    for name in ("omega_n", "alpha_delta", "alpha_gamma"):
        assert rows[name]["sd"] < rows_before[name]["sd"]
    for name, true in toy_campaign.TRUTH.items():
        if name in rows:
            assert rows[name]["q005"] < true < rows[name]["q995"], name


@pytest.mark.slow
def test_the_report_tells_both(final):
    study = jbw.load_study(final)
    text = " ".join(opening(study.result, study.tree))
    assert "the held-out test" in text
    assert "After this check, the held-out tests were included in the fit." in text
    headings = [str(section.heading) for section in table_of_tests(study.result).sections]
    assert headings == [
        "Fitted (3 tests)",
        "Tests that were held out from the earlier fit (1 test)",
        "Each kind of test, predicted from the other kinds",
    ]
    codes = {one.code for one in study.verdict.findings}
    assert "held_out_coverage" in codes
    assert np.isfinite(study.record["held_out_answer"]["predictions"]["weak"]["nrmse"])
