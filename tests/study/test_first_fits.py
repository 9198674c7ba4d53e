"""The first fit of any two kinds of tests of the rig ends where the truth is.

No point fits better than the optimum: what a fit leaves is no more than what the truth leaves.
"""

from dataclasses import replace
from itertools import combinations

import jax
import numpy as np
import pytest
from scaled_campaigns import AT_TRUTH, FS, PLANS, RIG
from scipy.stats import chi2
from tiers import represented_by
from toy_campaign import LAW, PLAIN, TRUTH, write_toy

from jbw.campaign.load import load_campaign
from jbw.campaign.settings import Identify
from jbw.identification.assemble import assemble, measured_in
from jbw.identification.first_fit import first_fit
from jbw.identification.prepare import refit
from jbw.observables.dataset import as_arrays, stacked
from jbw.rig import measure
from jbw.rig.generator import Multisine, Steps, Tone
from jbw.rig.presets import RESONANCE_HZ, Plan
from jbw.study.identify import identify

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
PAIRS = list(combinations(KINDS, 2))


def first_of(*names, seed=0):
    """The first fit of some tests, and half the chi-square of the truth."""
    campaign = replace(measure(RIG_OF_KINDS, seed=seed, fs=FS, tests=names), settings=Identify())
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
    assert chi_square < chi2.isf(1e-4, dof)
    assert best.at_bound == {}


@pytest.mark.parametrize("seed", represented_by(*range(3)))
def test_a_loop_beside_one_tone_starts_beside_what_its_secant_tells(seed):
    # The loop's secant is several per cent softer than the joint that sticks: held along the start,
    # it leads to an optimum of a hundred times the truth's cost.
    best, cost_of_truth = first_of("pulled", "tone", seed=seed)
    assert best.cost <= cost_of_truth
    assert best.at_bound == {}


@pytest.mark.parametrize("seed", represented_by(*range(4)))
def test_a_quick_answer_does_not_depend_on_its_seed(tmp_path, seed):
    # With seeds 2 and 3 the first of the starts ends with gamma near 0 and an error of 4 %.
    path = write_toy(tmp_path, PLAIN + LAW)
    study = identify(load_campaign(path), quick=True, seed=seed, report=lambda _: None)
    for name, truth in TRUTH.items():
        draws = study.tree["posterior"][name]
        # Five standard deviations, which chance exceeds once in 2e6, and 1e-3 for one solver step
        # per sample.
        assert abs(draws.mean() - truth) < 5 * draws.std() + 1e-3 * truth, name
