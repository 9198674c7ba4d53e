"""The random walk on a known target, and divergences against golden numbers and quadrature."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scipy.integrate import quad
from scipy.stats import truncnorm

from jbw import rig
from jbw.errors import ConfigError, DataError
from jbw.paper.walk import (
    STEP_SIZE,
    coefficient_of_variation,
    kl_draws,
    kl_joint,
    kl_normal,
    random_walk,
)

PRIOR = {"x": (0.0, 1.0)}


def exponential(theta):
    """Log density of exp(-10 x) on [0, 1]."""
    return -10.0 * theta["x"]


def test_walk_keeps_detailed_balance_at_the_bound():
    # Mean of exp(-10 x) on [0, 1]: 0.1 - exp(-10)/(1 - exp(-10)) = 0.09995; clipping gives 0.065.
    walk = random_walk(
        jax.random.key(0), exponential, PRIOR, {"x": 0.2}, num_steps=40_000, step_size=None
    )
    assert len(walk.log_density) == 36_000
    # 0.1 scatter over some 4,000 effective draws: 0.0016.
    assert float(jnp.mean(walk.theta["x"])) == pytest.approx(0.09995, abs=0.006)
    assert float(jnp.mean(walk.accepted)) == pytest.approx(0.5, abs=0.1)
    assert float(walk.map["x"]) < 1e-2


def test_published_walk_cannot_leave_its_start():
    # 850 steps of sigma_p spread by sigma_p sqrt(850) = 0.073 of the box: a flat posterior, whose
    # draws should scatter by 0.29, scatters by what the walk allows.
    walk = random_walk(jax.random.key(1), lambda t: 0.0 * t["x"], PRIOR, {"x": 0.5})
    assert len(walk.theta["x"]) == 765
    assert float(jnp.std(walk.theta["x"])) < STEP_SIZE * np.sqrt(850)
    assert float(jnp.mean(walk.accepted)) == 1.0


def test_chains_run_side_by_side():
    def chain(key):
        return random_walk(key, exponential, PRIOR, {"x": 0.3}, num_steps=200).theta["x"]

    keys = jax.random.split(jax.random.key(0), 4)
    together = jax.vmap(chain)(keys)
    assert together.shape == (4, 180)
    np.testing.assert_allclose(together[2], chain(keys[2]), rtol=1e-12)


def test_golden_divergences_of_normals(golden):
    for case in golden["bayes"]["kl_truncated_normal_vs_uniform01"]["cases"]:
        found = kl_normal(case["mean_x"], case["sd_x"])
        # log_ndtr of JAX is good to some 1e-14; the golden numbers to 1e-15.
        assert float(found) == pytest.approx(case["kl_nats"], rel=1e-12)
        scaled = kl_normal(2 + 3 * case["mean_x"], 3 * case["sd_x"], 2.0, 5.0)
        assert float(scaled) == pytest.approx(case["kl_nats"], rel=1e-11)


@pytest.mark.parametrize(("mean", "std"), [(-0.4, 0.1), (1.5, 0.07), (0.5, 0.01), (0.3, 5.0)])
def test_divergence_of_a_normal_is_its_integral(mean, std):
    frozen = truncnorm(-mean / std, (1 - mean) / std, mean, std)

    def integrand(x):
        return frozen.pdf(x) * frozen.logpdf(x)

    peak = min(max(mean, 0.0), 1.0)
    by_quadrature = quad(integrand, 0, 1, points=[peak], limit=400, epsabs=1e-12)[0]
    assert float(kl_normal(mean, std)) == pytest.approx(by_quadrature, rel=1e-8, abs=1e-10)


def test_divergence_of_draws_is_that_of_their_normal():
    draws = truncnorm(-5, 5, 300.0, 20.0).rvs(4000, random_state=np.random.default_rng(2))
    # 4,000 draws: standard deviation 0.012 (theory: 0.03 at 765).
    assert kl_draws(draws, 200.0, 400.0) == pytest.approx(
        float(kl_normal(300.0, 20.0, 200.0, 400.0)), abs=0.06
    )
    by_hand = np.std(draws, ddof=1) / np.mean(draws)
    assert float(coefficient_of_variation(draws)) == pytest.approx(by_hand, rel=1e-12)


def test_joint_divergence_of_a_correlated_normal():
    # By hand: -h of a normal of two deviations 0.03 and correlation 0.9 in the unit square.
    std, rho = 0.03, 0.9
    rng = np.random.default_rng(5)
    cov = std**2 * np.array([[1, rho], [rho, 1]])
    draws = 0.5 + rng.multivariate_normal([0, 0], cov, size=8000)
    exact = -0.5 * np.log((2 * np.pi * np.e) ** 2 * np.linalg.det(cov))
    # 8,000 draws: 0.01 from each margin, 0.02 from the correlation.
    assert kl_joint(draws) == pytest.approx(exact, abs=0.06)
    scaled = kl_joint(draws * [3.0, 5.0] + [1.0, 2.0], np.array([1.0, 2.0]), np.array([4.0, 7.0]))
    assert scaled == pytest.approx(kl_joint(draws), abs=1e-9)


def test_divergence_is_differentiable():
    check_grads(jax.jit(kl_normal), (0.3, 0.2), 1, eps=1e-5)
    check_grads(jax.jit(kl_normal), (-0.3, 0.2), 1, eps=1e-5)


def test_what_has_no_divergence_or_walk_is_refused():
    with pytest.raises(ConfigError, match="prior must have a width above zero"):
        kl_normal(0.5, 0.1, 1.0, 1.0)
    with pytest.raises(ConfigError, match="prior must have a width above zero"):
        kl_draws(np.array([1.0, 1.0]), 1.0, 1.0)
    with pytest.raises(ConfigError, match="`std` must be greater than 0"):
        kl_normal(0.5, 0.0)
    with pytest.raises(DataError, match=r"must lie in the prior \[0, 1\], but reach from 0.5 to 2"):
        kl_draws(np.array([0.5, 2.0]))
    with pytest.raises(DataError, match="at least 2 draws"):
        kl_draws(np.array([0.5]))
    for options, message in (
        ({"num_steps": 1}, "`num_steps` must be at least 2"),
        ({"burn_in": 1.0}, "`burn_in` must be from 0"),
        ({"step_size": 0.0}, "`step_size` must be greater than 0"),
    ):
        with pytest.raises(ConfigError, match=message):
            random_walk(jax.random.key(0), exponential, PRIOR, {"x": 0.5}, **options)
    with pytest.raises(ConfigError, match="`start` must lie inside"):
        random_walk(jax.random.key(0), exponential, PRIOR, {"x": 1.0})


@pytest.mark.parametrize(
    ("name", "mean", "cv", "nats"),
    # Theory: a normal of the printed mean and CV has the greatest entropy, -ln(sqrt(2 pi e) s).
    [
        ("zeta", 0.00444, 0.0057, 2.82),
        ("alpha", 497.40, 0.0098, 2.10),
        ("delta", 340.21, 0.0098, 2.30),
    ],
)
def test_the_printed_variations_need_this_divergence_from_the_papers_priors(name, mean, cv, nats):
    low, high = rig.PRIOR[name]
    closed = -np.log(np.sqrt(2 * np.pi * np.e) * cv * mean / (high - low))
    found = float(kl_normal(mean, cv * mean, low, high))
    assert found == pytest.approx(
        closed, rel=1e-12
    )  # nothing is cut: ten deviations or more to each bound
    assert found == pytest.approx(nats, abs=0.005)
