"""Coordinates of a fleet: what a prior cuts, and what is left of a run's prior, by quadrature."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from test_fleet import MEANS, a_run

from jbw.errors import DataError
from jbw.population.coordinates import pooled, units_of_fleet
from jbw.population.fleet import fleet_of

ONE = {"omega_n": 118.0, "zeta": 0.01, "gamma": 150.0}


def fleet_with(path, second):
    """Two runs, the second with draws of its own of some parameters."""
    rng = np.random.default_rng(0)
    plain = {n: m * np.exp(0.02 * rng.standard_normal((2, 500))) for n, m in MEANS.items()}
    folders = [a_run(path / "A", 1, draws=plain)[0]]
    folders.append(a_run(path / "B", 2, draws={**plain, **second})[0])
    return fleet_of(folders)


def test_a_prior_that_cuts_a_factor_cuts_the_product_that_goes_with_it(tmp_path):
    """delta ends at its bound of 5000 and alpha is known: so ends alpha delta."""
    half = np.abs(np.random.default_rng(1).standard_normal((2, 500)))
    cut = fleet_with(tmp_path / "cut", {"delta": 5000.0 - 500.0 * half})
    with pytest.raises(DataError, match="cuts the posterior of alpha_delta in B") as caught:
        pooled(cut, ["alpha_delta"])
    assert "[identify.prior] delta" in caught.value.remedy
    assert pooled(cut, ["omega_n", "alpha_gamma"]).names == ("omega_n", "alpha_gamma")


def test_a_product_is_whole_where_its_factors_trade_up_to_their_bounds(tmp_path):
    """alpha delta is known to 2 % along a ridge that ends at delta's bound."""
    rng = np.random.default_rng(2)
    delta = rng.uniform(1000.0, 5000.0, (2, 500))
    product = 3000.0 * 400.0 * np.exp(0.02 * rng.standard_normal((2, 500)))
    fleet = fleet_with(tmp_path, {"delta": delta, "alpha": product / delta})
    with pytest.raises(DataError, match="cuts the posterior of delta in B"):
        pooled(fleet, ["delta"])
    assert pooled(fleet, ["alpha_delta"]).names == ("alpha_delta",)


def test_what_a_product_leaves_open_is_pooled_where_every_unit_knows_it(tmp_path):
    identified = fleet_with(tmp_path / "known", {})
    assert pooled(identified).names == ("omega_n", "zeta", "alpha_delta", "alpha_gamma", "share")
    assert not len(pooled(identified).common)
    alpha = 3000.0 * np.exp(0.5 * np.random.default_rng(3).standard_normal((2, 500)))
    open_ = pooled(fleet_with(tmp_path / "open", {"alpha": alpha}))
    assert open_.names == ("omega_n", "zeta", "alpha_delta", "alpha_gamma")
    # Of ln omega_n, ln zeta, ln alpha, ln delta, ln gamma: ln alpha - 2 ln omega_n.
    np.testing.assert_array_equal(open_.common, [[-2.0, 0.0, 1.0, 0.0, 0.0]])


def test_a_summary_is_rid_of_its_run_s_prior_as_by_quadrature(tmp_path):
    """alpha and delta trade; the prior is uniform in what was sampled: omega_n, zeta, delta."""
    mean = np.log([MEANS["alpha"], MEANS["delta"]])
    cov = np.array([[0.04, -0.03], [-0.03, 0.09]])
    rng = np.random.default_rng(4)
    raw = rng.standard_normal((1000, 2))
    raw -= raw.mean(0)
    # Draws whose own mean and covariance are these exactly.
    raw = np.linalg.solve(np.linalg.cholesky(np.cov(raw.T)), raw.T).T @ np.linalg.cholesky(cov).T
    alpha, delta = np.exp(mean + raw).T.reshape(2, 2, 500)
    still = {name: np.full((2, 500), value) for name, value in ONE.items()}
    fleet = fleet_with(tmp_path, {**still, "alpha": alpha, "delta": delta})
    units = units_of_fleet(fleet, pooled(fleet, ["alpha", "alpha_delta"]))
    # E over the posterior's normal density by the prior's delta, on a grid of 8 sd either way.
    a, b = (m + np.linspace(-8.0, 8.0, 401) * s for m, s in zip(mean, (0.2, 0.3), strict=True))
    grid = np.stack(np.meshgrid(a, b, indexing="ij"), axis=-1)
    density = multivariate_normal(mean, cov).pdf(grid) / np.exp(grid[..., 1])
    density /= density.sum()
    expected = [np.sum(density * grid[..., 0]), np.sum(density * grid.sum(-1))]
    np.testing.assert_allclose(units.mean[1], expected, rtol=1e-10)
    # Some draws' own: the prior over the logarithms of what was sampled, up to a constant.
    thinned = np.linspace(0, 999, 400).astype(int)
    log_prior = np.log(delta.ravel()[thinned])
    np.testing.assert_allclose(np.ptp(units.log_prior[1] - log_prior), 0.0, atol=1e-10)
