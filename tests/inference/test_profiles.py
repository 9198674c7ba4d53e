"""Profiles against quadratics, curves of a product, and scipy on the problem with a value held."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import chi2

from jbw.inference.fit.costly_fit import costly_fit, trust_region
from jbw.inference.fit.profiles import profile_statements, profiles
from jbw.inference.space.box import box
from jbw.report.messages.identified import better_fit, profile_refused

X = np.linspace(0.0, 1.0, 30)
REACH = np.sqrt(chi2.ppf(0.99, 1))


def line(theta, data):
    return (theta["offset"] + theta["slope"] * X - data) / 0.1


def curve(theta, data):
    return (theta["height"] * jnp.exp(-theta["rate"] * X) - data) / 0.05


def of_product(theta, data):
    return data * (theta["a"] * theta["b"] - 6)


def measured(values, noise):
    return jnp.asarray(values + noise * np.random.default_rng(3).standard_normal(len(X)))


def test_a_gaussian_profile_is_the_quadratic_of_its_marginal():
    data = measured(0.3 + 0.8 * X, 0.1)
    bounds = box({"offset": (-2.0, 2.0), "slope": (-3.0, 3.0)})
    best = costly_fit(line, bounds, data, starts={"offset": 0.0, "slope": 0.0})
    found = profiles(line, bounds, data, best)
    design = np.column_stack([np.ones(30), X]) / 0.1
    std = np.sqrt(np.diag(np.linalg.inv(design.T @ design)))
    mean = np.linalg.lstsq(design, np.asarray(data) / 0.1)[0]
    for i, name in enumerate(bounds.names):
        one = found[name]
        z = (one.values - mean[i]) / std[i]
        assert len(z) == 9
        np.testing.assert_allclose(z[[0, -1]], [-3.0, 3.0], rtol=1e-6)
        # The fit and its points are right to 1e-7 of chi-square, some 30.
        np.testing.assert_allclose(one.chi_square, z**2, atol=1e-5)
        np.testing.assert_allclose(
            one.interval, mean[i] + REACH * std[i] * np.array([-1, 1]), rtol=1e-5
        )
        assert one.open == (False, False)
        assert one.better < 1e-5


def test_a_curved_profile_against_scipy_with_the_value_held():
    data = measured(2.0 * np.exp(-1.5 * X), 0.05)
    bounds = box({"height": (0.5, 8.0), "rate": (0.05, 9.0)})
    best = costly_fit(curve, bounds, data, starts={"height": 1.0, "rate": 1.0})
    found = profiles(curve, bounds, data, best)["rate"]

    def held(rate):
        def cost(height):
            return float(np.sum((height[0] * np.exp(-rate * X) - data) ** 2)) / 0.05**2

        return minimize(cost, [2.0], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-9})

    least = 2 * best.cost
    expected = [held(rate).fun - least for rate in found.values]
    np.testing.assert_allclose(found.chi_square, expected, atol=1e-4)
    heights = [held(rate).x[0] for rate in found.values]
    np.testing.assert_allclose(found.path["height"], heights, rtol=1e-4)
    # At the ends of the interval chi-square has risen by 6.63; a straight line between points
    # 0.75 standard deviations apart is right to one per cent of that.
    for end in found.interval:
        assert held(end).fun - least == pytest.approx(6.635, rel=0.01)


def test_the_profile_of_a_factor_is_flat_until_the_other_meets_its_bound():
    bounds = box({"a": (1.0, 4.0), "b": (1.0, 9.0)})
    data = jnp.full(4, 3.0)
    best = costly_fit(of_product, bounds, data, starts={"a": 2.0, "b": 3.0})
    found = profiles(of_product, bounds, data, best)
    assert found["a"].open == (True, True)
    assert found["a"].interval == pytest.approx((1.0, 4.0), rel=1e-9)
    assert np.max(found["a"].chi_square) < 1e-6
    np.testing.assert_allclose(found["a"].path["a"] * found["a"].path["b"], 6.0, rtol=1e-4)
    # b beyond 6 needs a below its bound, where chi-square is 36 (b - 6)^2, and b below 1.5 needs a
    # above it, where it is 36 (4 b - 6)^2: the valley ends in walls, met within some per cent.
    low, high = found["b"].interval
    assert found["b"].open == (False, False)
    assert low == pytest.approx(1.5 - REACH / 24, rel=0.03)
    assert high == pytest.approx(6 + REACH / 6, rel=0.01)


def test_a_limit_on_one_side_is_said_to_be_one():
    def saturating(theta, data):
        return jnp.atleast_1d(data * jnp.exp(-theta["rate"]))

    bounds = box({"rate": (0.0, 50.0)})
    best = costly_fit(saturating, bounds, jnp.asarray(10.0), starts={"rate": 3.0})
    found = profiles(saturating, bounds, jnp.asarray(10.0), best)
    assert found["rate"].open == (False, True)
    assert found["rate"].interval[1] == 50.0


def test_one_compiled_residual_serves_every_point_and_parameter():
    calls = []

    def counted(theta, data):
        calls.append(1)  # once a trace
        return line(theta, data)

    data = measured(0.3 + 0.8 * X, 0.1)
    bounds = box({"offset": (-2.0, 2.0), "slope": (-3.0, 3.0)})
    best = costly_fit(counted, bounds, data, starts={"offset": 0.0, "slope": 0.0})
    traced = len(calls)
    profiles(counted, bounds, data, best)
    assert len(calls) == traced


def test_a_profile_that_finds_a_better_fit_says_so():
    data = measured(0.3 + 0.8 * X, 0.1)
    bounds = box({"offset": (-2.0, 2.0), "slope": (-3.0, 3.0)})
    best = costly_fit(line, bounds, data, starts={"offset": 0.0, "slope": 0.0}, max_evaluations=1)
    found = profiles(line, bounds, data, best)
    assert found["slope"].better > 1
    assert np.min([np.min(one.chi_square) for one in found.values()]) == 0.0
    assert profile_statements(found)[-1] == better_fit(max(one.better for one in found.values()))


def cliff(theta, data):
    """A line through data, which cannot be solved for an offset above 0.35."""
    return jnp.where(theta["offset"] > 0.35, jnp.nan, 1.0) * line(theta, data)


def sharp(theta, data):
    """The same up to the edge, whose differences there are of numbers that overflow."""
    return line(theta, data) * jnp.where(theta["offset"] > 0.35, 1e308, 1.0)


@pytest.mark.parametrize("residual", [cliff, sharp])
def test_a_profile_ends_where_the_model_cannot_be_solved(residual):
    data = measured(0.3 + 0.8 * X, 0.1)
    bounds = box({"offset": (-2.0, 2.0), "slope": (-3.0, 3.0)})
    best = costly_fit(residual, bounds, data, starts={"offset": 0.0, "slope": 0.0})
    found = profiles(residual, bounds, data, best)
    design = np.column_stack([np.ones(30), X]) / 0.1
    mean = np.linalg.lstsq(design, np.asarray(data) / 0.1)[0]
    std = np.sqrt(np.diag(np.linalg.inv(design.T @ design)))
    # Below, the straight line's own interval; above, the edge at 0.35 lies within it and ends it,
    # up to the halvings of the gap to the first point beyond, a quarter of three deviations.
    assert mean[0] < 0.35 < mean[0] + REACH * std[0]
    low, high = found["offset"].interval
    assert low == pytest.approx(mean[0] - REACH * std[0], rel=1e-4)
    assert 0.35 <= high <= 0.35 + 0.75 * std[0]
    for one in found.values():
        assert np.all(np.isfinite(one.chi_square))
    if residual is cliff:
        assert found["offset"].num_refused > 0
        refused = profile_refused("offset", found["offset"].num_refused)
        assert refused in profile_statements(found)


def test_a_fit_refuses_and_counts_points_that_cannot_be_solved():
    def walled(theta, data):
        beyond = theta["slope"] > 0.9
        return jnp.where(beyond, jnp.nan, 1.0) * line(theta, data) * (1 + theta["slope"] ** 4)

    data = measured(0.3 + 0.8 * X, 0.1)
    bounds = box({"offset": (-2.0, 2.0), "slope": (-3.0, 3.0)})
    starts = {"offset": np.array([0.0, 0.5]), "slope": np.array([-2.5, 2.0])}
    found = costly_fit(walled, bounds, data, starts=starts)
    assert np.isfinite(found.cost)
    assert found.theta["slope"] < 0.9
    assert found.num_refused >= 1  # the second start, at least
    assert found.waterfall[-1] == np.inf


def test_steps_beyond_what_can_be_solved_are_counted():
    """The optimum, at a slope of 0.8, lies beyond the wall at 0.5: the first step leads there."""

    def walled(theta, data):
        return jnp.where(theta["slope"] > 0.5, jnp.nan, 1.0) * line(theta, data)

    data = measured(0.3 + 0.8 * X, 0.1)
    bounds = box({"offset": (-2.0, 2.0), "slope": (-3.0, 3.0)})
    found = costly_fit(walled, bounds, data, starts={"offset": 0.0, "slope": -1.0})
    assert np.isfinite(found.cost)
    assert found.num_refused >= 1
    assert -1.0 < found.theta["slope"] <= 0.5


def test_a_point_whose_slope_cannot_be_had_is_refused():
    """Of (s - 0.8, 1): beyond 0.5 the residual is a number, and its derivative is none."""

    def part(s, which):
        slope = np.array([[np.nan if s[0] > 0.5 else 1.0], [0.0]])
        return slope if which else np.array([s[0] - 0.8, 1.0])

    end = trust_region(part, np.array([0.1]), 60, 1e-10)
    assert 0.1 < end.x[0] <= 0.5
    assert end.num_refused >= 1
    refused = trust_region(part, np.array([0.6]), 60, 1e-10)
    assert (refused.cost, refused.num_refused) == (np.inf, 1)
