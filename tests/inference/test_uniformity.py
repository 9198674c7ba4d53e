"""The envelope and p-value of ranks, against simulation, scipy and ArviZ."""

import numpy as np
import pytest
from scipy.stats import binom, chisquare, kstest

from jbw.inference.calibration.record import (
    chi_square_p,
    counts_below,
    coverage_interval,
    ecdf_envelope,
    ecdf_p,
)

SEEDS = (0, 1, 2)


def uniform(seed, count, size=200, num_ranks=100):
    return np.random.default_rng(seed).integers(0, num_ranks + 1, (count, size))


def test_counts_are_of_ranks_strictly_below():
    np.testing.assert_array_equal(counts_below(np.array([0, 0, 2, 3]), 3), [2, 2, 3])


@pytest.mark.parametrize("seed", SEEDS)
def test_p_values_of_uniform_ranks_are_uniform(seed):
    ranks = uniform(seed, 300)
    for p_of in (ecdf_p, chi_square_p):
        p = [p_of(one, 100) for one in ranks]
        # Discrete: a few per cent of steps in 300 values do not show at 1e-4.
        assert kstest(p, "uniform").pvalue > 1e-4


def test_an_envelope_of_two_points_by_hand():
    """With L = 1 there is one point: the smallest symmetric range of a binomial count."""
    lower, upper = ecdf_envelope(50, 1, 0.9)
    inside = binom(50, 0.5).cdf(50 * upper[0]) - binom(50, 0.5).cdf(50 * lower[0] - 1)
    narrower = binom(50, 0.5).cdf(50 * upper[0] - 1) - binom(50, 0.5).cdf(50 * lower[0])
    assert inside >= 0.9 > narrower


@pytest.mark.parametrize("seed", SEEDS)
def test_the_envelope_holds_as_many_ecdfs_as_it_says(seed):
    lower, upper = ecdf_envelope(200, 100, 0.9)
    ecdfs = np.array([counts_below(one, 100) for one in uniform(seed, 2000)]) / 200
    held = np.sum(np.all((ecdfs >= lower - 1e-9) & (ecdfs <= upper + 1e-9), axis=1))
    # At least 90 %, for counts are discrete; at most 2 % more.
    assert binom(2000, 0.9).cdf(held) > 1e-4
    assert binom(2000, 0.92).sf(held) > 1e-4


def test_envelope_and_p_value_agree():
    lower, upper = ecdf_envelope(200, 100, 0.9)
    for one in uniform(5, 200):
        ecdf = counts_below(one, 100) / 200
        inside = np.all((ecdf >= lower - 1e-9) & (ecdf <= upper + 1e-9))
        # The bisection for the envelope ends within 1e-3 of its logarithm.
        assert inside == (ecdf_p(one, 100) > 0.1) or abs(ecdf_p(one, 100) - 0.1) < 0.01


def test_the_envelope_is_arviz_s_for_continuous_values():
    """ArviZ simulates its bands for values without ties; 500 ranks among 500 hardly tie."""
    from arviz_stats.ecdf_utils import ecdf_pit

    at, _, lower, upper = ecdf_pit(
        np.linspace(0.001, 0.999, 500), 0.94, 2000, rng=np.random.default_rng(0)
    )
    own_lower, own_upper = ecdf_envelope(500, 500, 0.94)
    where = np.arange(1, 501) / 501
    for own, theirs in ((own_lower, lower), (own_upper, upper)):
        # Two counts of 500: bands of 2000 simulations scatter by one.
        np.testing.assert_allclose(own[50:450], np.interp(where, at, theirs)[50:450], atol=4.1e-3)


def test_ranks_that_are_not_uniform_have_small_p_values():
    rng = np.random.default_rng(0)
    humped = rng.binomial(100, rng.beta(2.0, 2.0, 1000))
    assert ecdf_p(humped, 100) < 1e-6
    assert chi_square_p(humped, 100) < 1e-6
    assert ecdf_p(np.zeros(1000, int), 100) < 1e-100


def test_chi_square_is_scipy_s_where_bins_are_equal():
    ranks = uniform(3, 1, 400, 99)[0]
    expected = chisquare(np.bincount(ranks // 5, minlength=20)).pvalue
    np.testing.assert_allclose(chi_square_p(ranks, 99), expected, rtol=1e-12)


def test_coverage_interval_of_all_and_none():
    # Clopper-Pearson at the ends is closed: (alpha / 2)^(1 / n).
    np.testing.assert_allclose(coverage_interval(100, 100), (0.005**0.01, 1.0))
    np.testing.assert_allclose(coverage_interval(0, 100), (0.0, 1 - 0.005**0.01))
