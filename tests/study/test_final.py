"""All tests fitted for use, beside what the law was worth on those that were held out before."""

import json

import numpy as np
import pytest
import toy_campaign
from finished import finished

import jbw
from jbw.cli import run
from jbw.inference.posterior.finding import Finding, judge
from jbw.report.opening import opening
from jbw.report.tables import table_of_tests
from jbw.study.final import adequate_as


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
    text = " ".join(opening(study.record, study.tree))
    assert "held out" in text
    assert "They are fitted now, for use." in text
    headings = [str(section.heading) for section in table_of_tests(study.record).sections]
    assert headings == [
        "Fitted (3 tests)",
        "Held out from the fit before (1 test)",
        "Each kind, predicted from the others",
    ]
    codes = {one.code for one in study.verdict.findings}
    assert "held_out_coverage" in codes
    assert np.isfinite(study.record["held_out_answer"]["predictions"]["weak"]["nrmse"])
