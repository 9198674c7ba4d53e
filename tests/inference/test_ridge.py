"""Sampling along a ridge from wall to wall leaves the posterior as it is, and mixes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import kstest, norm
from tiers import represented_by

from jbw.inference.fit.fitting import fit
from jbw.inference.posterior.summary import summarise
from jbw.inference.samplers import amis
from jbw.inference.samplers.sampling import sample
from jbw.inference.space.box import box
from jbw.inference.space.problem import problem_of
from jbw.inference.space.ridge import along_ridge, walls

PRIOR = box({"a": (1.0, 20.0), "b": (1.0, 30.0), "c": (-1.0, 1.0)})
STD = 0.02  # of log(a b), and of c
SEEDS = (0, 1, 2)


def residual(theta, data):
    product = (jnp.log(theta["a"]) + jnp.log(theta["b"]) - data) / STD
    return jnp.stack([product, theta["c"] / STD])


def log_likelihood(theta, data):
    return -0.5 * residual(theta, data) ** 2


def flat(theta, data):
    return jnp.zeros(1) + 0.0 * theta["c"]


@pytest.fixture(scope="module")
def best():
    return fit(residual, PRIOR, jnp.log(60.0), starts=8, key=jax.random.key(0))


def drawn(function, best, seed, **options):
    options = {"sampler": "nuts", "chain_method": "vectorized", **options}
    return along(jax.random.key(seed), function, PRIOR, jnp.log(60.0), best, **options)


def along(key, function, prior, data, best, **options):
    place = along_ridge(best.theta, best.covariance, prior)
    return sample(key, function, prior, data, coordinates=place, **options)


@pytest.mark.parametrize("seed", represented_by(*SEEDS))
def test_the_ridge_of_a_product_mixes_and_has_its_moments(best, seed):
    # Given a, b is narrow: the density of a is that of 1 / a, where b = 60 / a is in its box.
    weight = quad(lambda a: 1 / a, 2.0, 20.0)[0]
    mean = quad(lambda a: 1.0, 2.0, 20.0)[0] / weight
    square = quad(lambda a: a, 2.0, 20.0)[0] / weight
    tree = drawn(log_likelihood, best, seed)
    rows = summarise(tree, PRIOR)
    assert rows["a"]["r_hat"] < 1.01
    assert rows["a"]["ess_bulk"] > 400
    error = rows["a"]["sd"] / np.sqrt(rows["a"]["ess_bulk"])
    # The ends of b's box are blurred by 2 % of b: some 1e-3 of the mean of a.
    assert rows["a"]["mean"] == pytest.approx(mean, abs=4 * error + 2e-3 * mean)
    assert rows["a"]["sd"] == pytest.approx(np.sqrt(square - mean**2), rel=0.1)
    product = np.log(tree["posterior"]["a"] * tree["posterior"]["b"])
    assert float(product.std()) == pytest.approx(STD, rel=0.1)


def test_a_factor_that_may_be_zero_by_its_prior_alone_follows_the_product_too():
    # b = 0 is out of the question by the data: along the logarithms the ridge is straight.
    prior = box({"a": (1.0, 20.0), "b": (-3.0, 30.0), "c": (-1.0, 1.0)})

    def residual(theta, data):
        product = (theta["a"] * theta["b"] / data - 1.0) / 1e-3
        return jnp.stack([product, theta["c"] / STD])

    best = fit(residual, prior, 60.0, starts=8, key=jax.random.key(0))
    place = along_ridge(best.theta, best.covariance, prior)
    problem = problem_of(lambda theta, data: -0.5 * residual(theta, data) ** 2, prior, 60.0, place)
    # A uniform r from a Gaussian: half of the points. By b itself the hyperbola leaves 5 of 512.
    assert amis.look(jax.random.key(0), problem, 512) > 128


@pytest.mark.parametrize("seed", represented_by(*SEEDS))
def test_without_data_the_uniform_prior_comes_back(best, seed):
    tree = drawn(flat, best, seed, sampler="random_walk", num_samples=20_000)
    for name, row in summarise(tree, PRIOR).items():
        i = PRIOR.names.index(name)
        x = (tree["posterior"][name].values - float(PRIOR.lower[i])) / float(
            PRIOR.upper[i] - PRIOR.lower[i]
        )
        thinned = x.ravel()[:: int(np.ceil(x.size / row["ess_bulk"]))]
        assert kstest(thinned, "uniform").pvalue > 1e-4, name


def test_the_evidence_is_that_of_the_box(best):
    # c is a normal of STD in a box of width 2; a b is log-normal about 60 in a box of 19 x 29.
    inner = quad(lambda a: 60 / a * np.exp(STD**2 / 2), 2.0, 20.0)[0] * STD * np.sqrt(2 * np.pi)
    evidence = np.log(inner / (19 * 29)) + np.log(STD * np.sqrt(2 * np.pi) / 2)
    tree = drawn(log_likelihood, best, 0, sampler="importance", num_samples=4000)
    # The blur of b's ends changes it by 1e-3.
    assert tree.attrs["log_evidence"] == pytest.approx(
        evidence, abs=4 * tree.attrs["log_evidence_error"] + 2e-3
    )


def test_points_lie_inside_the_box_and_walls_on_it(best):
    place = along_ridge(best.theta, best.covariance, PRIOR)
    rng = np.random.default_rng(0)
    inside = 0
    for _ in range(200):
        u = rng.uniform(0.1 * place.lower, 0.1 * place.upper)
        u[-1] = rng.uniform()
        if np.isfinite(float(place.outer.log_abs_det_jacobian(jnp.asarray(u)))):
            inside += 1
            theta = place.outer.forward(jnp.asarray(u))
            assert np.all((theta >= PRIOR.lower) & (theta <= PRIOR.upper))
    assert inside > 50
    ridge = place.outer.parts[0]
    low, high = walls(ridge.origin, ridge.along)
    for tau in (low, high):
        s = np.asarray(ridge.origin + tau * ridge.along)
        assert np.min(np.abs(np.concatenate([s, 1 - s]))) < 1e-12


def test_one_parameter_goes_from_wall_to_wall():
    prior = box({"a": (1.0, 3.0)})
    best = fit(lambda t, d: (t["a"] - d)[None] / 0.1, prior, 2.0, starts=4, key=jax.random.key(0))
    tree = along(
        jax.random.key(1), lambda t, d: -0.5 * ((t["a"] - d) / 0.1) ** 2, prior, 2.0, best,
        sampler="random_walk", num_samples=10_000, chain_method="vectorized",
    )  # fmt: skip
    row = summarise(tree, prior)["a"]
    assert row["mean"] == pytest.approx(2.0, abs=4 * 0.1 / np.sqrt(row["ess_bulk"]))
    assert tree["posterior"]["a"].attrs["upper"] == 3.0


def test_a_fit_in_the_corner_is_no_obstacle():
    prior = box({"a": (1.0, 2.0), "b": (1.0, 2.0)})

    def far(theta, data):  # its optimum lies beyond the corner (2, 2)
        return jnp.stack([(theta["a"] - 2.1) / 0.1, (theta["b"] - 2.1) / 0.1])

    best = fit(far, prior, None, starts=4, key=jax.random.key(0))
    assert best.at_bound == {"a": "upper", "b": "upper"}
    tree = along(
        jax.random.key(1), lambda t, d: -0.5 * far(t, d) ** 2, prior, None, best,
        sampler="random_walk", num_samples=20_000, chain_method="vectorized",
    )  # fmt: skip
    row = summarise(tree, prior)["a"]
    # A normal cut off one standard deviation below its mean.
    mean = 2.1 - 0.1 * norm.pdf(1) / norm.cdf(-1)
    assert row["mean"] == pytest.approx(mean, abs=4 * row["sd"] / np.sqrt(row["ess_bulk"]))
