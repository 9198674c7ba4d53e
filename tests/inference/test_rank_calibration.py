"""Simulation-based calibration on posteriors with closed forms, right ones and wrong ones.

Seeds were fixed before the first run; statistical tests hold at p = 1e-4 on all of them.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.scipy.stats import norm
from tiers import represented_by, standing_for_all

from jbw.errors import ConfigError
from jbw.inference.calibration.replications import Model, calibrate, split_r_hat
from jbw.inference.fit.locate import Search
from jbw.inference.samplers.chains import Draws
from jbw.inference.samplers.register import Sampler, options_of, sampler_named
from jbw.inference.space.box import box

SEEDS = (0, 1, 2)
STD, COUNT = 0.1, 3
BOX = box({"a": (-1.0, 2.0)})
PLANE = box({"a": (0.5, 2.0), "b": (0.5, 2.0)})


def simulate(key, theta):
    return theta["a"] + STD * jax.random.normal(key, (COUNT,))


def log_likelihood(theta, data):
    return -0.5 * ((data - theta["a"]) / STD) ** 2


def residual(theta, data):
    return (data - theta["a"]) / STD


class Options(NamedTuple):
    """Draws of four groups."""

    num_samples: int = 250


def sampler_of(function):
    """A sampler of the test's own; the register is not needed to draw by it."""

    class Module:
        draw = staticmethod(function)

    Module.Options = Options
    return Sampler("of_the_test", Module), Options()


def exact(factor=1.0):
    """Independent draws of the closed form, a normal distribution cut off by the box."""

    def draw(key, problem, options):
        mean, sd = jnp.mean(problem.data), factor * STD / np.sqrt(COUNT)
        box = problem.box
        low, high = (norm.cdf((edge[0] - mean) / sd) for edge in (box.lower, box.upper))
        share = low + (high - low) * jax.random.uniform(key, (4, options.num_samples))
        theta = mean + sd * jax.scipy.special.ndtri(share)
        return Draws({"a": theta}, {}, jnp.array(True), jnp.array(True))

    return draw


EXACT = sampler_of(exact())  # one object: compiled once for all tests of equal counts
RIGHT = Model(simulate, log_likelihood, BOX)
FITTED = RIGHT._replace(search=Search(residual))


def run(sampler, seed=0, model=None, **options):
    model = model or RIGHT
    options = {"num_replications": 300, **options}
    return calibrate(jax.random.key(seed), model, *sampler, **options)


def named(name, **options):
    sampler = sampler_named(name)
    return sampler, options_of(sampler, chain_method="vectorized", **options)


def least_p(found):
    return min(*found.p_ecdf.values(), *found.p_chi_square.values())


@pytest.mark.parametrize("seed", represented_by(*SEEDS))
def test_the_closed_form_is_calibrated(seed):
    found = run(EXACT, seed, num_replications=1000)
    assert found.names == ("a", "log_likelihood")
    assert found.ranks.shape == (1000, 2)
    assert found.ranks.min() >= 0
    assert found.ranks.max() <= 100
    assert least_p(found) > 1e-4
    share, low, high = found.coverage["a"]
    assert low <= 0.99 <= high
    assert share == found.inside[:, 0].mean()
    assert not found.failed.any()


@pytest.mark.parametrize("factor", represented_by(0.5, 2.0))
def test_a_posterior_of_the_wrong_width_is_not(factor):
    found = run(sampler_of(exact(factor)))
    assert least_p(found) < 1e-6
    assert found.verdict.status == "failed"
    ranks, coverage, failures = found.verdict.findings
    assert ranks.status == "failed"
    assert failures.status == "ok"
    # Half the width: a 99 % interval holds what 80 % do, 0.80.
    if factor == 0.5:
        assert coverage.status == "failed"
        assert abs(found.coverage["a"][0] - 0.80) < 0.08


def test_a_likelihood_that_forgets_the_data_shows_in_its_own_ranks_alone():
    """Modrak et al.: the prior is self-consistent for every quantity that knows no data."""

    def prior(key, problem, options):
        width = problem.box.upper[0] - problem.box.lower[0]
        theta = problem.box.lower[0] + width * jax.random.uniform(key, (4, options.num_samples))
        return Draws({"a": theta}, {}, jnp.array(True), jnp.array(True))

    found = run(sampler_of(prior))
    assert found.p_ecdf["a"] > 1e-4
    assert found.p_ecdf["log_likelihood"] < 1e-10


SAMPLERS = {
    "amis": {"num_samples": 128},
    "importance": {"num_samples": 128, "num_draws": 1024, "num_rounds": 2},
    "tempered_smc": {"num_samples": 256, "num_chains": 2},
    "quadrature": {"num_samples": 128, "num_places": 257},
    "random_walk": {"num_warmup": 200, "num_samples": 300, "target_accept": 0.3},
    "elliptical_slice": {"num_warmup": 20, "num_samples": 125},
}


