"""Campaigns made by an integrator that shares nothing with jbw, identified with the defaults.

What the posterior and the verdict say of structures that the default law holds, of one without a
joint, and of one that no such law follows.
"""

import sys
from pathlib import Path

import pytest

import jbw

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from panel import CAMPAIGNS


def identified(name):
    campaign, truth = CAMPAIGNS[name].campaign()
    study = jbw.identify(campaign, seed=1, truth=truth)
    return study, truth, study.summary()


def failed(summary):
    return {one["code"] for one in summary["verdict"]["findings"] if one["status"] == "failed"}


@pytest.mark.release  # a further whole campaign
def test_a_hardening_joint_lies_in_the_default_box():
    study, truth, summary = identified("hardening")
    assert failed(summary) == set()
    posterior = study.tree["posterior"].to_dataset()
    for name, value in truth.items():
        # Six intervals of 99 %: four standard deviations leave a chance of 4e-4.
        z = (float(posterior[name].mean()) - value) / float(posterior[name].std())
        assert abs(z) < 4, name
    assert posterior.attrs.get("sampler", study.tree.attrs.get("sampler")) == "amis"


@pytest.mark.release  # test_linear_structure.py and test_look.py stand for it
def test_no_joint_is_seen_where_there_is_none_and_what_it_may_do_is_bounded():
    study, truth, summary = identified("linear")
    assert summary["verdict"]["answers"]["sampling"]["status"] == "ok"
    assert summary["verdict"]["answers"]["law"]["status"] == "ok"
    assert failed(summary) <= {"no_joint", "unidentified"}
    because = summary["verdict"]["answers"]["knowledge"]["because"]
    assert because.startswith("No joint is detected: ")
    assert "At 0.0031 m, the largest fitted motion" in because
    posterior = study.tree["posterior"].to_dataset()
    for name, value in truth.items():
        z = (float(posterior[name].mean()) - value) / float(posterior[name].std())
        assert abs(z) < 4, name


@pytest.mark.release
def test_no_record_is_argued_away_where_no_law_follows():
    """The strongest sweep of fifty sliders was once left with 106 %, by a line with 41."""
    _, _, summary = identified("fifty sliders")
    assert summary["verdict"]["answers"]["sampling"]["status"] == "ok"
    # Noise is 0.2 %, residuals of the fitted sweeps 2 %. The sweep between them is missed by more
    # than 1.5 times as much, and its band holds less than 95 % of it: no use within limits.
    law = summary["verdict"]["answers"]["law"]
    assert law["status"] == "failed"
    assert {"held_out_coverage", "coloured_residual"} <= failed(summary)
    assert "may be used" not in law["because"]
    predictions = summary["predictions"]
    assert predictions
    for name, one in predictions.items():
        # The law holds the linear oscillator: it may not fit worse, but for what noise makes of it.
        assert one["nrmse"] < 1.05 * one["nrmse_linear"], name
        assert 0.01 < one["nrmse"] < 0.05, name
