"""What feeds which step, and what is held out before any fit."""

from dataclasses import replace

import numpy as np
import pytest
from pasted import pasted

from jbw.campaign.settings import Identify
from jbw.errors import ConfigError
from jbw.identification.coordinates import joint_box
from jbw.identification.paper.step3 import PAPER_HALF_WIDTH, about
from jbw.identification.selection import (
    decay_tests,
    fitted_for_use,
    linear_test,
    loop_tests,
    probing_tests,
    sweep_tests,
)
from jbw.inference.space.box import bounds_by_name
from jbw.measurement.records import Record, Test
from jbw.oscillator.law import Scales


def a_test(kind, level, name="", tones=(), repeats=4):
    samples = {"input": np.zeros(8), "velocity": np.zeros(8)}
    record = Record(1024.0, samples, {"input": "V", "velocity": "m/s"})
    return Test(kind, (record,) * repeats, name or f"{kind} {level:g}", level, tuple(tones))


SWEEPS = [a_test("sweep", level, repeats=8) for level in (0.20, 0.05, 0.10)]


def test_step_2_reads_the_lowest_noise_level():
    tests = [a_test("noise", 0.05), a_test("noise", 0.005), a_test("sweep", 0.001)]
    assert linear_test(tests).level == 0.005
    assert linear_test([a_test("sweep", 0.1)]) is None


def test_probing_tones_lie_around_a_third_of_the_resonance():
    tests = [a_test("tones", 0.6, f"{f}", [f]) for f in (6.75, 5.0, 18.5)]
    tests.append(a_test("tones", 0.6, "two", [5.0, 6.0]))
    assert [t.name for t in probing_tests(tests, 18.8)] == ["5.0", "6.75"]
    assert [t.name for t in loop_tests(tests, 18.8)] == ["18.5"]


def test_the_middle_level_and_half_of_the_repeats_are_never_fitted():
    split = sweep_tests(SWEEPS, Identify())
    assert [(t.level, len(t.records)) for t in split.fitted] == [(0.05, 4), (0.20, 4)]
    assert [(t.level, len(t.records)) for t in split.held_out] == [(0.05, 4), (0.10, 8), (0.20, 4)]


def test_the_campaign_decides_when_it_says_so():
    split = sweep_tests(SWEEPS, Identify(fit_levels=(0.10,), fit_repeats=6))
    assert [(t.level, len(t.records)) for t in split.fitted] == [(0.10, 6)]
    assert sum(len(t.records) for t in split.held_out) == 18


@pytest.mark.parametrize(
    ("settings", "field"),
    [({"fit_levels": (0.3,)}, "fit_levels"), ({"fit_repeats": 9}, "fit_repeats")],
)
def test_settings_that_do_not_fit_the_sweeps_are_named(settings, field):
    with pytest.raises(ConfigError, match=field):
        sweep_tests(SWEEPS, Identify(**settings))


def test_all_repeats_and_levels_are_fitted_where_it_is_stated():
    split = sweep_tests(SWEEPS, Identify(fit_levels=(0.05, 0.10), fit_repeats="all"))
    assert [(t.level, len(t.records)) for t in split.fitted] == [(0.05, 8), (0.10, 8)]
    every = fitted_for_use(SWEEPS, Identify(fit_levels=(0.1,), fit_repeats=2, hold_out=("0.05",)))
    split = sweep_tests(SWEEPS, every)
    assert sum(len(t.records) for t in split.fitted) == 24
    assert split.held_out == ()


def test_the_remedy_of_too_many_repeats_is_taken():
    with pytest.raises(ConfigError) as error:
        sweep_tests(SWEEPS, Identify(fit_repeats=9))
    split = sweep_tests(SWEEPS, pasted(error.value.remedy).settings)
    assert [len(t.records) for t in split.fitted] == [8, 8]


@pytest.mark.parametrize("value", ["half", 0, True, 2.5])
def test_a_number_of_repeats_is_whole_or_all(value):
    with pytest.raises(ConfigError, match='whole number of at least 1, or "all"'):
        Identify.of({"fit_repeats": value})


