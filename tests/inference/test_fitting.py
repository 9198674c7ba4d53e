"""Least squares in the box against scipy's trust region and closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares

from jbw.errors import ConfigError, ModelError
from jbw.inference.fit.fitting import fit, to_first_order
from jbw.inference.space.box import box

TIME = np.linspace(0.0, 2.0, 60)
BOX = box({"rate": (0.1, 10.0), "size": (0.0, 5.0)})
TRACES = []


def decay(theta, data):
    TRACES.append(1)
    time, measured = data
    return (theta["size"] * jnp.exp(-theta["rate"] * time) - measured) / 0.01


def measured(rate, size, seed=0):
    noise = 0.01 * np.random.default_rng(seed).normal(size=TIME.shape)
    return size * np.exp(-rate * TIME) + noise


def oracle(data, bounds, start):
    def residual(p):
        return (p[1] * np.exp(-p[0] * TIME) - data) / 0.01

    return least_squares(residual, start, bounds=bounds, method="trf", xtol=1e-12, ftol=1e-12)


def test_optimum_and_covariance_match_scipy():
    data = measured(1.3, 2.0)
    got = fit(decay, BOX, (TIME, data), starts=8, key=jax.random.key(0))
    want = oracle(data, ([0.1, 0.0], [10.0, 5.0]), [1.0, 1.0])
    # Both stop where the cost moves by 1e-9 or less, so parameters agree to its square root.
    np.testing.assert_allclose([got.theta["rate"], got.theta["size"]], want.x, rtol=1e-5)
    np.testing.assert_allclose(got.cost, want.cost, rtol=1e-8)
    # scipy differentiates numerically, good to about 1e-7 of the Jacobian.
    np.testing.assert_allclose(got.covariance, np.linalg.inv(want.jac.T @ want.jac), rtol=1e-4)
    assert got.at_bound == {}
    assert got.weak is None
    value, dof = got.chi_square
    assert dof == 58
    assert 0.5 < value / dof < 1.6  # four deviations of a chi-square of 58
    assert np.all(np.diff(got.waterfall) >= 0)
    assert got.waterfall.shape == (8,)


def test_an_optimum_beyond_the_bound_is_reported_at_the_bound():
    narrow = box({"rate": (2.0, 10.0), "size": (0.0, 5.0)})
    data = measured(1.3, 2.0)
    got = fit(decay, narrow, (TIME, data), starts=8, key=jax.random.key(0))
    want = oracle(data, ([2.0, 0.0], [10.0, 5.0]), [3.0, 1.0])
    assert got.at_bound == {"rate": "lower"}
    np.testing.assert_allclose(got.theta["size"], want.x[1], rtol=1e-3)
    np.testing.assert_allclose(got.cost, want.cost, rtol=1e-3)


def test_other_data_of_the_same_shape_run_without_compiling_again():
    starts = {"rate": 1.0, "size": 1.0}
    fit(decay, BOX, (TIME, measured(1.0, 1.0)), starts=starts)
    before = len(TRACES)
    got = fit(decay, BOX, (TIME, measured(3.0, 2.0)), starts=starts)
    assert len(TRACES) == before
    np.testing.assert_allclose(got.theta["rate"], 3.0, rtol=0.05)


def test_a_ridge_is_named_in_words():
    bounds = box({"zeta": (0.1, 1.0), "alpha": (300.0, 700.0), "delta": (200.0, 500.0)})

    def product(theta, data):
        both = theta["alpha"] * theta["delta"] / 1.7e5 - 1
        return jnp.stack([(theta["zeta"] - 0.5) / 0.01, both / 0.005])

    got = fit(product, bounds, starts=4, key=jax.random.key(1))
    assert got.weak is not None
    assert got.weak.names == ("alpha", "delta")
    assert got.weak.text == "only the product alpha*delta is determined"
    assert np.all(
        np.linalg.eigvalsh(got.covariance / np.outer([0.9, 400, 300], [0.9, 400, 300])) > 0
    )


def test_starts_where_the_model_fails_are_left_out():
    def fragile(theta, data):
        return jnp.where(theta["rate"] > 5, jnp.nan, 1.0) * decay(theta, data)

    data = (TIME, measured(1.3, 2.0))
    got = fit(fragile, BOX, data, starts={"rate": [9.0, 1.0], "size": [1.0, 1.0]})
    assert np.isinf(got.waterfall[-1])
    np.testing.assert_allclose(got.theta["rate"], 1.3, rtol=0.05)
    with pytest.raises(ModelError, match="at the end of any of the 1 fits"):
        fit(fragile, BOX, data, starts={"rate": 9.0, "size": 1.0})


def test_what_cannot_be_fitted_is_refused():
    with pytest.raises(ConfigError, match="must name rate, size"):
        fit(decay, BOX, None, starts={"rate": 1.0})
    with pytest.raises(ConfigError, match="`key`"):
        fit(decay, BOX, None, starts=3)
    with pytest.raises(ConfigError, match="must be real"):
        fit(lambda theta, data: 1j * theta["rate"][None], BOX, starts=1, key=jax.random.key(0))


@pytest.mark.fault(28)
@pytest.mark.parametrize("precision", [1e-6, 1e-9, 1e-12])
def test_a_sum_known_far_better_than_its_parts_leaves_a_covariance_that_can_be_factored(precision):
    three = box({"a": (0.0, 1.0), "b": (0.0, 1.0), "c": (0.0, 1e5)})

    def total(theta, data):
        return jnp.stack([(theta["a"] + theta["b"] + 1e-5 * theta["c"] - 1.2) / precision])

    got = fit(total, three, starts=4, key=jax.random.key(1))
    np.linalg.cholesky(got.covariance)
    # Two directions of the box, both a uniform x wide; the third is the sum's, as far as rounding
    # can tell 1e-7 of the others.
    each = np.sqrt(np.diagonal(got.covariance)) / [1.0, 1.0, 1e5]
    np.testing.assert_allclose(each, np.sqrt(2 / 3 / 12), rtol=1e-6)
    ones = np.array([1.0, 1.0, 1e-5])
    assert np.sqrt(ones @ got.covariance @ ones) == pytest.approx(precision, rel=0.2, abs=1e-7)


def test_errors_of_quantities_are_those_of_their_gradients_by_hand():
    found = fit(decay, BOX, (TIME, measured(1.3, 2.0)), starts=8, key=jax.random.key(0))
    a, b = found.theta["rate"], found.theta["size"]
    values, std = to_first_order(
        lambda theta: {"product": theta["rate"] * theta["size"], "half": theta["rate"] / 2}, found
    )
    assert list(values) == list(std) == ["product", "half"]  # in the order that was asked
    assert values == pytest.approx({"product": a * b, "half": a / 2}, rel=1e-14)
    gradients = {"product": np.array([b, a]), "half": np.array([0.5, 0.0])}
    want = {name: np.sqrt(g @ found.covariance @ g) for name, g in gradients.items()}
    assert std == pytest.approx(want, rel=1e-12)
