import numpy as np
import pytest
from scipy.stats import differential_entropy, truncnorm

from jbw.inference.divergence import (
    joint_kl_from_uniform,
    kl_from_uniform,
    kl_truncated_normal,
)

SEEDS = (0, 1, 2)


def test_closed_form_matches_golden(golden):
    for case in golden["bayes"]["kl_truncated_normal_vs_uniform01"]["cases"]:
        got = kl_truncated_normal(case["mean_x"], case["sd_x"])
        np.testing.assert_allclose(got, case["kl_nats"], rtol=1e-9)


def test_closed_form_is_symmetric_and_keeps_its_digits_far_in_the_tail():
    np.testing.assert_allclose(kl_truncated_normal(3.0, 0.1), kl_truncated_normal(-2.0, 0.1))
    # Twenty deviations out the density is nearly exponential with rate 200: D -> log(200) - 1.
    np.testing.assert_allclose(kl_truncated_normal(3.0, 0.1), np.log(200) - 1, atol=0.01)


@pytest.mark.parametrize("seed", SEEDS)
def test_estimate_recovers_golden_divergences(golden, seed):
    rng = np.random.default_rng(seed)
    for case in golden["bayes"]["kl_truncated_normal_vs_uniform01"]["cases"]:
        mean, sd = case["mean_x"], case["sd_x"]
        frozen = truncnorm(-mean / sd, (1 - mean) / sd, mean, sd)
        # Standard deviation of the estimate with 765 draws is about 0.03 (theory, section 7).
        got = kl_from_uniform(frozen.rvs(765, random_state=rng))
        np.testing.assert_allclose(got, case["kl_nats"], atol=0.13)


def test_estimate_has_no_bias_for_uniform_draws():
    rng = np.random.default_rng(0)
    estimates = [kl_from_uniform(rng.uniform(size=765)) for _ in range(200)]
    assert abs(np.mean(estimates)) < 4 * np.std(estimates) / np.sqrt(200)


def test_estimate_agrees_with_scipy_spacings():
    x = np.random.default_rng(3).beta(5, 3, size=2000)
    other = -differential_entropy(x, window_length=45, method="ebrahimi")
    # Two corrections of the same spacings; they differ by terms of order 1/m.
    np.testing.assert_allclose(kl_from_uniform(x, window=45), other, atol=0.03)


def test_a_frozen_chain_has_no_finite_divergence():
    assert kl_from_uniform(np.full(100, 0.3)) == np.inf


@pytest.mark.parametrize("seed", SEEDS)
def test_joint_divergence_of_a_correlated_gaussian(seed):
    rng = np.random.default_rng(seed)
    covariance = np.array([[1.0, -0.9], [-0.9, 1.0]]) * 0.05**2
    x = rng.multivariate_normal([0.5, 0.4], covariance, size=4000)
    exact = -0.5 * np.linalg.slogdet(2 * np.pi * np.e * covariance)[1]
    np.testing.assert_allclose(joint_kl_from_uniform(x), exact, atol=0.1)
