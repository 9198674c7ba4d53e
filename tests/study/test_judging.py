"""What errors and coverage of the tests say of a posterior whose chains are in order."""

import numpy as np
import pytest
import xarray as xr
from pasted import pasted

from jbw.report.messages import discrepancy as messages
from jbw.verification.verify import prediction_findings


def tree_of(**tests):
    groups = {f"/verification/{kind}": xr.Dataset(attrs=attrs) for kind, attrs in tests.items()}
    root = xr.Dataset(attrs={"laws": '["bouc_wen"]'})
    return xr.DataTree.from_dict({"/": root, **groups})


def findings(**tests):
    return {one.code: one for one in prediction_findings(tree_of(**tests))}


GOOD = {"nrmse": 0.01, "nrmse_linear": 0.2, "fitted": 1}


def test_a_joint_that_predicts_better_is_in_order():
    held = {**GOOD, "fitted": 0, "coverage": 0.985, "num_values": 1000}
    found = findings(**{"sweep/a": GOOD, "curve/b": held})
    assert {code: one.status for code, one in found.items()} == {
        "simpler_model": "ok",
        "held_out_coverage": "ok",
    }
    assert found["simpler_model"].number == pytest.approx(0.05)


def test_a_simpler_oscillator_that_predicts_better_is_named_with_its_error():
    # The Silverbox fitted by a joint alone: as good as the cubic oscillator where it was fitted.
    low = {"nrmse": 0.020, "nrmse_linear": 0.048, "nrmse_cubic": 0.0205, "fitted": 1}
    high = {"nrmse": 0.24, "nrmse_linear": 0.48, "nrmse_cubic": 0.062, "fitted": 0}
    assert findings(**{"sweep/low": low})["simpler_model"].status == "ok"
    found = findings(**{"sweep/low": low, "sweep/high": high})["simpler_model"]
    assert found.status == "failed"
    assert found.number == pytest.approx(0.24 / 0.062)
    assert (found.values["test"], found.values["kind"]) == ("high", "cubic")
    assert (found.values["error"], found.values["simpler"]) == (0.24, 0.062)
    assert pasted(found.action).laws == ("bouc_wen", "cubic")


def test_tests_outside_their_bands_fail_unless_fitted_or_short():
    outside = {"nrmse": 0.1, "coverage": 0.87, "num_values": 9766, "fitted": 0}
    found = findings(**{"sweep/high": outside})
    assert found["held_out_coverage"].status == "failed"
    assert found["held_out_coverage"].number == 0.87
    assert pasted(found["held_out_coverage"].action).settings.offsets == "runs"
    # Every decay has its own frequency, so that only another law may help there.
    action = findings(**{"decay/high": outside})["held_out_coverage"].action
    assert "offsets" not in action
    assert "jbw laws" in action
    assert "held_out_coverage" not in findings(**{"sweep/high": {**outside, "fitted": 1}})
    assert "held_out_coverage" not in findings(**{"sweep/high": {**outside, "num_values": 20}})
    assert "held_out_coverage" not in findings(**{"sweep/high": {**outside, "coverage": np.nan}})


def test_nothing_compared_says_nothing():
    assert findings() == {}
    assert findings(**{"frf/noise": {"level": 1.0}}) == {}


def test_a_joint_that_cannot_be_solved_is_no_better():
    bad = {"nrmse": np.nan, "nrmse_linear": 0.2, "fitted": 1}
    for tests in ({"sweep/a": bad, "curve/b": GOOD}, {"curve/b": GOOD, "sweep/a": bad}):
        assert findings(**tests)["simpler_model"].status == "failed"
    unknown = {"nrmse": 0.1, "nrmse_linear": np.nan, "fitted": 1}
    found = findings(**{"sweep/a": unknown, "curve/b": GOOD})["simpler_model"]
    assert found.number == pytest.approx(0.05)


def test_a_discrepancy_wider_than_a_linear_oscillators_error_refuses_the_law():
    # 2.576 standard deviations of 0.25, where a linear oscillator misses 0.2.
    wide = {**GOOD, "fitted": 0, "discrepancy": 1, "half_width": 0.644}
    found = findings(**{"sweep/wide": wide})["law_replaced"]
    assert found.status == "failed"
    assert found.number == pytest.approx(0.25 / 0.2, rel=1e-3)
    assert "come from the discrepancy, not from the law" in found.reason
    assert pasted(found.action).laws == ("bouc_wen", "cubic")
    assert findings(**{"sweep/a": {**wide, "half_width": 0.2}})["law_replaced"].status == "ok"
    # As bad as the linear oscillator, and wider than by noise as large as that error.
    bad = {**wide, "nrmse": 0.2, "half_width": 2.576 * 0.3}
    assert findings(**{"sweep/a": bad})["law_replaced"].status == "failed"
    by_noise = {**bad, "half_width": 2.576 * 0.25}
    assert findings(**{"sweep/a": by_noise})["law_replaced"].status == "ok"
    # Wide by noise alone, or where the joint hardly acts: nothing is said.
    assert "law_replaced" not in findings(**{"sweep/a": {**wide, "discrepancy": 0}})
    assert "law_replaced" not in findings(**{"sweep/a": {**wide, "nrmse_linear": 0.0105}})


def test_a_band_that_is_withheld_is_no_coverage_and_is_named():
    withheld = {"nrmse": 0.3, "fitted": 0, "discrepancy": 1, "withheld": 1}
    alone = findings(**{"decay/far": withheld})["held_out_coverage"]
    assert alone.status == "not assessed"
    assert alone.reason == messages.bands_withheld(["far"])
    assert alone.action == messages.FIT_THAT_LEVEL
    near = {**GOOD, "fitted": 0, "coverage": 0.985, "num_values": 1000}
    beside = findings(**{"decay/far": withheld, "decay/near": near})["held_out_coverage"]
    assert (beside.status, beside.number) == ("ok", 0.985)
    assert beside.reason.endswith(alone.reason)
    outside = findings(**{"decay/far": withheld, "decay/near": {**near, "coverage": 0.5}})
    assert outside["held_out_coverage"].reason.endswith(alone.reason)
