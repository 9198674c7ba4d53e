"""Numbers of samplers side by side, on draws whose truth is known."""

import numpy as np
import pytest
import xarray as xr
from scipy.stats import norm

from jbw.lab.samplers import (
    QUANTITIES,
    distance,
    distances,
    exact_numbers,
    furthest,
    numbers,
    reference_of,
    worst_ess,
)

SEEDS = (0, 1, 2)


def normal(seed, shift=0.0):
    return shift + np.random.default_rng(seed).standard_normal((4, 1000))


def exact(error=0.0):
    table = xr.Dataset(
        {
            "mean": ("parameter", [0.0]),
            "sd": ("parameter", [1.0]),
            "quantiles": (("parameter", "probability"), [norm.ppf([0.01, 0.5, 0.99])]),
        },
        {"parameter": ["a"], "probability": [0.01, 0.5, 0.99]},
    )
    tree = xr.DataTree.from_dict({"exact": table})
    tree.attrs["quadrature_error"] = error
    return exact_numbers(tree)["a"]


@pytest.mark.parametrize("seed", SEEDS)
def test_independent_draws_are_within_four_errors_of_the_truth_and_shifted_ones_are_not(seed):
    row = numbers(normal(seed))
    assert row["mcse_mean"] == pytest.approx(1 / np.sqrt(4000), rel=0.2)
    assert furthest([distances(row, exact())]) < 4
    # A tenth of a standard deviation is six standard errors of 4000 draws.
    assert furthest([distances(numbers(normal(seed, 0.1)), exact())]) > 4


def test_an_error_of_the_reference_counts():
    row = numbers(normal(0, 0.1))
    assert abs(distances(row, exact(error=0.1))["z_mean"]) < 1.5


def test_what_cannot_be_had_is_none():
    row = numbers(np.ones((4, 100)))
    assert row["r_hat"] is row["ess_bulk"] is None
    assert all(value is None for value in distances(row, exact()).values())
    assert furthest([distances(row, exact())]) is None
    assert worst_ess({"a": row}) is None


def test_the_reference_is_the_most_effective_whose_chains_agree():
    apart = normal(0) + 3 * np.arange(4)[:, None]
    few = np.random.default_rng(1).standard_normal((4, 300))
    rows = {
        "stuck": {"a": numbers(apart)},
        "few": {"a": numbers(few)},
        "many": {"a": numbers(normal(2))},
    }
    assert reference_of(rows) == "many"
    assert reference_of({"stuck": rows["stuck"]}) == "stuck"
    assert set(QUANTITIES) <= set(rows["many"]["a"])


def test_errors_of_both_add_up_by_their_squares():
    """3 and 4 make 5."""
    own, other = {"mean": 12.0, "mcse_mean": 3.0}, {"mean": 2.0, "mcse_mean": 4.0}
    assert distance(own, other, "mean", "mcse_mean") == pytest.approx(2.0, rel=1e-15)
    assert distance(other, own, "mean", "mcse_mean") == pytest.approx(-2.0, rel=1e-15)


def test_chains_that_are_a_little_apart_are_no_reference():
    """Means by +-0.3: R-hat is about sqrt(1 + 0.12), however many effective draws there are."""
    agreed = {"r_hat": 1.005, "ess_bulk": 500.0, "ess_tail": 500.0}
    apart = {"r_hat": 1.06, "ess_bulk": 5000.0, "ess_tail": 5000.0}
    assert reference_of({"apart": {"a": apart}, "agreed": {"a": agreed}}) == "agreed"
