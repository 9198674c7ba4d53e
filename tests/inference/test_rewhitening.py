"""Slices about a covariance that is far too small are drawn again about their own moments."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tiers import represented_by

from jbw.inference.posterior.summary import summarise
from jbw.inference.posterior.verdict import verdict
from jbw.inference.samplers.chunked_run import Until
from jbw.inference.samplers.rewhitening import agree, by_moments, sample_until
from jbw.inference.samplers.sampling import SamplingRequest
from jbw.inference.space.box import box
from jbw.inference.space.problem import Target
from jbw.inference.space.reparametrisation import in_box

BOX = box({"a": (-50.0, 50.0), "b": (-50.0, 50.0)})
MEAN, COVARIANCE = np.array([3.0, -2.0]), np.array([[4.0, 3.0], [3.0, 9.0]])
PRECISION = np.linalg.inv(COVARIANCE)


def normal(theta, data):
    off = jnp.stack([theta["a"], theta["b"]]) - MEAN
    return -0.5 * (off @ PRECISION @ off)[None]


NORMAL = Target(normal, BOX)
SLICES = SamplingRequest("elliptical_slice", chain_method="vectorized")


def drawn(rounds, seed=0, small=1e-6, seen=None):
    keep = (lambda round_: None) if seen is None else seen.append
    return sample_until(
        jax.random.key(seed), NORMAL, SLICES._replace(num_warmup=25, num_samples=400),
        coordinates=in_box(BOX, {"a": 0.0, "b": 0.0}, small * COVARIANCE, 4),
        rounds=rounds, keep=keep,
    )  # fmt: skip


@pytest.mark.parametrize("seed", represented_by(0, 1, 2))
def test_a_normal_posterior_is_found_from_a_fit_that_knows_nothing_of_its_width(seed):
    stuck = summarise(drawn(0, seed), BOX)
    assert max(row["r_hat"] for row in stuck.values()) > 1.05
    found = drawn(6, seed)
    assert found.attrs["rewhitened"] > 0
    for i, (name, row) in enumerate(summarise(found, BOX).items()):
        assert row["r_hat"] < 1.05, name
        sd = np.sqrt(COVARIANCE[i, i])
        assert row["mean"] == pytest.approx(MEAN[i], abs=4 * sd / np.sqrt(row["ess_bulk"]))
        assert row["sd"] == pytest.approx(sd, rel=4 / np.sqrt(2 * row["ess_bulk"]))


def test_chains_that_agree_are_left_alone():
    seen = []
    found = drawn(3, small=1.0, seen=seen)
    assert found.attrs["rewhitened"] == 0
    assert seen == [0]


def test_evaluations_of_all_rounds_are_counted():
    seen = []
    last = drawn(6, seen=seen)
    assert seen == list(range(last.attrs["rewhitened"] + 1))
    assert last.attrs["num_evaluations"] > drawn(0).attrs["num_evaluations"]


def test_moments_are_of_the_second_half_and_inside_the_box():
    rng = np.random.default_rng(0)
    draws = {"a": rng.normal(size=(4, 1000)), "b": np.full((4, 1000), 50.0)}
    draws["a"][:, :500] = 40.0
    draws["b"] += 1e-3 * rng.normal(size=(4, 1000))
    place = by_moments(draws, BOX, in_box(BOX, None, None, 4))
    start = dict(zip(BOX.names, place.start, strict=True))
    # 2000 draws: their mean is known to 0.022, their variance to 3 %.
    assert start["a"] == pytest.approx(0.0, abs=0.1)
    assert -50 < start["b"] < 50
    assert place.covariance[0, 0] == pytest.approx(1.3, rel=0.15)


def test_one_chain_agrees_with_itself():
    assert agree({"a": np.random.default_rng(0).normal(size=(1, 100))})


def enough_of(sizes):
    """Whether 2000 draws of all chains are there; notes how many were."""

    def enough(draws):
        sizes.append(draws["a"].size)
        return draws["a"].size >= 2000

    return enough


@pytest.mark.parametrize("sampler", ["importance", "elliptical_slice"])
def test_draws_double_until_they_are_enough(sampler):
    sizes = []
    found = sample_until(
        jax.random.key(0), NORMAL, SLICES._replace(sampler=sampler, num_samples=125),
        rounds=0, until=Until(enough_of(sizes), np.inf),
        coordinates=in_box(BOX, {"a": 3.0, "b": -2.0}, COVARIANCE, 4),
    )  # fmt: skip
    assert found["posterior"].sizes["draw"] == 500
    assert found.attrs["num_samples"] == 500
    assert sorted(set(sizes)) == [500, 1000, 2000]
    assert "budget_spent_s" not in found.attrs
    row = summarise(found, BOX)["a"]
    assert row["mean"] == pytest.approx(3.0, abs=4 * 2.0 / np.sqrt(row["ess_bulk"]))


@pytest.mark.fault(37)
def test_a_spent_budget_is_a_finding_that_says_what_it_would_have_taken():
    found = sample_until(
        jax.random.key(0), NORMAL, SLICES._replace(sampler="importance", num_samples=125),
        rounds=0, until=Until(lambda _: False, 1e-3),
        coordinates=in_box(BOX, {"a": 3.0, "b": -2.0}, COVARIANCE, 4),
    )  # fmt: skip
    judged = verdict(found, BOX)
    finding = next(one for one in judged.findings if one.code == "budget")
    assert judged.status == "failed"
    assert finding.number == found.attrs["budget_spent_s"]
    assert "Put under [identify]: `budget_s = " in finding.action


def test_draws_of_a_told_number_have_no_budget():
    found = sample_until(
        jax.random.key(0), NORMAL, SLICES._replace(num_warmup=5, num_samples=300), rounds=0,
        coordinates=in_box(BOX, {"a": 3.0, "b": -2.0}, COVARIANCE, 4),
    )  # fmt: skip
    assert found["posterior"].sizes["draw"] == 300
    assert "budget_spent_s" not in found.attrs
