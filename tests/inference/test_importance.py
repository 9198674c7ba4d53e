"""Importance sampling against closed-form posteriors."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jbw.inference.box import box
from jbw.inference.fitting import fit
from jbw.inference.importance import importance

# Names whose sorted order differs from the box's: JAX sorts dictionaries.
NAMES = ("omega_n", "zeta", "alpha")
CENTRE = np.array([118.0, 0.0044, 497.0])
STD = np.array([4e-6, 1.5e-8, 1.6e-2])
CORRELATION = np.array([[1.0, 0.6, -0.3], [0.6, 1.0, 0.4], [-0.3, 0.4, 1.0]])
ROOT = np.linalg.inv(np.linalg.cholesky(CORRELATION * np.outer(STD, STD)))
PRIOR = box({name: (0.8 * c, 1.2 * c) for name, c in zip(NAMES, CENTRE, strict=True)})


def residual(theta, data):
    return ROOT @ (jnp.stack([theta[name] for name in NAMES]) - CENTRE)


def gaussian(theta, data):
    return -0.5 * residual(theta, data) ** 2


def skewed(theta, data):
    """A Gaussian in exp(t / 30), t = the whitened first coordinate: skewed by a known amount."""
    r = residual(theta, data)
    return -0.5 * jnp.array([900 * jnp.expm1(r[0] / 30) ** 2 - r[0] / 15, r[1] ** 2, r[2] ** 2])


@pytest.fixture(scope="module")
def best():
    starts = {name: 1.01 * c for name, c in zip(NAMES, CENTRE, strict=True)}
    return fit(residual, PRIOR, None, starts=starts)


def test_a_gaussian_posterior_comes_back(best):
    found = importance(jax.random.key(0), gaussian, PRIOR, None, best, num_draws=1000)
    t = np.stack([found.theta[n] for n in NAMES], axis=-1) - CENTRE
    squares = np.sum((t @ ROOT.T) ** 2, axis=1)
    # The ratio of a normal and a t distribution is bounded: so are the weights, and k-hat is low.
    exact = np.exp(-squares / 2) * (1 + squares / 5) ** 4
    # The tail is replaced by quantiles of its Pareto fit; the bulk is to the rounding of theta,
    # 1e-16 of 118 against a std of 4e-6.
    bulk = exact < np.quantile(exact, 0.8)
    ratio = found.weights[bulk] / exact[bulk]
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-4)
    assert found.khat < 0.5
    assert found.ess > 600
    for name, centre, std in zip(NAMES, CENTRE, STD, strict=True):
        assert abs(found.mean(name) - centre) < 4 * std / np.sqrt(600)
        assert abs(found.sd(name) / std - 1) < 4 / np.sqrt(2 * 600)


def test_weights_turn_the_laplace_approximation_into_the_posterior(best):
    found = importance(jax.random.key(1), skewed, PRIOR, None, best, num_draws=4000)
    t = ROOT[0, 0] * (found.theta["omega_n"] - CENTRE[0])
    mean = np.sum(found.weights * t)
    # Exact: x = exp(t/30) is N(1, 1/900); E[30 log x] by quadrature.
    x = np.linspace(1e-6, 3, 200_001)
    density = np.exp(-450 * (x - 1) ** 2)
    exact = np.trapezoid(30 * np.log(x) * density, x) / np.trapezoid(density, x)
    assert found.khat < 0.7
    assert abs(mean - exact) < 4 / np.sqrt(found.ess)
