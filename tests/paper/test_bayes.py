"""Posterior, likelihoods and objectives against scipy, golden numbers and hand calculation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scipy.optimize import minimize
from scipy.special import logsumexp
from scipy.stats import norm

from jbw.errors import ConfigError, DataError
from jbw.paper.likelihoods import (
    Repeats,
    gaussian_log_likelihood,
    kernel_log_likelihood,
    log_posterior,
    map_estimate,
    repeats,
    response_log_likelihood,
    with_noise,
)
from jbw.paper.objectives import (
    convergence,
    kernel_constraints,
    kernel_energy,
    kernel_objective,
    kernel_residual,
    opening_constraints,
    response_misfit,
)

RNG = np.random.default_rng(4)
MODEL = np.array([6e-9 - 2e-10j, 3e-8 - 3e-9j, -3e-8 - 3e-9j])
STD = 2e-9
KERNELS = MODEL + STD * (RNG.standard_normal((5, 3)) + 1j * RNG.standard_normal((5, 3)))
VELOCITY = np.sin(np.linspace(0.0, 9.0, 40))
RECORDS = VELOCITY + 0.05 * RNG.standard_normal((4, 40))


def by_scipy(residuals, std):
    """Sum of the log densities of all real parts."""
    parts = np.concatenate([np.real(residuals).ravel(), np.imag(residuals).ravel()])
    return norm.logpdf(parts if np.iscomplexobj(residuals) else np.real(residuals).ravel(), 0, std)


def test_kernel_likelihood_is_scipys():
    found = kernel_log_likelihood(repeats(KERNELS), MODEL, STD)
    assert float(jnp.sum(found)) == pytest.approx(by_scipy(KERNELS - MODEL, STD).sum(), rel=1e-12)
    one = gaussian_log_likelihood(np.sum(np.abs(KERNELS - MODEL) ** 2), 2 * KERNELS.size, STD)
    assert float(one) == pytest.approx(by_scipy(KERNELS - MODEL, STD).sum(), rel=1e-12)


def test_response_likelihood_is_scipys():
    found = response_log_likelihood(repeats(RECORDS), VELOCITY, 0.05)
    assert float(found) == pytest.approx(by_scipy(RECORDS - VELOCITY, 0.05).sum(), rel=1e-12)


@pytest.mark.parametrize("shift", [0.3e-9, 2e-9])
def test_unknown_noise_is_integrated_out(shift):
    # Reference: the integral over log sigma of the likelihood, by a sum of 4,000 values.
    log_std = np.linspace(np.log(STD) - 6, np.log(STD) + 8, 4000)

    def integrated(model):
        squares = np.sum(np.abs(KERNELS - model) ** 2, axis=0)[:, None]
        return logsumexp(-2 * 5 * log_std - squares / (2 * np.exp(2 * log_std)), axis=1)

    expected = integrated(MODEL + shift) - integrated(MODEL)
    data = repeats(KERNELS)
    found = kernel_log_likelihood(data, MODEL + shift) - kernel_log_likelihood(data, MODEL)
    # The sum over a smooth bell is exact; its far ends hold exp(-20).
    np.testing.assert_allclose(found, expected, atol=1e-7)


def test_golden_likelihood_through_the_papers_function(golden):
    case = golden["bayes"]["complex_gaussian"]
    data, model = (np.array(case[name]) @ [1, 1j] for name in ("data", "model"))
    found = kernel_log_likelihood(repeats(data), model, case["sigma_per_component"])
    # The golden sums are given to about ten digits.
    assert float(jnp.sum(found)) == pytest.approx(case["loglik_normalised"], rel=1e-9)
    squares = np.sum(np.abs(data - model) ** 2)
    unknown = gaussian_log_likelihood(squares, 2 * data.size)
    assert float(unknown) == pytest.approx(case["marginal_loglik_jeffreys_up_to_const"], rel=1e-9)


def test_noise_has_its_deviation_in_each_part():
    drawn = with_noise(jax.random.key(1), jnp.zeros(40_000, complex), 0.5)
    # 40,000 values: the deviation is known to 0.35 %.
    assert float(jnp.std(drawn.real)) == pytest.approx(0.5, rel=0.015)
    assert float(jnp.std(drawn.imag)) == pytest.approx(0.5, rel=0.015)
    assert not jnp.iscomplexobj(with_noise(jax.random.key(1), jnp.zeros(4), 0.5))


def test_posterior_has_the_volume_of_its_prior_and_ends_at_it():
    prior = {"alpha": (0.0, 4.0), "delta": (1.0, 3.0)}
    inside = log_posterior({"alpha": 1.0, "delta": 2.0}, prior, np.array([-1.0, -2.5]))
    assert float(inside) == pytest.approx(-3.5 - np.log(8.0), rel=1e-15)
    assert float(log_posterior({"alpha": 5.0, "delta": 2.0}, prior, 0.0)) == -np.inf


def test_map_estimate_is_scipys_minimum():
    prior = {"a": (-2.0, 3.0), "b": (0.0, 5.0)}

    def log_density(theta):
        return -10 * (theta["a"] - 0.4) ** 2 - (theta["b"] - 1.5 - theta["a"] ** 2) ** 2 * 3

    found = map_estimate(log_density, prior, {"a": 1.0, "b": 2.5})
    exact = minimize(lambda x: -log_density({"a": x[0], "b": x[1]}), [1.0, 2.5], tol=1e-14).x
    np.testing.assert_allclose([found["a"], found["b"]], [0.4, 1.66], rtol=1e-6)
    np.testing.assert_allclose(exact, [0.4, 1.66], rtol=1e-5)


def test_map_estimate_moves_with_its_data():
    # By hand: the maximum of -(x - d)^2 is at d.
    def place(d):
        return map_estimate(lambda t: -((t["x"] - d) ** 2), {"x": (0.0, 1.0)}, {"x": 0.5})["x"]

    assert float(jax.grad(place)(0.3)) == pytest.approx(1.0, rel=1e-8)


def test_objective_of_step_3_is_the_weighted_sum_of_squares():
    weight = np.array([1.0, 2.0, 3.0])
    residual = KERNELS[0] - MODEL
    by_hand = np.sum((weight * np.abs(residual)) ** 2)
    assert float(kernel_objective(KERNELS[0], MODEL, weight)) == pytest.approx(by_hand, rel=1e-13)
    assert kernel_residual(KERNELS[0], MODEL).shape == (6,)


def test_misfit_of_step_4_and_its_likelihood():
    model = VELOCITY + 0.01
    found = response_misfit(RECORDS[0], model)
    by_hand = np.sqrt(np.sum((RECORDS[0] - model) ** 2) / (40 * np.var(RECORDS[0])))
    assert float(found) == pytest.approx(by_hand, rel=1e-13)
    single = Repeats(RECORDS[0], np.zeros(40), 1.0)
    change = response_log_likelihood(single, model, 0.05) - response_log_likelihood(
        single, RECORDS[0], 0.05
    )
    # The square of the misfit times N var / (2 sigma^2), as its docstring says.
    expected = -(by_hand**2) * 40 * np.var(RECORDS[0]) / (2 * 0.05**2)
    assert float(change) == pytest.approx(expected, rel=1e-11)


def test_constraints_are_those_of_the_paper():
    assert kernel_constraints(118.0) == {"alpha": (0.0, 118.0**2), "delta": (0.0, 500.0)}
    assert opening_constraints(340.0, "printed") == {"gamma": (0.0, 340.0)}
    assert opening_constraints(340.0) == {"gamma": (-340.0, np.inf)}


def test_convergence_is_the_running_mean_of_the_kernels_energy():
    omega = np.array([31.0, 35.0, 38.0])
    energy = kernel_energy(KERNELS, omega)
    square = np.abs(KERNELS) ** 2
    by_hand = 4 * (square[:, 0] + square[:, 1]) / 2 + 3 * (square[:, 1] + square[:, 2]) / 2
    np.testing.assert_allclose(energy, by_hand, rtol=1e-13)
    mean = convergence(energy)
    np.testing.assert_allclose(mean, [np.mean(by_hand[: n + 1]) for n in range(5)], rtol=1e-13)


def test_gradients_of_likelihoods_and_objectives():
    data, records = repeats(KERNELS / STD), repeats(RECORDS)
    model = MODEL / STD

    def kernel(shift):
        return jnp.sum(kernel_log_likelihood(data, model * shift))

    def response(shift):
        return response_log_likelihood(records, VELOCITY * shift)

    def misfit(shift):
        return response_misfit(RECORDS[0], VELOCITY * shift)

    for function in (kernel, response, misfit):
        check_grads(jax.jit(function), (1.1,), 1, eps=1e-4)


def test_what_cannot_be_judged_is_refused():
    with pytest.raises(ConfigError, match="lower < upper"):
        log_posterior({"a": 1.0}, {"a": (2.0, 2.0)}, 0.0)
    with pytest.raises(ConfigError, match="`start` must lie inside the prior, but a = 4"):
        map_estimate(lambda t: -(t["a"] ** 2), {"a": (-1.0, 2.0)}, {"a": 4.0})
    with pytest.raises(ConfigError, match="`start` must name every parameter, but lacks b"):
        map_estimate(lambda t: -t["a"], {"a": (0.0, 2.0), "b": (0.0, 1.0)}, {"a": 1.0})
    with pytest.raises(DataError, match="must vary"):
        response_misfit(np.ones(4), np.zeros(4))
    with pytest.raises(ConfigError, match="`omega_n` must be greater than 0"):
        kernel_constraints(0.0)
    with pytest.raises(ConfigError, match='"corrected" or "printed"'):
        opening_constraints(1.0, "both")
