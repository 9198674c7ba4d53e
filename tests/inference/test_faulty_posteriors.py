"""Posteriors that no one should use, drawn by the samplers themselves: the verdict says so."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pasted import lines_of, pasted
from tiers import represented_by

from jbw.inference.posterior.verdict import verdict
from jbw.inference.samplers.sampling import sample
from jbw.inference.space.box import box

SEEDS = (0, 1, 2)
NARROW = box({"alpha": (0.0, 2.0), "delta": (-1.0, 1.0)})
DRAWN = {"num_warmup": 500, "num_samples": 1500}


def finding_of(tree, bounds, code):
    """The verdict's status, and its finding of a code."""
    found = verdict(tree, bounds)
    return found.status, next(one for one in found.findings if one.code == code)


def beyond_the_box(theta, data):
    """A truth of alpha = 2.6 with a standard deviation of 0.3, outside the prior."""
    return -0.5 * jnp.stack([(theta["alpha"] - 2.6) / 0.3, theta["delta"] / 0.2]) ** 2


@pytest.mark.fault(26)
@pytest.mark.parametrize("seed", represented_by(*SEEDS))
@pytest.mark.parametrize("sampler", ["nuts", "random_walk"])
def test_a_box_that_excludes_the_truth_fails_though_chains_agree(sampler, seed):
    tree = sample(jax.random.key(seed), beyond_the_box, NARROW, sampler=sampler, **DRAWN)
    status, finding = finding_of(tree, NARROW, "at_bound")
    assert (status, finding.status) == ("failed", "failed")
    assert finding.values["name"] == "alpha"
    # The box twice as wide upwards.
    assert pasted(finding.action).settings.prior == {"alpha": (0.0, 4.0)}
    assert finding.number > 0.02  # twice the uniform share of the last percent


def unsolvable_above(theta, data):
    """Solves fail where alpha exceeds 1, in the middle of what the data allow."""
    terms = jnp.stack([theta["alpha"] - 1.0, theta["delta"]])
    return jnp.where(theta["alpha"] < 1.0, -0.5 * terms**2, jnp.nan)


@pytest.mark.fault(34)
@pytest.mark.parametrize(
    ("sampler", "code"), [("nuts", "divergences"), ("random_walk", "failed_solves")]
)
def test_failed_solves_are_counted_shown_and_fail(sampler, code):
    tree = sample(jax.random.key(0), unsolvable_above, NARROW, sampler=sampler, **DRAWN)
    assert float(tree["posterior"]["alpha"].max()) < 1.0
    status, finding = finding_of(tree, NARROW, code)
    assert (status, finding.status) == ("failed", "failed")
    assert ("identify", "substeps = 16") in lines_of(finding.action)  # twice the usual 8


FUNNEL = box({"scale": (-9.0, 9.0), "x": (-60.0, 60.0)})


def funnel(theta, data):
    """Neal's funnel: the width of x is exp(scale / 2)."""
    scale, x = theta["scale"], theta["x"]
    return jnp.stack([-0.5 * (scale / 3.0) ** 2, -0.5 * x**2 * jnp.exp(-scale) - 0.5 * scale])


@pytest.mark.fault(38)
@pytest.mark.parametrize("seed", represented_by(*SEEDS))
def test_a_funnel_fails_item_by_item_with_what_to_do(seed):
    tree = sample(jax.random.key(seed), funnel, FUNNEL, num_warmup=300, num_samples=500)
    found = verdict(tree, FUNNEL)
    assert found.status == "failed"
    failed = {one.code: one for one in found.findings if one.status == "failed"}
    assert "divergences" in failed
    assert {"ess_bulk", "ess_tail", "r_hat", "e_bfmi"} & set(failed)
    assert all(one.action for one in failed.values())


@pytest.mark.fault(36, 37)
@pytest.mark.parametrize("num_chains", [1, 4])
@pytest.mark.parametrize("spoil", [np.nan, np.inf, 1.0])
def test_chains_of_nan_or_of_one_value_are_never_ok(spoil, num_chains):
    walk = {"sampler": "random_walk", "num_chains": num_chains}
    tree = sample(jax.random.key(0), beyond_the_box, NARROW, **walk, **DRAWN)
    for chain in (0, slice(None)):
        spoilt = tree.copy(deep=True)
        spoilt["posterior"]["delta"].values[chain] = spoil
        found = verdict(spoilt, NARROW)
        assert found.status == "failed"
        failed = {one.code: one for one in found.findings if one.status == "failed"}
        told = failed["frozen_chain" if spoil == 1.0 else "non_finite"]
        assert told.values["name"] == "delta"
        assert told.action
