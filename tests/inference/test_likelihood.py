import jax.numpy as jnp
import numpy as np
import pytest

from jbw.inference.groups.offsets import (
    complex_gaussian_log_likelihood,
    complex_gaussian_marginal_log_likelihood,
)


@pytest.fixture(name="case")
def _case(golden):
    case = golden["bayes"]["complex_gaussian"]
    data = np.array(case["data"]) @ [1, 1j]
    model = np.array(case["model"]) @ [1, 1j]
    mean = data.mean(axis=0)
    return case, data, mean, np.sum(np.abs(data - mean) ** 2, axis=0), model


def test_complex_repeats_match_the_golden_log_likelihood(case):
    numbers, data, mean, within, model = case
    terms = complex_gaussian_log_likelihood(mean, within, len(data), model, 0.3)
    assert terms.shape == model.shape
    # The golden sums are given to about ten digits.
    np.testing.assert_allclose(jnp.sum(terms), numbers["loglik_normalised"], rtol=1e-9)
    np.testing.assert_allclose(np.sum(within), numbers["within_ss"], rtol=1e-9)


def test_marginal_noise_matches_golden(case):
    numbers, data, mean, within, model = case
    got = complex_gaussian_marginal_log_likelihood(mean, within, len(data), model)
    np.testing.assert_allclose(got, numbers["marginal_loglik_jeffreys_up_to_const"], rtol=1e-9)


def test_dropping_a_conjugate_or_the_repeats_would_show(case):
    numbers, data, mean, within, model = case
    for wrong in (
        complex_gaussian_log_likelihood(mean, within, len(data), np.conj(model), 0.3),
        complex_gaussian_log_likelihood(mean, 0 * within, 1, model, 0.3),
        complex_gaussian_log_likelihood(mean, within, len(data), model, 0.3 / np.sqrt(2)),
    ):
        assert abs(float(jnp.sum(wrong)) - numbers["loglik_normalised"]) > 1
