"""Simulation-based calibration on posteriors with closed forms, right ones and wrong ones.

Seeds were fixed before the first run; statistical tests hold at p = 1e-4 on all of them.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.scipy.stats import norm

from jbw.errors import ConfigError
from jbw.inference.box import box
from jbw.inference.calibration import Model, calibrate, split_r_hat
from jbw.inference.lane_fit import About
from jbw.inference.lane_importance import weighted
from jbw.inference.lanes import CHAINS, Draws, chains, gridded, tempered

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


def exact(factor=1.0):
    """Independent draws of the closed form, a normal distribution cut off by the box."""

    def draw(key, log_likelihood, box, data):
        mean, sd = jnp.mean(data), factor * STD / np.sqrt(COUNT)
        low, high = (norm.cdf((edge[0] - mean) / sd) for edge in (box.lower, box.upper))
        share = low + (high - low) * jax.random.uniform(key, (4, 250))
        return Draws({"a": mean + sd * jax.scipy.special.ndtri(share)}, jnp.array(True))

    return draw


EXACT = exact()  # one object: compiled once for all tests of equal counts
RIGHT = Model(simulate, log_likelihood, BOX)


def run(sampler, seed=0, model=None, **options):
    model = model or RIGHT
    options = {"num_replications": 300, **options}
    return calibrate(jax.random.key(seed), model, sampler, **options)


def least_p(found):
    return min(*found.p_ecdf.values(), *found.p_chi_square.values())


@pytest.mark.parametrize("seed", SEEDS)
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


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_posterior_of_the_wrong_width_is_not(factor):
    found = run(exact(factor))
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

    def prior(key, log_likelihood, box, data):
        width = box.upper[0] - box.lower[0]
        return Draws(
            {"a": box.lower[0] + width * jax.random.uniform(key, (4, 250))}, jnp.array(True)
        )

    found = run(prior)
    assert found.p_ecdf["a"] > 1e-4
    assert found.p_ecdf["log_likelihood"] < 1e-10


SAMPLERS = {
    "importance": weighted(About(residual), 1024, 512),
    "tempered_smc": tempered(256, 2),
    "quadrature": gridded(256, 512),
    "random_walk": chains("random_walk", 200, 300),
    "elliptical_slice": chains("elliptical_slice", 20, 125, about=About(residual)),
}


LONG_TO_COMPILE = ("tempered_smc", "elliptical_slice")


@pytest.mark.parametrize(
    "sampler",
    [pytest.param(n, marks=pytest.mark.slow) if n in LONG_TO_COMPILE else n for n in SAMPLERS],
)
def test_samplers_in_lanes_are_calibrated(sampler):
    found = run(SAMPLERS[sampler])
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
    simulate_product, product_likelihood, PLANE, {"ab": lambda theta, _: theta["a"] * theta["b"]}
)
ACROSS = weighted(About(product_residual, ("a", "b")))


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_a_thin_ridge_through_the_box(seed):
    found = run(ACROSS, seed, RIDGE)
    assert found.names == ("a", "b", "log_likelihood", "ab")
    assert least_p(found) > 1e-4
    assert found.failed.mean() < 0.01


@pytest.mark.slow
def test_the_published_walk_does_not_cross_it_and_is_counted():
    model = Model(simulate_product, product_likelihood, PLANE)
    found = run(chains("random_walk_paper", 85, 765), 0, model, num_replications=50, batch=50)
    assert found.failures["not mixed"].mean() > 0.5
    assert found.verdict.status == "failed"
    assert found.verdict.findings[2].code == "calibration_failures"
    assert len(found.ranks) == 50  # none was dropped


def broken(key, log_likelihood, box, data):
    """Not a number where the first datum is above one, and never arrived where it is below zero."""
    draws = exact()(key, log_likelihood, box, data)
    theta = jnp.where(data[0] > 1, jnp.nan, draws.theta["a"])
    return Draws({"a": theta}, data[0] > 0)


def test_failures_are_counted_and_stay_in_the_ranks():
    found = run(broken)
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
    assert still == pytest.approx(np.sqrt(249 / 250))


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"num_replications": 0}, "`num_replications` must be at least 1"),
        ({"num_ranks": 0}, "`num_ranks` must be at least 1"),
        ({"batch": -1}, "`batch` must be at least 1"),
    ],
)
def test_counts_that_cannot_be_meant(options, says):
    with pytest.raises(ConfigError, match=says):
        run(EXACT, **options)


def test_a_quantity_needs_a_name_of_its_own():
    model = Model(simulate, log_likelihood, BOX, {"a": lambda theta, data: theta["a"]})
    with pytest.raises(ConfigError, match="'a' is named like"):
        run(EXACT, model=model)


def test_samplers_that_cannot_be_meant():
    with pytest.raises(ConfigError, match=f"one of {', '.join(CHAINS)}, not 'hmc'"):
        chains("hmc")
    with pytest.raises(ConfigError, match="needs to know where"):
        chains("elliptical_slice")
    with pytest.raises(ConfigError, match="takes one parameter"):
        run(gridded(), model=Model(simulate_product, product_likelihood, PLANE))
