"""The rig's mixed campaign, and sweeps of many days, against the truth that made them."""

import jax
import numpy as np
import pytest

from jbw import rig
from jbw.identification.coordinates import box_of
from jbw.identification.gathering import gather
from jbw.identification.joint import settled
from jbw.identification.procedure import run_procedure
from jbw.identification.selection import sweep_tests
from jbw.identification.starts import fit_from, linear_look
from jbw.inference.importance import importance
from jbw.observables.evidence import log_likelihood, offsets_of

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]
NUMERICAL = {"r_hat", "ess", "divergences", "e_bfmi", "tree_depth", "frozen_chain", "solver_error"}
CHAINS = {"num_chains": 2, "num_samples": 300}


def truth_of(campaign):
    return {**campaign.truth["joint"], "gain": campaign.truth["gain"]}


@pytest.mark.parametrize("seed", [0, 1])
def test_the_truth_lies_within_the_joint_posterior(seed):
    campaign = rig.measure("mixed", seed=seed, repeats=2, noise_ratio=0.02, force_noise_std=0.2)
    found = run_procedure(campaign.tests, {**campaign.settings, **CHAINS}, seed=seed)
    draws = found.steps["joint"].posterior["posterior"]
    for name, value in truth_of(campaign).items():
        z = (float(draws[name].mean()) - value) / float(draws[name].std())
        assert abs(z) < 4, f"{name}: {z:.1f}"
    failed = [f for f in found.steps["joint"].verdict.findings if f.status == "failed"]
    assert not [f for f in failed if f.code in NUMERICAL], [f.reason for f in failed]


def of_days(offsets):
    """z-score and standard deviation of omega_n from sweeps of five days, and the evidence."""
    campaign = rig.measure(
        "mixed", tests=["sweep_1p50N", "sweep_6p00N"], repeats=5, noise_ratio=0.02,
        omega_n_cv=5e-4, zeta_cv=0.05,
    )  # fmt: skip
    settings = {**campaign.settings, "offsets": offsets, "substeps": 2}
    data = gather(campaign.tests, settings, sweeps=sweep_tests(campaign.tests, settings))
    known = linear_look(data)
    prior = box_of(settings, data, known)
    keys = jax.random.split(jax.random.key(0), 3)
    first = fit_from(keys[0], data, prior, known)
    prior, best, data, _ = settled(keys[1], data, prior, first, settings)
    found = importance(keys[2], log_likelihood, prior, data, best, 200)
    sd = found.sd("omega_n")
    return (found.mean("omega_n") - truth_of(campaign)["omega_n"]) / sd, sd, data


def test_days_switch_offsets_on_and_widen_the_interval_to_hold_the_truth():
    z, sd, data = of_days("auto")
    assert offsets_of(data)
    assert abs(z) < 3
    # Five days scatter by 0.059 rad/s; the mean of five is known to 0.026, by chance to 0.009.
    scatter = 5e-4 * float(rig.TRUTH.omega_n) / np.sqrt(5)
    assert scatter / 4 < sd < 4 * scatter
    narrow_z, narrow_sd, ignorant = of_days("none")
    assert not offsets_of(ignorant)
    assert narrow_sd < sd / 3
    assert abs(narrow_z) > 2 * abs(z)
