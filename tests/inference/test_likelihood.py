import jax.numpy as jnp
import numpy as np
import pytest

from jbw.inference.likelihood import (
    complex_gaussian_log_likelihood,
    complex_gaussian_marginal_log_likelihood,
    gaussian_log_likelihood,
    gaussian_marginal_log_likelihood,
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


def test_real_repeats_match_scipy_sample_by_sample():
    from scipy.stats import norm

    rng = np.random.default_rng(0)
    data, model = rng.normal(size=(6, 40)), rng.normal(size=40)
    mean, std = data.mean(axis=0), 0.7
    within = np.sum((data - mean) ** 2, axis=0)
    got = gaussian_log_likelihood(mean, within, 6, model, std)
    np.testing.assert_allclose(got, norm(model, std).logpdf(data).sum(axis=0), rtol=1e-12)


def test_real_marginal_is_the_integral_over_the_noise():
    from scipy.integrate import quad
    from scipy.stats import norm

    rng = np.random.default_rng(1)
    data = rng.normal(size=(3, 4))
    mean = data.mean(axis=0)
    within = np.sum((data - mean) ** 2)

    def evidence(model):
        def integrand(log_std):  # the Jeffreys prior is flat in log sigma
            return np.exp(norm(model, np.exp(log_std)).logpdf(data).sum())

        return np.log(quad(integrand, -4, 5, epsabs=0, epsrel=1e-10)[0])

    one, other = np.zeros(4), np.full(4, 0.5)
    got = [float(gaussian_marginal_log_likelihood(mean, within, 3, m)) for m in (one, other)]
    # The range cut from the integral holds less than 1e-8 of it.
    np.testing.assert_allclose(got[0] - got[1], evidence(one) - evidence(other), rtol=1e-6)
