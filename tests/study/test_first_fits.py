"""The first fit of any two kinds of tests of the rig ends where the truth is.

No point fits better than the optimum: what a fit leaves is no more than what the truth leaves.
"""

from dataclasses import replace
from itertools import combinations

import jax
import numpy as np
import pytest
from scaled_campaigns import AT_TRUTH, FS, PLANS, RIG
from tiers import represented_by

from jbw.campaign.settings import Identify
from jbw.identification.assemble import assemble, measured_in
from jbw.identification.first_fit import EXPLAINED, first_fit
from jbw.identification.prepare import refit
from jbw.observables.dataset import as_arrays, stacked
from jbw.rig import measure
from jbw.rig.generator import Multisine, Steps, Tone
from jbw.rig.presets import RESONANCE_HZ, Plan

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]
STEPS = Plan("steps", "stepped", Steps(RESONANCE_HZ, 0.15, dwell=24.0), 2, settle=20.0)
TONE = Plan("tone", "tones", Tone(6.5, 12.0, duration=16.0, settle=32.0), 2)
PERIODIC = Plan(
    "periods", "multisine", Multisine(0.5, 8.0, 10.0, 30.0, periods=3, settle=16.0), 2, (15.0, 22.0)
)
RIG_OF_KINDS = replace(RIG, plans=(*PLANS, STEPS, TONE, PERIODIC))
# One test of every kind; the strong sweep is the one that is farther from linear. Decays and loops,
# of which only both together know the modal mass, come first.
KINDS = ("ringing", "pulled", "sweep_strong", "held_curve", "random", "steps", "tone", "periods")
# A tone of one frequency and a slow loop: that the fit begins near takes a better mass than by a
# secant, of which the tone's inertia is a small difference.
HARD = ("pulled", "tone")
PAIRS = [pair for pair in combinations(KINDS, 2) if pair != HARD]


def first_of(*names):
    """The first fit of some tests, and half the chi-square of the truth."""
    campaign = replace(measure(RIG_OF_KINDS, seed=0, fs=FS, tests=names), settings=Identify())
    data = assemble(measured_in(campaign, lambda _: None))
    prior, best, data = first_fit(jax.random.key(0), data, campaign.settings)
    best = refit(best, prior, data)  # the first fit stops at a millionth of its cost
    at_truth = np.asarray(stacked(as_arrays(AT_TRUTH, data), data))
    return best, float(0.5 * at_truth @ at_truth)


@pytest.mark.parametrize(("first", "second"), represented_by(*PAIRS))
def test_the_first_fit_of_two_kinds_is_no_worse_than_the_truth(first, second):
    best, cost_of_truth = first_of(first, second)
    assert best.cost <= cost_of_truth
    chi_square, dof = best.chi_square
    assert chi_square < EXPLAINED * dof
    assert best.at_bound == {}


@pytest.mark.release
@pytest.mark.xfail(strict=True, reason="the fit of a loop and one tone ends beside the truth")
def test_the_first_fit_of_a_loop_and_one_tone_is_no_worse_than_the_truth():
    best, cost_of_truth = first_of(*HARD)
    assert best.cost <= cost_of_truth