# test_evidence_samplers.py asks the others for moments; of amis test_amis.py has forty seeds.
@pytest.mark.parametrize(
    "sampler",
    standing_for_all(SAMPLERS, "quadrature", "random_walk"),
)
def test_samplers_are_calibrated(sampler):
    chosen = named(sampler, **SAMPLERS[sampler])
    # A run of amis takes a second of two cores, those of the others far less.
    count = 100 if sampler == "amis" else 300
    found = run(chosen, model=FITTED if chosen[0].needs_fit else RIGHT, num_replications=count)
    assert least_p(found) > 1e-4
    # A walk of 300 steps or a run of 256 particles may scatter beyond R-hat 1.1 now and then.
    assert found.failed.mean() < 0.05


def simulate_product(key, theta):
    return theta["a"] * theta["b"] * (1 + 0.01 * jax.random.normal(key, (COUNT,)))


def product_residual(theta, data):
    product = theta["a"] * theta["b"]
    return (data - product) / (0.01 * product)


def product_likelihood(theta, data):
    product = theta["a"] * theta["b"]
    return -0.5 * product_residual(theta, data) ** 2 - jnp.log(product)


RIDGE = Model(
    simulate_product, product_likelihood, PLANE, {"ab": lambda theta, _: theta["a"] * theta["b"]},
    Search(product_residual, ("a", "b")),
)  # fmt: skip
ACROSS = {
    "amis": named("amis", num_samples=250),
    "importance": named("importance", num_samples=250, num_draws=4096, num_rounds=2),
}


@pytest.mark.release  # test_ridge.py has ridges
@pytest.mark.parametrize(
    ("seed", "sampler"),
    represented_by((0, "importance"), (0, "amis"), (1, "importance"), (2, "importance")),
)
def test_a_thin_ridge_through_the_box(seed, sampler):
    found = run(ACROSS[sampler], seed, RIDGE, num_replications=100 if sampler == "amis" else 300)
    assert found.names == ("a", "b", "log_likelihood", "ab")
    assert least_p(found) > 1e-4
    assert found.failed.mean() <= 0.01


@pytest.mark.slow
def test_the_published_walk_does_not_cross_it_and_is_counted():
    model = Model(simulate_product, product_likelihood, PLANE)
    found = run(named("random_walk_paper"), 0, model, num_replications=50, batch=50)
    assert found.failures["not mixed"].mean() > 0.5
    assert found.verdict.status == "failed"
    assert found.verdict.findings[2].code == "calibration_failures"
    assert len(found.ranks) == 50  # none was dropped


def broken(key, problem, options):
    """Not a number where the first datum is above one, and never arrived where it is below zero."""
    draws = exact()(key, problem, options)
    theta = jnp.where(problem.data[0] > 1, jnp.nan, draws.theta["a"])
    return draws._replace(theta={"a": theta}, arrived=problem.data[0] > 0)


def test_failures_are_counted_and_stay_in_the_ranks():
    found = run(sampler_of(broken))
    shares = {reason: each.mean() for reason, each in found.failures.items()}
    # A third of the box on either side; 300 replications scatter by 0.03.
    assert abs(shares["not finite"] - 1 / 3) < 0.12
    assert abs(shares["not arrived"] - 1 / 3) < 0.12
    assert shares["not mixed"] == 0
    assert np.all(found.ranks[found.failures["not finite"]] == 0)
    assert not found.inside[found.failures["not finite"]].any()
    assert found.failed.sum() == sum(each.sum() for each in found.failures.values())
    assert {one.status for one in found.verdict.findings} == {"failed"}


def test_ties_fall_at_random():
    """A quantity that is the same everywhere ranks uniformly."""
    model = Model(simulate, log_likelihood, BOX, {"same": lambda theta, data: jnp.zeros(())})
    found = run(EXACT, model=model)
    assert found.p_ecdf["same"] > 1e-4


def test_batches_do_not_matter_but_to_the_speed():
    whole = run(EXACT, num_replications=30, batch=30)
    parts = run(EXACT, num_replications=30, batch=7)
    np.testing.assert_array_equal(whole.ranks, parts.ranks)


def test_r_hat_of_chains_apart():
    rng = np.random.default_rng(0)
    draws = rng.normal(size=(4, 500, 3))
    draws[0, :, 1] += 3.0
    draws[..., 2] = 1.0
    together, apart, still = split_r_hat(jnp.asarray(draws))
    assert 0.99 < together < 1.02
    assert apart > 1.5
    assert still == 1


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"num_replications": 0}, "`num_replications` must be at least 1"),
        ({"batch": -1}, "`batch` must be at least 1"),
    ],
)
def test_counts_that_cannot_be_meant(options, says):
    with pytest.raises(ConfigError, match=says):
        run(EXACT, **options)


def test_a_quantity_needs_a_name_of_its_own():
    model = Model(simulate, log_likelihood, BOX, {"a": lambda theta, data: theta["a"]})
    with pytest.raises(ConfigError, match="'a' has a reserved name"):
        run(EXACT, model=model)
