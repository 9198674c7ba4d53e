"""Particles that take in record after record, against the closed form of a linear Gaussian."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from jbw.watch.sequential import ENOUGH, evenly, particles_of, take_in

NUM = 4000
FIRST = np.array([1.0, -2.0]), np.array([[1.0, 0.6], [0.6, 2.0]])  # posterior of a finished run
NOISE = 0.8  # sd of a record


def records(num, seed):
    """Readings of one combination each, of a truth that the run's posterior knows badly."""
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((num, 2))
    return rows, rows @ [1.8, -0.5] + NOISE * rng.standard_normal(num)


def exact(rows, values):
    """Mean, covariance, and log evidence of each record given those before it, by Kalman."""
    (mean, cov), evidence = FIRST, []
    for row, value in zip(rows, values, strict=True):
        spread = row @ cov @ row + NOISE**2
        evidence.append(norm.logpdf(value, row @ mean, np.sqrt(spread)))
        gain = cov @ row / spread
        mean, cov = mean + gain * (value - row @ mean), cov - np.outer(gain, row @ cov)
    return mean, cov, np.array(evidence)


def density(rows, values):
    """Log density of the posterior with these records, normalised over them."""

    def found(x):
        start = multivariate_normal(*FIRST).logpdf(x)
        return start + norm.logpdf(values, x @ rows.T, NOISE).sum(axis=-1)

    return found


def test_a_linear_gaussian_keeps_its_mean_covariance_and_evidence():
    rng = np.random.default_rng(0)
    rows, values = records(12, seed=1)
    x = rng.multivariate_normal(*FIRST, size=NUM)
    now, updates = particles_of(x, density(rows[:0], values[:0])), []
    for r in range(len(values)):
        updates.append(take_in(rng, now, density(rows[: r + 1], values[: r + 1])))
        now = updates[-1].particles
    mean, cov, evidence = exact(rows, values)
    kish = [update.kish for update in updates]
    assert min(kish) < ENOUGH < max(kish)  # some records moved the particles, others did not
    assert [update.accepted is not None for update in updates] == [k < ENOUGH for k in kish]
    weight = np.exp(now.log_weight)
    # Half of 4,000 particles count at least, and five moves leave some of them alike: a thousand
    # independent ones, of which means and variances are known to 3 and 4.5 %; five of these.
    sd = np.sqrt(np.diag(cov))
    assert np.all(np.abs(weight @ now.x - mean) < 5 * 0.032 * sd)
    covariance_error = np.cov(now.x.T, aweights=weight) - cov
    assert np.all(np.abs(covariance_error) < 5 * 0.045 * np.outer(sd, sd))
    assert weight.sum() == pytest.approx(1.0, rel=1e-12)
    # A step's relative error is sqrt((1/kish - 1) / n), at the worst record some 4 %.
    errors = np.sqrt((1 / np.array(kish) - 1) / 1000)
    assert np.all(
        np.abs([update.log_evidence for update in updates] - evidence) < 5 * errors + 0.01
    )


def test_resampling_is_even():
    """Each particle as often as its weight says, give or take one."""
    rng = np.random.default_rng(2)
    now = particles_of(np.arange(50.0)[:, None], lambda x: np.zeros(len(x)))
    weight = rng.dirichlet(np.ones(50))
    drawn = evenly(rng, now._replace(log_weight=np.log(weight)))
    count = np.bincount(drawn.x[:, 0].astype(int), minlength=50)
    assert np.all(np.abs(count - 50 * weight) < 1)
    assert np.allclose(np.exp(drawn.log_weight), 1 / 50)


def test_points_that_cannot_be_have_no_weight():
    """Beyond a prior's box the density is zero, before and behind the record."""
    rng = np.random.default_rng(3)

    def boxed(slope):
        return lambda x: np.where(np.abs(x[:, 0]) < 1.0, slope * x[:, 0], -np.inf)

    update = take_in(rng, particles_of(rng.uniform(-1, 1, (NUM, 1)), boxed(0.0)), boxed(8.0))
    x = update.particles.x[:, 0]
    assert update.accepted is not None
    assert np.all(np.abs(x) < 1.0)
    # Of exp(8 x) on [-1, 1] the mean is coth(8) - 1/8 and the evidence sinh(8) / 8.
    assert x.mean() == pytest.approx(1 / np.tanh(8) - 1 / 8, abs=5 * 0.125 / np.sqrt(500))
    assert update.log_evidence == pytest.approx(np.log(np.sinh(8) / 8), abs=5 * 0.032)
