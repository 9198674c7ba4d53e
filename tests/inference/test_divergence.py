import numpy as np
import pytest
from scipy.stats import differential_entropy, truncnorm

from jbw.inference.posterior.summary import kl_from_uniform

SEEDS = (0, 1, 2)


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