def test_boxes_of_the_papers_widths_have_the_papers_coefficients_of_variation():
    centre = {"zeta": 0.0044, "alpha": 500.0, "delta": 340.0, "gamma": 33.0}
    # Prior CVs of theory: 11.6, 9.4, 11.6 and 23.9 %; a uniform of half width h has h / sqrt(3).
    for (name, pair), cv in zip(
        about(centre, PAPER_HALF_WIDTH).items(), (0.116, 0.094, 0.116, 0.239), strict=True
    ):
        low, high = pair
        assert (high - low) / np.sqrt(12) / centre[name] == pytest.approx(cv, rel=0.02)


def test_boxes_about_what_is_below_zero_are_boxes():
    """A joint that hardens, and a channel whose sign is turned."""
    low, high = about({"delta": -340.0}, PAPER_HALF_WIDTH)["delta"]
    assert (low, high) == pytest.approx((-408.0, -272.0))
    scales = Scales(118.0, 0.0044, 5e-3)
    for std in (0.001, np.inf):
        bounds = bounds_by_name(joint_box(Identify(), scales, (-15.0, std)))
        low, high = bounds["gain"]
        assert low < -15.0 < high < 0


def test_the_joint_box_takes_the_campaigns_bounds_where_it_states_them():
    scales = Scales(118.0, 0.0044, 5e-3)
    prior = joint_box(Identify(prior={"alpha": (425, 590)}), scales, (15.0, 0.001))
    bounds = dict(zip(prior.names, zip(prior.lower, prior.upper, strict=True), strict=True))
    assert tuple(map(float, bounds["alpha"])) == (425.0, 590.0)
    assert prior.names == ("omega_n", "zeta", "alpha", "delta", "gamma", "gain")
    assert "gain" not in joint_box(Identify(), scales, None).names


def test_decays_held_out_are_not_fitted():
    first, second = (a_test("decay", 0.0, name=name, repeats=4) for name in ("first", "second"))
    split = decay_tests([first, second], Identify(), [first])
    assert split.names == ("first 1", "first 2", "first 3", "first 4", "second 1", "second 2",
                           "second 3", "second 4")  # fmt: skip
    assert len(split.fitted.records) == 2  # half of the first, none of the second
    assert len(decay_tests([first, second], Identify()).fitted.records) == 4
    assert decay_tests([first, second], Identify(), []) is None


def of_strengths(kind, *strengths):
    """A test whose repeats are so strong."""
    test = a_test(kind, 0.1, repeats=len(strengths))
    samples = np.sin(np.arange(8))
    return replace(
        test,
        records=tuple(
            replace(r, channels={"input": samples, "velocity": size * samples})
            for r, size in zip(test.records, strengths, strict=True)
        ),
    )


@pytest.mark.parametrize(
    ("strengths", "fitted"),
    [
        ((1, 2, 4, 8), "1 4"),  # hit soft first
        ((8, 4, 2, 1), "1 4"),
        ((1, 8, 1, 8), "1 2"),
        ((1.0, 1.05, 0.97, 1.02), "1 2"),  # as strong as one another: the first ones
        ((1, 2, 4, 8, 16, 32, 64), "1 4 7"),
        ((1, 2, 4), "1 2 3"),
    ],
)
def test_fitted_repeats_range_from_the_strongest_to_the_weakest(strengths, fitted):
    decays = decay_tests([of_strengths("decay", *strengths)], Identify())
    chosen = decays.names[: len(decays.fitted.records)]
    assert [name.split()[-1] for name in chosen] == fitted.split()
    sweep = of_strengths("sweep", *strengths)
    split = sweep_tests([sweep], Identify())
    ids = [id(record) for record in split.fitted[0].records]
    numbers = [str(i + 1) for i, record in enumerate(sweep.records) if id(record) in ids]
    assert numbers == fitted.split()


def test_one_fitted_repeat_is_the_strongest():
    decays = decay_tests([of_strengths("decay", 1, 8, 2, 4)], Identify(fit_repeats=1))
    assert decays.names[0] == "decay 0.1 2"
