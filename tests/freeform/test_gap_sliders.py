"""Sliders behind gaps: known joints are found, and bad loops refused."""

import numpy as np
import pytest

from jbw.errors import DataError
from jbw.freeform.sliders import GapSliders, gap_sliders
from jbw.measurement.curves import ForcedLoop
from jbw.measurement.readings.loop import slider_columns

GAP, HALF_WIDTH, STRENGTH = 1e-3, 2e-3, 5e5


def motion(amplitude, cycles=3, samples=200):
    return amplitude * np.sin(np.linspace(0.0, 2 * np.pi * cycles, cycles * samples + 1))


def backlash(y):
    """Force of one slider behind a gap, by its contacts: an account apart from plays."""
    slider, force = 0.0, np.empty(len(y))
    for k, position in enumerate(y):
        # The slider's spring is pushed when the gap closes, and yields at its largest force.
        for sign in (1.0, -1.0):
            stretch = sign * (position - slider) - GAP
            if stretch > HALF_WIDTH:
                slider += sign * (stretch - HALF_WIDTH)
        apart = position - slider
        force[k] = STRENGTH * np.sign(apart) * max(abs(apart) - GAP, 0.0)
    return force


def loops(offsets=(0.0, 0.0)):
    pairs = zip((5e-3, 1e-2), offsets, strict=True)
    return [ForcedLoop(100.0, motion(a), backlash(motion(a)) + o) for a, o in pairs]


def test_a_column_is_the_force_of_one_slider_behind_a_gap():
    y = motion(5e-3)
    column = slider_columns(y, np.array([HALF_WIDTH]), np.array([GAP]))[:, 0]
    np.testing.assert_allclose(STRENGTH * column, backlash(y), atol=1e-9 * STRENGTH * HALF_WIDTH)


def test_a_joint_behind_a_gap_is_found_and_predicts_a_stronger_loop():
    fitted = gap_sliders(loops())
    # The grid has no slider of exactly this gap and half width: a few of its neighbours.
    assert fitted.error < 0.03
    assert fitted.mean_gap == pytest.approx(GAP, rel=0.2)
    further = ForcedLoop(100.0, motion(1.5e-2), backlash(motion(1.5e-2)))
    assert fitted.errors(further)[0] < 0.05


def test_the_mean_gap_is_weighed_with_the_largest_forces():
    widths, gaps, strengths = np.array([1.0, 4.0]), np.array([1.0, 3.0]), np.array([2.0, 1.0])
    sliders = GapSliders(widths, gaps, strengths, 0.0, 0.0, 0.0)
    assert sliders.mean_gap == pytest.approx((2.0 * 1.0 + 4.0 * 3.0) / 6.0, rel=1e-15)


def test_a_loop_may_have_a_force_of_its_own():
    fitted = gap_sliders(loops((300.0, -100.0)))
    assert fitted.error < 0.03
    assert fitted.offset == pytest.approx(100.0, abs=10.0)  # the mean of both
    shifted = ForcedLoop(100.0, motion(1e-2), backlash(motion(1e-2)) + 500.0)
    as_it_stands, with_own = fitted.errors(shifted)
    assert as_it_stands > 5 * with_own


@pytest.mark.parametrize(
    ("loop", "said"),
    [
        (ForcedLoop(1.0, np.zeros(20), np.ones(20)), "displacement of a loop is constant"),
        (ForcedLoop(1.0, motion(1.0, 1, 4), np.ones(5)), "8 finite samples"),
        (ForcedLoop(1.0, motion(1.0), np.full(601, np.nan)), "8 finite samples"),
    ],
)
def test_a_loop_that_shows_nothing_is_refused(loop, said):
    with pytest.raises(DataError, match=said):
        gap_sliders([loop])


def test_no_loop_is_refused():
    with pytest.raises(DataError, match="at least one force loop"):
        gap_sliders([])
