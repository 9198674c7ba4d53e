"""Mixtures of t distributions against scipy's density, and refits against what was drawn.

Seeds were fixed before the first run.
"""

import numpy as np
import pytest
from scipy.stats import multivariate_normal, multivariate_t

from jbw.inference.samplers.mixtures import Mixture, draw, log_density, refitted, standard

SEEDS = (0, 1, 2)
DEGREES = 5.0  # of freedom, of every component
CENTRES = np.array([[0.0, 1.0, -2.0], [12.0, -9.0, 4.0]])
ROOTS = np.array(
    [
        [[1.0, 0.0, 0.0], [0.4, 0.7, 0.0], [-0.3, 0.2, 1.5]],
        [[0.5, 0.0, 0.0], [-0.2, 1.2, 0.0], [0.1, 0.6, 0.8]],
    ]
)
TWO = Mixture(np.array([0.3, 0.7]), CENTRES, ROOTS)
ONE = Mixture(np.ones(1), CENTRES[:1], ROOTS[:1])
EVEN = 2000


def evenly(count=EVEN):
    return np.full(count, 1 / count)


def test_the_density_is_the_sum_of_the_t_densities_of_scipy():
    x = np.random.default_rng(0).normal(scale=8.0, size=(200, 3))
    exact = sum(
        share * multivariate_t(centre, root @ root.T, DEGREES).pdf(x)
        for share, centre, root in zip(*TWO, strict=True)
    )
    # Rounding of triangular solves and of scipy's eigenvalues.
    np.testing.assert_allclose(log_density(TWO, x), np.log(exact), rtol=1e-11)
    about_zero = multivariate_t(np.zeros(3), np.eye(3), DEGREES).logpdf(x)
    np.testing.assert_allclose(log_density(standard(3), x), about_zero, rtol=1e-12)


@pytest.mark.parametrize("seed", SEEDS)
def test_draws_have_the_shares_centres_and_spread_of_their_components(seed):
    count = 40_000
    x = draw(np.random.default_rng(seed), TWO, count)
    second = x[:, 0] > 6  # 10 scale units from both: a tail of 1e-4
    assert abs(second.mean() - 0.7) < 4 * np.sqrt(0.21 / count) + 2e-4
    for i, own in enumerate((x[~second], x[second])):
        covariance = ROOTS[i] @ ROOTS[i].T * DEGREES / (DEGREES - 2)
        error = np.sqrt(np.diag(covariance) / len(own))
        # What is sorted to the wrong side moves a mean by 1e-4 of the distance of 20.
        assert np.all(np.abs(own.mean(axis=0) - CENTRES[i]) < 4 * error + 2e-3)
        # Of five degrees of freedom the kurtosis is 9: a variance is known to sqrt(8 / n), a
        # covariance to less. What is sorted wrongly adds 1e-4 of the distance squared.
        size = np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
        off = np.abs(np.cov(own.T) - covariance) / size
        assert off.max() < 4 * np.sqrt(8 / len(own)) + 2e-2


def spread_of(mixture, number):
    return mixture.roots[number] @ mixture.roots[number].T


@pytest.mark.parametrize("seed", SEEDS)
def test_two_components_far_apart_are_found(seed):
    rng = np.random.default_rng(seed)
    found = refitted(rng, draw(rng, TWO, EVEN), evenly())
    nearest = np.argmin(
        np.linalg.norm(found.centres[:, None] - CENTRES, axis=2), axis=1
    )  # of the two, for each found
    for i, share in enumerate(TWO.shares):
        mine = np.flatnonzero(nearest == i)
        assert mine.size
        shares = found.shares[mine]
        assert abs(shares.sum() - share) < 4 * np.sqrt(0.21 / EVEN)
        centre = shares @ found.centres[mine] / shares.sum()
        covariance = ROOTS[i] @ ROOTS[i].T
        # The information of a t distribution's centre is (nu + d) / (nu + d + 2) of a normal's.
        error = np.sqrt(np.diag(covariance) * 10 / 8 / (share * EVEN))
        assert np.all(np.abs(centre - CENTRES[i]) < 4 * error)
        if mine.size == 1:
            # The overall covariance leans in with 1.5 points of some 600 or 1400: of a
            # distance of 12 between the centres, 30 times the variance, that is 8 %.
            ratio = np.diag(spread_of(found, mine[0])) / np.diag(covariance)
            assert np.all(np.abs(ratio - 1) < 4 * np.sqrt(3.5 / (share * EVEN)) + 0.15)


