"""Draws of a Gaussian within bounds, against moments by quadrature and mpmath."""

import mpmath
import numpy as np
import pytest
from scipy import stats

from jbw.inference.samplers.truncated_gaussian import draws_within, log_mass, mixture_within

# Correlated, and the first parameter's mean 15 standard deviations below its bound.
MEAN = np.array([-15.0, 2.0])
COVARIANCE = np.array([[1.0, -0.9], [-0.9, 4.0]])


def test_a_mean_far_beyond_a_bound_leaves_draws_at_the_bound_and_the_rest_along_it():
    lower, upper = np.array([0.0, -np.inf]), np.full(2, np.inf)
    rng = np.random.default_rng(1)
    points, w, log_weight = draws_within(rng, MEAN, COVARIANCE, lower, upper, 20_000)
    assert points[:, 0].min() >= 0.0
    # One parameter is bounded: every draw has the same weight, and it is the mass beyond.
    np.testing.assert_allclose(log_weight, stats.norm.logsf(15.0), rtol=1e-12)
    beyond = stats.truncnorm(15.0, np.inf, loc=-15.0)
    mean = np.array([beyond.mean(), MEAN[1] - 0.9 * (beyond.mean() - MEAN[0])])
    std = np.array([beyond.std(), np.sqrt(4.0 - 0.81 + 0.81 * beyond.var())])
    # Five standard errors of means of 20,000 draws.
    assert np.all(np.abs(points.mean(axis=0) - mean) < 5 * std / np.sqrt(20_000))
    np.testing.assert_allclose(points.std(axis=0), std, rtol=0.05)
    root = np.linalg.cholesky(COVARIANCE)
    np.testing.assert_allclose(points, MEAN + w @ root.T, rtol=1e-12)


def test_two_bounded_parameters_have_the_moments_of_quadrature():
    lower, upper = np.array([-13.5, 1.0]), np.array([-12.0, 3.0])
    member = np.zeros(40_000, int)
    points, _ = mixture_within(
        np.random.default_rng(2), [(1.0, MEAN, COVARIANCE)], member, lower, upper
    )
    grid = [np.linspace(low, high, 801) for low, high in zip(lower, upper, strict=True)]
    places = np.stack(np.meshgrid(*grid, indexing="ij"), axis=-1)
    density = stats.multivariate_normal(MEAN, COVARIANCE).pdf(places)
    mean = np.einsum("ij,ijk->k", density, places) / density.sum()
    square = np.einsum("ij,ijk->k", density, (places - mean) ** 2) / density.sum()
    # Five standard errors, twice as large for draws that are taken again.
    assert np.all(np.abs(points.mean(axis=0) - mean) < 10 * np.sqrt(square / len(member)))
    np.testing.assert_allclose(points.std(axis=0), np.sqrt(square), rtol=0.03)
    assert np.all((points >= lower) & (points <= upper))


def test_members_of_a_mixture_count_by_what_lies_within():
    # One that lies half within the bounds, and one that lies 3 standard deviations outside.
    gaussians = [(0.5, np.zeros(1), np.eye(1)), (0.5, np.full(1, -3.0), 0.01 * np.eye(1))]
    member = np.repeat([0, 1], 5000)
    points, w = mixture_within(
        np.random.default_rng(3), gaussians, member, np.zeros(1), np.full(1, np.inf)
    )
    assert points.min() >= 0.0
    np.testing.assert_allclose(points, w)  # all of the first, whose root is one


@pytest.mark.parametrize(("a", "b"), [(-1.0, 2.0), (30.0, 30.1), (-40.0, -39.0), (-np.inf, np.inf)])
def test_the_mass_is_exact_far_out(a, b):
    with mpmath.workdps(400):
        exact = float(mpmath.log(mpmath.ncdf(b) - mpmath.ncdf(a)))
    found = log_mass(np.array([a]), np.array([b]))[0]
    assert found == pytest.approx(exact, rel=1e-12, abs=1e-15)
