import numpy as np
import pytest
import xarray as xr
from scipy.stats import norm

from jbw.inference.density import density_of
from jbw.inference.posterior.summary import (
    as_plain,
    band,
    correlations,
    diagnose,
    running_mean,
    summarise,
)
from jbw.inference.space.box import box
from jbw.inference.space.stated import StatedDensities

BOX = box({"alpha": (0.0, 1.0), "delta": (0.0, 10.0)})


def tree_of(**draws):
    dims = ("chain", "draw")
    posterior = xr.Dataset({name: (dims, values) for name, values in draws.items()})
    lp = -((next(iter(draws.values())) - 0.5) ** 2)
    return xr.DataTree.from_dict(
        {"posterior": posterior, "sample_stats": xr.Dataset({"lp": (dims, lp)})}
    )


@pytest.fixture(name="normal")
def _normal():
    rng = np.random.default_rng(0)
    alpha = rng.normal(0.5, 0.05, size=(4, 2000))
    return tree_of(alpha=alpha, delta=10 * (1 - alpha) + rng.normal(0, 0.1, size=alpha.shape))


def test_rows_of_a_normal_posterior(normal):
    row = summarise(normal, BOX)["alpha"]
    assert set(row) == {
        *("map", "mean", "sd", "cv", "q005", "q995", "kl", "contraction"),
        *("ess_bulk", "ess_tail", "r_hat"),
    }
    # 8000 independent draws: mean good to 6e-4, sd to 4e-4, 0.5 % quantiles to 4e-3 (4 errors).
    np.testing.assert_allclose(row["mean"], 0.5, atol=2.4e-3)
    np.testing.assert_allclose(row["sd"], 0.05, atol=1.6e-3)
    np.testing.assert_allclose(row["cv"], 0.1, atol=4e-3)
    np.testing.assert_allclose(
        [row["q005"], row["q995"]], norm(0.5, 0.05).ppf([0.005, 0.995]), atol=0.016
    )
    np.testing.assert_allclose(row["kl"], -0.5 * np.log(2 * np.pi * np.e * 0.05**2), atol=0.05)
    # The sd is a twentieth of the width; a uniform prior's variance is width^2 / 12.
    np.testing.assert_allclose(row["contraction"], 0.97, atol=2e-3)
    np.testing.assert_allclose(row["map"], 0.5, atol=1e-4)
    np.testing.assert_allclose([row["ess_bulk"], row["ess_tail"]], 8000, rtol=0.15)
    assert row["r_hat"] < 1.005


def test_a_row_is_compared_with_a_stated_density():
    """Draws of the density itself tell nothing; of half its deviation, as of two normal ones."""
    stated = StatedDensities.of({"alpha": density_of({"Normal": [0.5, 0.05]})})
    rng = np.random.default_rng(0)
    for std, kl, contraction in ((0.05, 0.0, 0.0), (0.025, np.log(2) - 0.375, 0.75)):
        draws = rng.normal(0.5, std, size=(4, 2000))
        row = summarise(tree_of(alpha=draws), BOX, stated)["alpha"]
        # 8000 independent draws: the variance to 1.6 %, the mean of the square to as much.
        np.testing.assert_allclose(row["kl"], kl, atol=0.05)
        np.testing.assert_allclose(row["contraction"], contraction, atol=0.05)


def test_correlations_by_name(normal):
    table = correlations(normal)
    np.testing.assert_allclose(table["alpha"]["alpha"], 1.0)
    # delta = 10 (1 - alpha) + noise of 0.1 against 0.5.
    np.testing.assert_allclose(table["alpha"]["delta"], -0.5 / np.hypot(0.5, 0.1), atol=0.01)


@pytest.mark.parametrize("case", ["frozen", "nan", "short"])
def test_pathologies_have_no_numbers(case):
    draws = np.random.default_rng(1).normal(0.5, 0.1, size=(4, 3 if case == "short" else 100))
    if case == "frozen":
        draws[2] = 0.4
    if case == "nan":
        draws[1, 5] = np.nan
    assert all(np.isnan(value) for value in diagnose(draws).values())
    row = summarise(tree_of(alpha=draws), BOX)["alpha"]
    assert np.isnan(row["r_hat"])
    assert as_plain({"alpha": row})["alpha"]["r_hat"] is None


def test_one_chain_has_no_r_hat():
    row = diagnose(np.random.default_rng(2).normal(size=(1, 500)))
    assert np.isnan(row["r_hat"])
    assert row["ess_bulk"] > 300


def test_running_mean_and_band():
    values = np.arange(12.0).reshape(6, 2)
    np.testing.assert_allclose(running_mean(values)[-1], values.mean(axis=0))
    np.testing.assert_allclose(running_mean(values)[1], values[:2].mean(axis=0))
    draws = np.linspace(0, 1, 1001)[:, None] * [1.0, 2.0]
    lower, median, upper = band(draws)
    np.testing.assert_allclose([lower, median, upper], np.outer([0.005, 0.5, 0.995], [1, 2]))