@pytest.mark.parametrize("seed", SEEDS)
def test_points_of_one_t_distribution_are_not_followed_by_many_components(seed):
    rng = np.random.default_rng(seed)
    found = refitted(rng, draw(rng, ONE, EVEN), evenly())
    # A second component is taken now and then by chance; more than that would be the points' own.
    assert len(found.shares) <= 2
    fresh = draw(rng, ONE, 20_000)
    exact = multivariate_t(CENTRES[0], ROOTS[0] @ ROOTS[0].T, DEGREES).logpdf(fresh)
    lost = exact - log_density(found, fresh)
    # A fit of p numbers to n points loses p / (2 n) nats in the mean, here 19 at most; a chi-square
    # of so many is below 2.5 times that but for 1e-4 of cases.
    assert lost.mean() < 2.5 * 19 / (2 * EVEN) + 4 * lost.std() / np.sqrt(lost.size)


@pytest.mark.parametrize("seed", SEEDS)
def test_weights_lead_the_refit_to_another_density(seed):
    rng = np.random.default_rng(seed)
    wide = multivariate_normal(np.zeros(2), 9 * np.eye(2))
    target = multivariate_t([2.0, -1.0], [[1.0, 0.5], [0.5, 0.8]], DEGREES)
    x = wide.rvs(2 * EVEN, random_state=rng)
    weights = target.pdf(x) / wide.pdf(x)
    weights /= weights.sum()
    effective = 1 / np.sum(weights**2)
    assert effective > 400  # otherwise the test could not tell
    found = refitted(rng, x, weights)
    centre = found.shares @ found.centres
    # As of so many points, 9 / 7 for the t distribution.
    assert np.all(
        np.abs(centre - [2.0, -1.0]) < 4 * np.sqrt([1.0, 0.8]) * np.sqrt(9 / 7 / effective)
    )
    # Points alone, without the weights, are about zero: 30 times that away.
    assert np.linalg.norm(x.mean(axis=0)) < 0.3
    assert abs(found.shares.sum() - 1) < 1e-12


def test_points_of_no_weight_do_not_matter():
    rng = np.random.default_rng(0)
    x = draw(rng, ONE, 1000)
    away = np.concatenate([x, x[::2] + 1000.0])  # 1000 points and 500: parity is kept
    weights = np.concatenate([evenly(1000), np.zeros(500)])
    one = refitted(np.random.default_rng(1), x, evenly(1000))
    other = refitted(np.random.default_rng(1), away, weights)
    # The same sums, with zeros between.
    np.testing.assert_allclose(other.centres, one.centres, rtol=1e-9)
    np.testing.assert_allclose(other.roots, one.roots, rtol=1e-9, atol=1e-9)


def test_points_that_coincide_in_part_are_survived():
    rng = np.random.default_rng(0)
    x = np.repeat(rng.normal(size=(40, 3)), 50, axis=0)
    found = refitted(rng, x, evenly(2000))
    assert np.all(np.isfinite(log_density(found, x)))
    assert abs(found.shares.sum() - 1) < 1e-12
    first = np.repeat(rng.normal(size=(1, 3)), 500, axis=0)
    first[250:] += [1.0, 2.0, 4.0]  # on a line: the covariance is of rank one
    line = refitted(rng, first, evenly(500))
    assert np.all(np.isfinite(log_density(line, first)))
    assert np.all(np.isfinite(draw(rng, line, 10)))
