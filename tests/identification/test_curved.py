"""First answers whose posterior is curved, against a banana of known moments."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

from jbw.identification import curved
from jbw.inference.space.box import box

BEND = 1.0  # of the banana: x and y + BEND x^2 are standard normal


def ready_about(low=-40.0, high=40.0):
    """A fit at the top of the banana, with the covariance of its linearised residuals."""
    fit = SimpleNamespace(theta={"x": 0.0, "y": 0.0}, covariance=np.eye(2), weak=None, at_bound={})
    prior = box({"x": (low, high), "y": (low, high)})
    return SimpleNamespace(fit=fit, box=prior, data=None)


def with_residuals(monkeypatch, residual, ready):
    lower, width = np.asarray(ready.box.lower), np.asarray(ready.box.upper - ready.box.lower)
    monkeypatch.setattr(curved, "to_search", lambda unit, box: unit)
    monkeypatch.setattr(curved, "rows_of", lambda *_: lambda s: residual(*(lower + s * width).T))


@pytest.mark.parametrize(
    ("residual", "expected"),
    [
        (lambda x, y: np.stack([x, y], 1), False),
        (lambda x, y: np.stack([x, y + 0.1 * x**2], 1), False),  # 2.08 where a Gaussian has 2
        (lambda x, y: np.stack([x, y + BEND * x**2], 1), True),  # 10
        (lambda x, y: np.stack([x, np.tanh(y)], 1), True),  # 0.46: much wider than the Gaussian
        (lambda x, y: np.stack([x, np.where(y > 1, np.nan, y)], 1), True),
    ],
)
def test_a_posterior_is_curved_where_its_density_two_deviations_away_is_no_gaussians(
    residual, expected, monkeypatch
):
    ready = ready_about()
    with_residuals(monkeypatch, residual, ready)
    assert curved.is_curved(ready) is expected


def test_points_outside_the_prior_are_not_asked(monkeypatch):
    ready = ready_about(low=-1.0, high=1.0)
    with_residuals(monkeypatch, lambda x, y: np.stack([x, np.tanh(y)], 1), ready)
    assert not curved.is_curved(ready)


def banana(theta, data):
    x, y = theta["x"], theta["y"]
    return -0.5 * jnp.stack([x**2, (y + BEND * x**2) ** 2])


def test_weighted_draws_have_the_moments_of_the_banana(monkeypatch):
    monkeypatch.setattr(curved, "dataset", SimpleNamespace(log_likelihood=banana, stacked=None))
    found = curved.weighted_draws(jax.random.key(0), ready_about(), 4, 1000)
    (density, theta), effective = found
    assert density.shape == theta["x"].shape == (4, 1000)
    assert effective >= curved.ENOUGH
    x, y = theta["x"], theta["y"]
    # Five standard errors of as many independent draws as are effective.
    error = 5 / np.sqrt(effective)
    assert abs(x.mean()) < error
    assert abs(x.var() - 1) < error * np.sqrt(2)
    # y = e - x^2: mean -1 and variance 1 + 2.
    assert abs(y.mean() + BEND) < error * np.sqrt(3)
    np.testing.assert_allclose(density, -0.5 * (x**2 + (y + BEND * x**2) ** 2), rtol=1e-12)


def test_weights_that_cannot_be_trusted_give_no_draws(monkeypatch):
    monkeypatch.setattr(curved, "MOST_KHAT", -np.inf)
    monkeypatch.setattr(curved, "about_valley", lambda *_: None)
    monkeypatch.setattr(curved, "dataset", SimpleNamespace(log_likelihood=banana, stacked=None))
    assert curved.weighted_draws(jax.random.key(0), ready_about(), 4, 10) is None


def test_coordinates_in_which_nothing_can_be_solved_are_passed_over(monkeypatch):
    nothing = SimpleNamespace(log_likelihood=lambda theta, data: jnp.full(2, jnp.nan), stacked=None)
    monkeypatch.setattr(curved, "about_valley", lambda *_: None)
    monkeypatch.setattr(curved, "dataset", nothing)
    assert curved.weighted_draws(jax.random.key(0), ready_about(), 4, 10) is None


def test_draws_where_nothing_can_be_solved_are_replaced_by_others(monkeypatch):
    theta = {"x": np.array([0.0, -1.0, 2.0, -3.0]), "y": np.arange(4.0)}
    monkeypatch.setattr(curved, "at_points", lambda _, theta, data: np.sqrt(theta["x"])[:, None])
    with np.errstate(invalid="ignore"):
        density, found = curved.possible_draws(jax.random.key(0), np.arange(4.0), theta, None)
    assert found["x"][[0, 2]].tolist() == [0.0, 2.0]
    assert set(found["x"]) == {0.0, 2.0}
    np.testing.assert_array_equal(density, found["y"])  # Draws are replaced as a whole.


@pytest.mark.parametrize(
    ("steepness", "reach"),
    # as far as one of 10^5 draws of N(0, 1) goes; or the 100 of 2,001 draws nearest the maximum
    [(1.0, norm.isf(5e-6)), (1e3, 0.5)],
)
def test_draws_that_the_data_exclude_are_replaced_by_others(monkeypatch, steepness, reach):
    x = np.linspace(-10.0, 10.0, 2001)
    monkeypatch.setattr(
        curved, "at_points", lambda _, theta, data: -0.5 * (steepness * theta["x"][:, None]) ** 2
    )
    density, found = curved.possible_draws(jax.random.key(0), 2 * x, {"x": x}, None)
    stays = np.abs(x) <= reach
    np.testing.assert_array_equal(found["x"][stays], x[stays])
    assert np.max(np.abs(found["x"])) == pytest.approx(reach, abs=0.011)
    np.testing.assert_array_equal(density, 2 * found["x"])
