"""Prior densities that a campaign states: parsed, bounded, weighed and scored as SciPy has them."""

import json
import pickle
import tomllib

import jax.numpy as jnp
import numpy as np
import numpyro.distributions as dist
import pytest
from scipy import stats

from jbw.campaign.document import toml
from jbw.campaign.settings import Identify
from jbw.errors import ConfigError
from jbw.inference.density import TAIL, Density, density_of
from jbw.inference.space.box import bounds_by_name, box, log_prior_std, prior_std
from jbw.inference.space.stated import (
    StatedDensities,
    as_wide,
    log_over_uniform,
    standard_scores,
)

CASES = {
    "LogNormal": ([-5.4, 0.3], stats.lognorm(0.3, scale=np.exp(-5.4))),
    "Normal": ([1e8, 2e6], stats.norm(1e8, 2e6)),
    "Gamma": ([2.0, 3.0], stats.gamma(2.0, scale=1 / 3.0)),
    "Beta": ([2.0, 3.0], stats.beta(2.0, 3.0)),
    "StudentT": ([4.0, 1.0, 2.0], stats.t(4.0, 1.0, 2.0)),
    "Weibull": ([1.0, 2.0], stats.weibull_min(2.0, scale=1.0)),
}


@pytest.mark.parametrize("family", CASES)
def test_bounds_are_quantiles_at_five_standard_deviations(family):
    arguments, reference = CASES[family]
    bounds = density_of({family: arguments})
    # The upper one is as accurate as 1 - 3e-7 is told from 1 by a distribution function.
    np.testing.assert_allclose(bounds, reference.ppf([TAIL, 1 - TAIL]), rtol=1e-6)
    assert pytest.approx(stats.norm.cdf(-5.0), rel=1e-12) == TAIL


@pytest.mark.parametrize(
    ("stated", "lower"),
    [
        ({"HalfNormal": [1e-7]}, 0.0),
        ({"Exponential": [3.0]}, 0.0),
        ({"Uniform": [2.0, 5.0]}, 2.0),
        ({"LogUniform": [1e-3, 1.0]}, 1e-3),
        ({"TruncatedNormal": {"loc": 1.0, "scale": 2.0, "low": 0.0}}, 0.0),
    ],
)
def test_a_density_that_does_not_vanish_at_an_end_begins_there(stated, lower):
    assert density_of(stated)[0] == lower


@pytest.mark.parametrize("family", CASES)
def test_terms_and_scores_are_those_of_scipy(family):
    arguments, reference = CASES[family]
    density = density_of({family: arguments})
    stated = StatedDensities.of({"x": density, "y": (0.0, 1.0)})
    assert stated.names == ("x",)
    for value in reference.ppf([0.01, 0.5, 0.99]):
        theta = {"x": jnp.asarray(value)}
        term = reference.logpdf(value) + np.log(density[1] - density[0])
        np.testing.assert_allclose(log_over_uniform(theta, stated), [term], rtol=1e-9, atol=1e-9)
        score = stats.norm.ppf(reference.cdf(value))
        np.testing.assert_allclose(standard_scores(theta, stated)["x"], [score], atol=1e-8)


def test_a_parameter_that_a_nested_model_lacks_has_no_prior():
    stated = StatedDensities.of({"alpha": density_of({"Normal": [3000.0, 10.0]})})
    assert log_over_uniform({}, stated).tolist() == [0.0]
    assert standard_scores({}, stated)["alpha"].tolist() == [0.0]
    assert log_over_uniform({}, StatedDensities()).shape == (0,)


def test_the_box_as_wide_has_the_deviation_of_the_density():
    stated = StatedDensities.of(
        {
            "zeta": density_of({"LogNormal": [-5.4, 0.3]}),
            "gamma": density_of({"Normal": [5.0, 20.0]}),
            "alpha": density_of({"LogUniform": [1.0, 1e9]}),
        }
    )
    bounds = {"zeta": (1e-3, 2e-2), "gamma": (-95.0, 105.0), "alpha": (1.0, 1e9)}
    wide = bounds_by_name(as_wide(box({**bounds, "delta": (1.0, 2.0)}), stated))
    assert log_prior_std(*wide["zeta"]) == pytest.approx(0.3, rel=1e-4)
    assert prior_std(*wide["gamma"]) == pytest.approx(20.0, rel=1e-4)
    # No uniform density has a logarithm of more than one standard deviation.
    assert log_prior_std(*wide["alpha"]) == pytest.approx(1.0, rel=1e-3)
    assert wide["delta"] == (1.0, 2.0)


@pytest.mark.parametrize(
    "stated",
    [
        {"LogNormal": [-5.4, 0.3]},
        {"TruncatedNormal": {"loc": 0.004, "scale": 0.001, "low": 0.0}},
        dist.LogNormal(-5.4, 0.3),
    ],
)
def test_a_density_is_written_and_read_as_it_is(stated):
    settings = Identify.of({"prior": {"zeta": stated, "omega_n": [100.0, 120.0]}})
    density = settings.prior["zeta"]
    assert isinstance(density, Density)
    table = tomllib.loads(f"zeta = {toml(density)}")
    again = Identify.of({"prior": table}).prior["zeta"]
    np.testing.assert_allclose(again, density, rtol=1e-6)  # NumPyro's own may be in float32
    assert tomllib.loads(f"zeta = {density!r}") == table
    assert tuple(pickle.loads(pickle.dumps(density))) == tuple(density)
    assert settings.prior["omega_n"] == (100.0, 120.0)
    assert json.loads(json.dumps(density)) == list(density)


@pytest.mark.parametrize(
    ("stated", "says"),
    [
        ({"LogNorml": [1.0, 2.0]}, "did you mean `LogNormal`"),
        ({"Poisson": [3.0]}, "a density of one real number, but `Poisson` is not"),
        ({"Dirichlet": [1.0]}, "valid arguments of Dirichlet"),
        ({"Normal": [0.0, -1.0]}, "invalid scale"),
        ({"Normal": [0.0, "a"]}, "takes finite numbers, but one is 'a'"),
        ({"Normal": [0.0, float("nan")]}, "takes finite numbers, but one is nan"),
        ({"Normal": {"mean": 0.0}}, "unexpected keyword argument 'mean'"),
        ({}, "must name one distribution, but names none"),
        ({"Normal": [0, 1], "Gamma": [1, 1]}, "names Normal, Gamma"),
        ({"Delta": [1.0]}, "needs a distribution function, which `Delta` lacks"),
        ({"constraints": []}, "which NumPyro lacks"),
        ({"Distribution": []}, "`Distribution` is not"),
        ("wide", r"must be \[lower, upper\], or a distribution"),
        ([2.0, 1.0], "lower < upper"),
        (dist.MultivariateNormal(jnp.zeros(2), jnp.eye(2)), "a density of one real number"),
    ],
)
def test_what_is_no_prior_is_refused_in_a_sentence(stated, says):
    with pytest.raises(ConfigError, match=says):
        Identify.of({"prior": {"zeta": stated}})
