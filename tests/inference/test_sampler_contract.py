"""One contract for all samplers of the register: what every one of them must do.

To hold another sampler to it, register it and add its options for a short run below, where its own
counts are too large.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from guests import metropolis
from scipy.stats import kstest
from tiers import standing_for_all

from jbw.errors import ConfigError
from jbw.inference.posterior.summary import diagnose
from jbw.inference.samplers import register
from jbw.inference.samplers.chains import draws_of
from jbw.inference.samplers.register import SAMPLERS, Sampler, options_of, sampler_named
from jbw.inference.samplers.sampling import sample
from jbw.inference.space.box import box
from jbw.inference.space.problem import problem_of
from jbw.inference.space.reparametrisation import in_box

PLANE = box({"b": (-3.0, 5.0), "a": (-6.0, 2.0)})  # names not in the order of the alphabet
MEAN = np.array([1.0, -2.0])
COVARIANCE = np.array([[0.16, 0.1], [0.1, 0.25]])
PRECISION = np.linalg.inv(COVARIANCE)
ABOUT = {"start": dict(zip(PLANE.names, MEAN, strict=True)), "covariance": 1.2 * COVARIANCE}
WIDE = {"start": {"b": 1.0, "a": -2.0}, "covariance": 4.0 * np.eye(2)}
SHORT = {"nuts": (300, 500), "random_walk": (500, 4000), "elliptical_slice": (25, 1000)}
LONG_TO_COMPILE = ("nested", "tempered_smc")
NAMES = [
    pytest.param(name, marks=pytest.mark.slow) if name in LONG_TO_COMPILE else name
    for name in SAMPLERS
]


def gaussian(theta, data):
    off = jnp.stack([theta["b"], theta["a"]]) - data
    return -0.5 * (off @ PRECISION @ off)[None]


def flat(theta, data):
    return 0.0 * (theta["a"] + theta["b"])[None]


def drawn(name, log_likelihood, about=ABOUT, seed=0):
    warmup, draws = SHORT.get(name, (0, 1000))
    counts = {} if name == "random_walk_paper" else {"num_warmup": warmup, "num_samples": draws}
    known = about if SAMPLERS[name].needs_fit else {}
    return sample(
        jax.random.key(seed), log_likelihood, PLANE, jnp.asarray(MEAN), sampler=name, **counts,
        **known,
    )  # fmt: skip


@pytest.mark.parametrize("name", [n for n in NAMES if n != "random_walk_paper"])
def test_the_moments_of_a_gaussian(name):
    """Of the published walk, which crosses no box, only the rest of the contract is asked."""
    posterior = drawn(name, gaussian)["posterior"].to_dataset()
    values = np.stack([posterior[n].values for n in PLANE.names])
    ess = min(min(diagnose(v)["ess_bulk"], diagnose(v)["ess_tail"]) for v in values)
    assert ess > 100
    flat_values = values.reshape(2, -1)
    sd = np.sqrt(np.diag(COVARIANCE))
    assert np.all(np.abs(flat_values.mean(axis=1) - MEAN) < 4 * sd / np.sqrt(ess))
    # Of a normal the covariance of two draws scatters by sqrt((1 + rho^2) / n) of the deviations.
    scaled = (np.cov(flat_values) - COVARIANCE) / np.outer(sd, sd)
    assert np.all(np.abs(scaled) < 4 * np.sqrt(2 / ess))


# Nested sampling takes seconds to compile for this density; its moments of a Gaussian are above.
@pytest.mark.parametrize(
    "name",
    standing_for_all([n for n in SAMPLERS if n != "random_walk_paper"], *{*SAMPLERS} - {"nested"}),
)
def test_without_data_the_prior_comes_back(name):
    posterior = drawn(name, flat, WIDE)["posterior"].to_dataset()
    for i, n in enumerate(PLANE.names):
        values = posterior[n].values
        every = int(np.ceil(values.size / diagnose(values)["ess_bulk"]))
        lower, upper = float(PLANE.lower[i]), float(PLANE.upper[i])
        x = (values[:, :: 2 * every].ravel() - lower) / (upper - lower)
        assert kstest(x, "uniform").pvalue > 1e-4


IN_LANES = [
    pytest.param(name, marks=pytest.mark.slow) if name in LONG_TO_COMPILE else name
    for name, sampler in SAMPLERS.items()
    if not sampler.in_rounds
]


@pytest.mark.parametrize("name", IN_LANES)
def test_it_runs_under_vmap_and_the_same_key_gives_the_same_draws(name):
    entry = sampler_named(name)
    options = options_of(
        entry, num_warmup=20, num_samples=40, num_chains=2, chain_method="vectorized",
        num_places=33, num_moves=3,
    )  # fmt: skip
    place = in_box(PLANE, ABOUT["start"], ABOUT["covariance"], 2)
    if not entry.needs_fit:
        place = in_box(PLANE, None, None, 2)

    def one(key, data):
        return draws_of(entry, key, problem_of(gaussian, PLANE, data, place), options).theta

    keys = jax.random.split(jax.random.key(0), 2)
    keys = jnp.stack([keys[0], keys[0], keys[1]])
    data = jnp.stack([jnp.asarray(MEAN), jnp.asarray(MEAN), jnp.asarray(MEAN) + 0.1])
    theta = jax.jit(jax.vmap(one))(keys, data)
    for n, low, high in zip(PLANE.names, PLANE.lower, PLANE.upper, strict=True):
        assert theta[n].shape == (3, 2, 40)
        assert np.all((theta[n] >= low) & (theta[n] <= high))
        np.testing.assert_array_equal(theta[n][0], theta[n][1])
        assert not np.array_equal(theta[n][0], theta[n][2])


class Everywhere:
    """A sampler of the test: independent proposals of the prior, taken by Metropolis' rule."""

    class Options(NamedTuple):
        """Counts."""

        num_warmup: int = 0
        num_samples: int = 4000
        num_chains: int = 4
        chain_method: str = "sequential"

    @staticmethod
    def kernel(problem, options):
        shape = (len(problem.box.names),)
        return metropolis(
            problem,
            lambda key: jax.random.logistic(key, shape),
            # The prior's logit is logistic.
            lambda w: problem.log_density(w) + jnp.sum(w + 2 * jnp.log1p(jnp.exp(-w))),
        )


@pytest.fixture(name="everywhere")
def _everywhere():
    register.register(Sampler("everywhere", Everywhere, from_prior=True, draws=(0, 2000)))
    yield "everywhere"
    del register.SAMPLERS["everywhere"]


def test_a_sampler_that_a_test_registers_draws_like_any_other(everywhere):
    posterior = drawn(everywhere, gaussian)["posterior"].to_dataset()
    for i, name in enumerate(PLANE.names):
        values = posterior[name].values
        ess = diagnose(values)["ess_bulk"]
        assert abs(values.mean() - MEAN[i]) < 4 * np.sqrt(COVARIANCE[i, i] / ess)


def test_a_campaign_may_name_it(everywhere):
    from jbw.campaign.settings import Identify

    assert Identify.of({"sampler": everywhere}).sampler == everywhere


def test_an_unknown_name_is_refused_with_the_nearest_one():
    with pytest.raises(ConfigError, match="one of nuts") as caught:
        sampler_named("nuts2")
    assert "'nuts'" in caught.value.remedy
