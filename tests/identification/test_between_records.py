"""Free decays fitted each by itself: records that agree, and records that one law does not hold."""

from dataclasses import replace

import jax
import numpy as np
import pytest
import xarray as xr
from decays import decay_test
from scipy import stats

from jbw.campaign.settings import Identify
from jbw.identification.assemble import measured
from jbw.identification.leaving_out import _scatter, between_finding, between_records
from jbw.identification.prepare import fit_joint

COUNT = 12


def between(estimate, std, std_of_all=0.004):
    """Records of one product, as `between_records` gives them."""
    scatter, probability = _scatter(np.array(estimate), np.array(std))
    return xr.Dataset(
        {
            "std_of_all": ("quantity", [std_of_all]),
            "scatter": ("quantity", [scatter]),
            "probability": ("quantity", [probability]),
        },
        {"record": [f"impact {i}" for i in range(len(estimate))], "quantity": ["alpha_delta"]},
    )


def test_scatter_far_beyond_unequal_errors_is_that_of_the_sample():
    estimate = np.array([1.18, 1.0, 0.86, 1.0])
    scatter, _ = _scatter(estimate, np.array([6e-4, 4e-3, 6e-4, 7e-3]))
    assert scatter == pytest.approx(np.std(estimate, ddof=1), rel=0.01)


def test_scatter_of_equal_errors_is_the_variance_beyond_them():
    estimate = 1 + 0.08 * np.random.default_rng(2).standard_normal(COUNT)
    scatter, probability = _scatter(estimate, np.full(COUNT, 0.03))
    # With equal errors Paule and Mandel's scatter is that of the method of moments.
    assert scatter**2 == pytest.approx(np.var(estimate, ddof=1) - 0.03**2, rel=1e-12)
    f = np.var(estimate, ddof=1) / 0.03**2 * (COUNT - 1)
    assert probability == pytest.approx(stats.chi2.sf(f, COUNT - 1), rel=1e-12)


def test_records_that_agree_have_no_scatter_more_often_than_chance_lets_them():
    rng = np.random.default_rng(3)
    std = np.geomspace(0.01, 0.1, COUNT)
    found = [
        between_finding(between(1 + std * rng.standard_normal(COUNT), std)) for _ in range(400)
    ]
    # One in a hundred by chance: at most 12 of 400 in 99.8 %.
    assert sum(one.status != "ok" for one in found) <= stats.binom.isf(2e-3, 400, 0.01)


def test_the_wider_interval_holds_the_mean_of_records_that_scatter():
    scatter, std, trials = 0.06, 0.02, 2000
    rng, held = np.random.default_rng(4), 0
    for _ in range(trials):
        estimate = 1 + np.hypot(scatter, std) * rng.standard_normal(COUNT)
        tau, _ = _scatter(estimate, np.full(COUNT, std))
        wide = stats.norm.isf(0.005) * np.sqrt(std**2 / COUNT + tau**2 / COUNT)
        held += abs(np.mean(estimate) - 1) < wide
    # A scatter that is estimated from 12 makes it a t of 11 degrees: 97.5 % of 99, two-sided.
    assert held / trials == pytest.approx(1 - 2 * stats.t.sf(stats.norm.isf(0.005), 11), abs=0.012)


def test_the_finding_states_both_intervals():
    finding = between_finding(between([0.9, 1.0, 1.1, 0.95, 1.05, 1.0], [0.01] * 6))
    assert finding.status == "usable"
    # The variance is 0.005, of which 0.0001 is of the errors: a scatter of 7 %.
    assert finding.number == pytest.approx(np.sqrt(0.005 - 0.0001), rel=1e-9)
    assert "alpha_delta varies between them by 7 %" in finding.reason
    assert "is +-1 % if one law" in finding.reason
    # 2.576 sqrt(0.004^2 + 0.0049 / 6)
    assert "it is +-7.4 %" in finding.reason


@pytest.mark.release  # scatter and finding are tested above
def test_records_of_other_sensitivities_ask_for_other_products():
    test = decay_test(second=0.0)
    gains = np.array([0.85, 1.0, 1.15, 1.0])
    records = tuple(
        replace(record, channels={"velocity": gain * record.channels["velocity"]})
        for record, gain in zip(test.records, gains, strict=True)
    )
    test = replace(test, records=records)
    seen = measured([test], Identify(fit_repeats=4), laws=("bouc_wen",), report=lambda _: None)
    ready = fit_joint(jax.random.key(1), seen, lambda _: None)
    found = between_records(ready.fit, ready.box, ready.data)
    assert between_finding(found).status == "usable"
    # Softening goes with amplitude: a record that reads larger by c asks for a product 1/c times.
    product = found.sel(quantity="alpha_delta")
    read = product["estimate"].values * gains
    np.testing.assert_allclose(read / read.mean(), 1.0, atol=0.05)
    # Their errors are far below their scatter, which is then that of the sample.
    expected = np.std(1 / gains, ddof=1)
    assert float(product["scatter"]) == pytest.approx(expected, rel=0.05)
