"""Sampling along logarithms leaves the posterior as it is, and straightens a ridge."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

from jbw.inference.fit.costly_fit import costly_fit
from jbw.inference.posterior.summary import summarise
from jbw.inference.samplers.sampling import sample
from jbw.inference.space.box import box
from jbw.inference.space.reparametrisation import along_logarithms, in_logarithms, never_zero

PRIOR = box({"a": (1.0, 20.0), "b": (1.0, 30.0), "c": (-1.0, 1.0)})
STD = 0.02  # of log(a b), and of c


def residual(theta, data):
    product = (jnp.log(theta["a"]) + jnp.log(theta["b"]) - data) / STD
    return jnp.stack([product, theta["c"] / STD])


def log_likelihood(theta, data):
    return -0.5 * residual(theta, data) ** 2


def flat(theta, data):
    return jnp.zeros(1) + 0.0 * theta["c"]


def drawn(function, best, logs, num_samples=1000):
    return sample(
        jax.random.key(1), function, PRIOR, jnp.log(60.0),
        sampler="elliptical_slice", num_warmup=25, num_samples=num_samples, num_chains=4,
        coordinates=along_logarithms(best.theta, best.covariance, PRIOR, logs),
        attrs={"a": {"units": "m"}},
    )  # fmt: skip


@pytest.fixture(scope="module")
def best():
    return costly_fit(residual, PRIOR, jnp.log(60.0), starts={"a": 8.0, "b": 7.0, "c": 0.1})


@pytest.fixture(scope="module")
def ridge(best):
    assert never_zero(best.theta, best.covariance, PRIOR) == ("a", "b")
    return drawn(log_likelihood, best, ("a", "b"))


def test_a_ridge_of_a_product_mixes_and_has_its_moments(ridge):
    # Given a, b is narrow: the density of a is that of 1 / a, where b = 60 / a is in its box.
    norm = quad(lambda a: 1 / a, 2.0, 20.0)[0]
    mean = quad(lambda a: 1.0, 2.0, 20.0)[0] / norm
    square = quad(lambda a: a, 2.0, 20.0)[0] / norm
    rows = summarise(ridge, PRIOR)
    assert rows["a"]["r_hat"] < 1.02
    error = rows["a"]["sd"] / np.sqrt(rows["a"]["ess_bulk"])
    # The ends of b's box are blurred by 2 % of b: 1 % of the mean of a.
    assert rows["a"]["mean"] == pytest.approx(mean, abs=4 * error + 0.01 * mean)
    assert rows["a"]["sd"] == pytest.approx(np.sqrt(square - mean**2), rel=0.1)
    product = np.log(ridge["posterior"]["a"] * ridge["posterior"]["b"])
    assert float(product.std()) == pytest.approx(STD, rel=0.1)


def test_without_data_the_uniform_prior_comes_back(best):
    posterior = drawn(flat, best, ("a", "b"), num_samples=2000)["posterior"].to_dataset()
    for name, low, high in zip(PRIOR.names, PRIOR.lower, PRIOR.upper, strict=True):
        x = (posterior[name].values.ravel() - float(low)) / float(high - low)
        # Draws about a narrow ridge cover the box slowly: a few hundred effective ones.
        assert x.mean() == pytest.approx(0.5, abs=0.08), name
        assert x.std() == pytest.approx(1 / np.sqrt(12), abs=0.05), name


def test_groups_are_those_of_the_parameters(ridge):
    posterior = ridge["posterior"]
    assert set(posterior.data_vars) == {"a", "b", "c"}
    assert posterior["a"].attrs == {"lower": 1.0, "upper": 20.0, "units": "m"}
    flat_density = -np.log(19.0 * 29.0 * 2.0)
    np.testing.assert_allclose(ridge["log_prior"]["log_prior"], flat_density, rtol=1e-12)
    total = ridge["log_likelihood"]["terms"].sum("term") + flat_density
    np.testing.assert_allclose(ridge["sample_stats"]["lp"], total, rtol=1e-12)
    terms = log_likelihood({n: posterior[n].values for n in PRIOR.names}, np.log(60.0))
    np.testing.assert_allclose(
        np.moveaxis(terms, 0, -1), ridge["log_likelihood"]["terms"], rtol=1e-8, atol=1e-8
    )


def test_a_parameter_that_may_be_zero_stays_as_it_is(best):
    near = box({"a": (0.0, 20.0), "b": (1.0, 30.0), "c": (-1.0, 1.0)})
    fit = costly_fit(residual, near, jnp.log(60.0), starts={"a": 8.0, "b": 7.0, "c": 0.1})
    assert never_zero(fit.theta, fit.covariance, near) == ("a", "b")  # given b, a is known to 2 %
    lower = in_logarithms(fit.theta, fit.covariance, near, ("a", "b")).lower
    assert float(lower[0]) == pytest.approx(np.log(1e-6 * fit.theta["a"]))
    vague = costly_fit(
        lambda theta, data: residual(theta, data) * STD / 2.0, near, jnp.log(60.0),
        starts={"a": 8.0, "b": 7.0, "c": 0.1},
    )  # fmt: skip
    assert never_zero(vague.theta, vague.covariance, near) == ("b",)


def test_chains_start_where_the_box_allows_it():
    # Two standard deviations about the fit reach far beyond the upper bound; a chain that began
    # there had a bracket that never ended.
    near = box({"a": (0.1, 1.15), "b": (0.1, 5.0)})
    wide = costly_fit(
        lambda theta, _: jnp.stack([(theta["a"] - 1) / 0.3, (theta["b"] - 1) / 0.3]),
        near, None, starts={"a": 0.9, "b": 1.0},
    )  # fmt: skip
    place = along_logarithms(wide.theta, wide.covariance, near, ("a", "b"))

    def log_density(theta, data):
        return -0.5 * jnp.stack([(theta["a"] - 1) / 0.3, (theta["b"] - 1) / 0.3]) ** 2

    for seed in (2, 7, 11):
        tree = sample(
            jax.random.key(seed), log_density, near, None, coordinates=place,
            sampler="elliptical_slice", num_warmup=0, num_samples=50, num_chains=4,
        )  # fmt: skip
        assert float(tree["posterior"]["a"].max()) < 1.15
