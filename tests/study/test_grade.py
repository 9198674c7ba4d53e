"""The grade of a law by held-out tests, and what it makes of the verdict."""

from itertools import product

import numpy as np
import pytest

from jbw.campaign.settings import Identify
from jbw.errors import ConfigError
from jbw.inference.posterior.finding import answers, checked, judge
from jbw.results.attributes import PredictedTest
from jbw.verification.grade import grade, judged

LAWS = ("bouc_wen",)
FITTED = PredictedTest(fitted=1, nrmse=0.02, nrmse_linear=0.3, group="sweep")


def seen(error, **more):
    """A held-out sweep of a thousand values, 99 % of them inside the bands."""
    like = {"nrmse_linear": 0.5, "coverage": 0.99, "num_values": 1000, "group": "sweep"}
    return PredictedTest.of_mapping({"fitted": 0, "nrmse": error, **like, **more})


def status(*tests, findings=(), limit=0.05):
    named = {"fitted": FITTED, **{f"test {i}": test for i, test in enumerate(tests)}}
    found = grade(named, LAWS, findings, limit)
    return None if found is None else found.status


def coloured(*, ok=False):
    return checked("coloured_residual", ok, "Coloured.", 0.4, "Another law.")


@pytest.mark.parametrize(
    ("tests", "expected"),
    [
        ([seen(0.04)], "ok"),
        ([seen(0.01), seen(0.099)], "usable"),  # rms 7 %
        ([*[seen(0.01)] * 4, seen(0.099)], "ok"),  # rms 4.5 %, none above 10 %
        ([*[seen(0.01)] * 5, seen(0.101)], "usable"),  # rms 4.2 %, but one above 10 %
        ([seen(0.24)], "usable"),
        ([seen(0.24, nrmse_linear=0.39)], "failed"),  # 0.62 of the linear oscillator's
        ([seen(0.26)], "failed"),
        ([seen(0.01, coverage=0.94)], "failed"),
        ([seen(0.01, coverage=0.94, num_values=40)], "ok"),  # too few values to tell
        ([seen(0.01), seen(0.01, coverage=0.93)], "ok"),  # 96 % together
        ([seen(0.01), seen(0.5, extrapolation=2.0)], "ok"),  # graded within the amplitudes alone
        ([seen(0.5, extrapolation=2.0)], None),
        ([seen(np.nan)], "failed"),  # a law that cannot be solved
        ([seen(0.01, coverage=np.nan, withheld=1)], "usable"),  # without bands
        ([seen(0.04, nrmse_linear=np.nan)], "ok"),
        ([], None),
    ],
)
def test_a_law_is_graded_by_the_tests_that_no_fit_saw(tests, expected):
    assert status(*tests) == expected


def test_want_of_signal_is_no_fault_of_the_law():
    """A weak joint in noise: a linear oscillator is as good, and the law is right."""
    weak, weaker = seen(0.2, nrmse_linear=0.21), seen(0.6, nrmse_linear=0.61)
    assert status(weak) == status(weaker) == "failed"
    white = [coloured(ok=True)]
    assert status(weak, findings=white) == "usable"
    assert status(weaker, findings=white) == "not assessed"
    assert status(weak, findings=[*white, checked("chi_square", False, "Far.", 9.0)]) == "failed"
    assert status(weak.replaced(scatter=0.2)) == "usable"
    assert status(weak.replaced(scatter=0.15)) == "failed"  # 1.33 times the scatter


def test_large_errors_and_narrow_bands_are_never_better_than_not_predictive():
    """Over a grid of all that a grade looks at: e > 25 % or c < 95 % is no grade but the worst."""
    white = (coloured(ok=True), coloured())
    for error, linear, coverage, finding, scatter in product(
        np.linspace(0.005, 0.5, 12), (0.01, 0.1, 1.0), (0.8, 0.949, 0.951, 1.0), white, (0.01, 1.0)
    ):
        test = seen(error, nrmse_linear=linear, coverage=coverage, scatter=scatter)
        found = status(test, findings=[finding])
        if error > 0.25 or coverage < 0.95:
            assert found in ("failed", "not assessed")
        elif error <= 0.05:
            assert found == "ok"


def test_a_campaign_may_state_its_own_limit():
    assert status(seen(0.04), limit=Identify.of({"predictive": 0.03}).predictive) == "usable"
    assert status(seen(0.08), limit=Identify.of({"predictive": 0.1}).predictive) == "ok"
    for wrong in (0.0, -0.1, 0.3):
        with pytest.raises(ConfigError, match="predictive"):
            Identify.of({"predictive": wrong})


def test_the_grade_answers_for_the_law():
    """Residuals of precise records are coloured whatever the law: what it predicts decides."""
    findings = [coloured(), checked("simpler_model", False, "Simpler.", 1.2, "")]
    mixed = checked("r_hat", True, "Mixed.", 1.0, "")
    for error, expected, word in (
        (0.03, "ok", "predictive"),
        (0.2, "usable", "approximate"),
        (0.4, "failed", "not predictive"),
    ):  # fmt: skip
        verdict = judged([*findings, mixed], (), {"a": seen(error)}, LAWS)
        assert verdict.status == expected
        answer = dict(answers(verdict.findings))["law"]
        assert (answer.status, answer.word) == (expected, word)
        others = {one.status for one in verdict.findings if one.code in ("coloured_residual",)}
        assert others == {"failed" if expected == "failed" else "usable"}
        assert f"law {word}" in repr(verdict)
    # Without a held-out test the findings answer as before.
    assert judged(findings, (), {"a": FITTED}, LAWS) == judge(findings)
    assert judge(findings).status == "failed"


def test_a_predictive_law_does_not_mend_chains_that_are_not_mixed():
    verdict = judged([checked("r_hat", False, "Unmixed.", 1.5)], (), {"a": seen(0.01)}, LAWS)
    assert verdict.status == "failed"
