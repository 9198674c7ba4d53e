"""Changes of variable: there and back, and the determinant of their derivatives by JAX."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from jbw.inference.fit.valley import Floor, along_valley
from jbw.inference.space.box import box
from jbw.inference.space.coordinates import (
    IDENTITY,
    Affine,
    Composed,
    Logarithms,
    interval,
    unit,
)
from jbw.inference.space.problem import problem_of
from jbw.inference.space.reparametrisation import along_logarithms, in_box
from jbw.inference.space.ridge import along_ridge

BOX = box({"a": (1.0, 20.0), "b": (1.0, 30.0), "c": (-1.0, 1.0)})
THETA = {"a": 8.0, "b": 7.0, "c": 0.1}
ROOT = np.array([[1.0, 0.0, 0.0], [-0.8, 0.05, 0.0], [0.0, 0.0, 0.02]]) * [[8.0], [7.0], [1.0]]
COVARIANCE = ROOT @ ROOT.T


def whitening():
    return Affine(jnp.array([0.2, -0.3, 0.1]), jnp.asarray(np.triu(ROOT.T) + 0.1 * np.eye(3)))


@cache
def ridge():
    return along_ridge(THETA, COVARIANCE, BOX)


@cache
def valley():
    """Along b, between knots of unequal width, with roots that are not diagonal."""
    roots = np.array([np.diag([0.1, 0.2]), [[0.3, 0.0], [0.2, 0.1]], np.diag([0.4, 0.5])])
    points = np.array([[0.1, 0.2, 0.5], [0.4, 0.5, 0.2], [0.3, 0.9, 0.7]])
    slopes = np.array([[1.0, -1.0], [0.3, 0.2], [-0.5, 2.0]])
    floor = Floor(1, points, slopes, np.array([4.0, 0.0, 2.0]), roots)
    outer = Composed((unit(BOX.lower, BOX.upper),))
    return along_valley(floor, outer, (jnp.zeros(3), jnp.ones(3)))


# Made by the tests and not as they are collected: what is made compiles.
COORDINATES = {
    "identity": (lambda: IDENTITY, [0.3, -2.0, 5.0]),
    "affine": (whitening, [0.3, -0.2, 0.5]),
    "interval": (lambda: interval(BOX.lower, BOX.upper), [0.3, -2.0, 5.0]),
    "unit": (lambda: unit(BOX.lower, BOX.upper), [0.3, 0.2, 0.9]),
    "logarithms": (lambda: Logarithms((True, False, True)), [0.3, -2.0, 1.0]),
    "ridge": (lambda: ridge().outer, [0.12, 0.01, 0.4]),
    "valley": (lambda: valley().outer, [0.3, 0.6, -0.7]),
    "beyond the valley": (lambda: valley().outer, [0.3, 0.95, -0.7]),
    "composed": (
        lambda: Composed((whitening(), interval(BOX.lower, BOX.upper))), [0.1, 0.2, -0.3],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", COORDINATES)
def test_there_and_back(name):
    made, x = COORDINATES[name]
    coordinate = made()
    back = coordinate.inverse(coordinate.forward(jnp.array(x)))
    np.testing.assert_allclose(back, x, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("name", COORDINATES)
def test_the_determinant_is_that_of_the_derivatives(name):
    made, x = COORDINATES[name]
    coordinate = made()
    jacobian = jax.jacfwd(coordinate.forward)(jnp.array(x))
    np.testing.assert_allclose(
        coordinate.log_abs_det_jacobian(jnp.array(x)), jnp.linalg.slogdet(jacobian)[1], rtol=1e-10
    )


def test_the_floor_of_a_valley_is_the_cubic_through_its_points_and_slopes():
    coordinate = valley().outer.parts[0]
    hermite = CubicHermiteSpline(coordinate.knots, coordinate.floor, coordinate.slopes)
    for q in (0.25, 0.5, 0.6, 0.85):
        found = coordinate.forward(jnp.array([0.0, q, 0.0]))
        np.testing.assert_allclose(found[jnp.array([0, 2])], hermite(q), rtol=1e-12)


def gaussian(theta, data):
    return -0.5 * jnp.square(jnp.stack([theta[n] for n in BOX.names]) - data)


PLACES = {
    "box": lambda: in_box(BOX, None, None, 4),
    "fit": lambda: in_box(BOX, THETA, COVARIANCE, 4),
    "logarithms": lambda: along_logarithms(THETA, COVARIANCE, BOX, ("a", "b")),
    "ridge": ridge,
    "valley": valley,
}


@pytest.mark.parametrize("name", PLACES)
def test_density_is_likelihood_prior_the_box_and_the_change_of_variable(name):
    data = jnp.array([7.0, 6.0, 0.0])
    problem = problem_of(gaussian, BOX, data, PLACES[name]())
    w = jnp.array([0.1, -0.2, 0.3])
    theta = problem.theta(w)
    slope = jnp.linalg.slogdet(jax.jacfwd(problem.coordinate.forward)(w))[1]
    inner = jnp.sum(gaussian(theta, data)) - np.log(19.0 * 29.0 * 2.0)
    np.testing.assert_allclose(problem.log_density(w), inner + slope, rtol=1e-12)


@pytest.mark.parametrize("value", [jnp.nan, jnp.inf, -jnp.inf])
def test_a_failed_solve_is_impossible_not_an_error(value):
    problem = problem_of(lambda theta, data: jnp.array([0.0, value]), BOX, None, PLACES["box"]())
    assert problem.log_density(jnp.zeros(3)) == -jnp.inf


def test_beyond_the_box_nothing_is_possible():
    problem = problem_of(gaussian, BOX, jnp.zeros(3), PLACES["logarithms"]())
    w = problem.coordinate.inverse(jnp.array([25.0, 7.0, 0.0]))
    assert problem.log_density(w) == -jnp.inf
