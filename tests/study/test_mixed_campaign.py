"""The rig's mixed campaign, and sweeps of many days, against the truth that made them."""

import jax
import numpy as np
import pytest

from jbw import rig
from jbw.campaign.settings import Identify
from jbw.identification.assemble import assemble, measured
from jbw.identification.coordinates import box_of
from jbw.identification.first_fit import fit_from
from jbw.identification.prepare import reweight
from jbw.inference.samplers.sampling import sample
from jbw.observables.dataset import log_likelihood
from jbw.observables.drives import told_by

# Second whole campaigns: the tutorial and the demo find their truth, and test_evidence.py lets
# offsets of days in.
pytestmark = [pytest.mark.release, pytest.mark.filterwarnings("ignore")]


def truth_of(campaign):
    return {**campaign.truth["joint"], "gain": campaign.truth["gain"]}


class Weighed:
    """Moments of importance sampling's draws, and its k-hat."""

    def __init__(self, tree):
        self.draws = tree["posterior"].to_dataset()
        self.khat = float(tree["posterior"].attrs.get("khat", tree.attrs.get("khat", np.nan)))

    def mean(self, name):
        return float(self.draws[name].mean())

    def sd(self, name):
        return float(self.draws[name].std())


def joint_of(data, settings, seed):
    """The joint step's fits, and their posterior by importance sampling instead of chains."""
    known = told_by(data.parts)
    prior = box_of(settings, data, known)
    keys = jax.random.split(jax.random.key(seed), 3)
    first = fit_from(keys[0], data, prior, known)
    ready = reweight(keys[1], data, prior, first, settings)
    tree = sample(
        keys[2], log_likelihood, ready.box, ready.data, sampler="importance", num_chains=4,
        num_samples=50, start=ready.fit.theta, covariance=ready.fit.covariance,
    )  # fmt: skip
    return Weighed(tree), ready.data


@pytest.mark.parametrize("seed", [0, 1])
def test_the_truth_lies_within_the_joint_posterior(seed):
    campaign = rig.measure("mixed", seed=seed, repeats=2, noise_ratio=0.02, force_noise_std=0.2)
    tests, settings = campaign.tests, Identify(**{**campaign.settings, "substeps": 2})
    data = assemble(measured(tests, settings))
    found, data = joint_of(data, settings, seed)
    assert found.khat < 0.7
    for name, value in truth_of(campaign).items():
        z = (found.mean(name) - value) / found.sd(name)
        assert abs(z) < 4, f"{name}: {z:.1f}"
    assert not data.has_offsets  # one assembly, one day: nothing shifts


def of_days(campaign, offsets, **more):
    """z-score and sd of omega_n by sweeps of five days; the data, and omega_n of each day."""
    settings = Identify(**{**campaign.settings, "offsets": offsets, "substeps": 2, **more})
    data = assemble(measured(campaign.tests, settings))
    found, data = joint_of(data, settings, 0)
    sd = found.sd("omega_n")
    days = [day["omega_n"] for day in campaign.truth["days"]]
    return (found.mean("omega_n") - truth_of(campaign)["omega_n"]) / sd, sd, data, days


def test_days_switch_offsets_on_and_widen_the_interval_to_hold_the_truth():
    campaign = rig.measure(
        "mixed", tests=["sweep_1p50N", "sweep_6p00N"], repeats=5, noise_ratio=0.02,
        omega_n_cv=5e-4, zeta_cv=0.05,
    )  # fmt: skip
    z, sd, data, days = of_days(campaign, "auto")
    assert data.has_offsets
    assert abs(z) < 3
    # The mean of five days of unknown scatter follows a t distribution of 4 degrees of freedom,
    # whose sd is sqrt(2) of this; the prior of the scatter and 200 draws move it by some per cent.
    found = np.sqrt(2) * np.std(days, ddof=1) / np.sqrt(5)
    assert 0.75 * found < sd < 1.25 * found
    # The days are known to 1e-4 rad/s, so that the joint of all runs lies at their mean.
    assert abs(z * sd + 2 * np.pi * 18.8 - np.mean(days)) < 0.2 * sd
    # Taken for noise, what differs from day to day makes the interval absurdly narrow.
    narrow_z, narrow_sd, ignorant, _ = of_days(campaign, "none", model_error="none")
    assert not ignorant.has_offsets
    assert narrow_sd < sd / 3
    assert abs(narrow_z) > 2 * abs(z)
