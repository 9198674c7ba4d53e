"""Faults of loops: sliders with springs, integrated by their definition, with a fault put in."""

import re

import numpy as np
import pytest

from jbw.measurement.faults.loops import loop_causes
from jbw.measurement.readings.loop import basis_of, fit_loop
from jbw.measurement.records import Record

FS, CYCLE, CYCLES = 50.0, 200, 4
STIFFNESS, SLIPS = np.array([3e5, 2e5, 1e5]), np.array([2e-4, 6e-4, 1.5e-3])  # [N/m], [m]
NOISE = 5e-3  # of the largest force


def motion():
    turns = np.arange(CYCLES * CYCLE) / CYCLE
    return 1e-3 * np.repeat([0.5, 1.0], CYCLES * CYCLE // 2) * np.sin(2 * np.pi * turns)


def sliders(y):
    """Jenkins elements in parallel beside a cubic spring, sample by sample."""
    held, force = np.zeros(3), np.empty(len(y))
    for i, step in enumerate(np.diff(y, prepend=0.0)):
        held = np.clip(held + step, -SLIPS, SLIPS)
        force[i] = STIFFNESS @ held + 1e5 * y[i] + 2e10 * y[i] ** 3
    return force


def loop(y, force, seed=7):
    rng = np.random.default_rng(seed)
    noisy = force + NOISE * np.max(np.abs(force)) * rng.standard_normal(len(y))
    channels = {"displacement": y, "restoring_force": noisy}
    units = {"displacement": "m", "restoring_force": "N"}
    return Record(FS, channels, units, name="loop.csv")


def late(y):
    time = np.arange(len(y)) / FS
    return y, np.interp(time - 0.05, time, sliders(y))


def high_passed(y):
    # The bilinear transform of T s / (1 + T s), T = 6 s.
    force, out = sliders(y), np.zeros(len(y))
    a, b = 2 * FS * 6.0 + 1, 2 * FS * 6.0 - 1
    for i in range(1, len(y)):
        out[i] = (b * out[i - 1] + 2 * FS * 6.0 * (force[i] - force[i - 1])) / a
    return y, out


def slipped(y):
    return np.where(np.arange(len(y)) < 500, y, y + 2e-4), sliders(y)


def test_sliders_leave_the_noise_of_a_sound_loop():
    record = loop(motion(), sliders(motion()))
    assert list(loop_causes(record, 0.0)) == []
    force = record.channels["restoring_force"]
    found = fit_loop(basis_of(motion()), force)
    noise = NOISE * np.max(np.abs(sliders(motion())))
    # Chi-square of 800 values scatters by 5 %; columns take 3 %, reaches between them leave 10 %.
    assert found.square / len(force) == pytest.approx(noise**2, rel=0.2)


@pytest.mark.parametrize(
    ("spoil", "what", "size", "remedy"),
    [
        (late, "The force lags the displacement by (.*) s", 0.05, "`delay = "),
        (high_passed, "a time constant of (.*) s, as with the high", 6.0, "strain gauge"),
        (slipped, "The displacement jumps by (.*) m at 10 s", 2e-4, "span = ["),
    ],
)
def test_a_fault_of_a_loop_is_named_with_its_size(spoil, what, size, remedy):
    (fault,) = loop_causes(loop(*spoil(motion())), 0.0)
    # Straight lines between samples, reaches between those tried, and the noise take some per cent.
    assert float(re.search(what, fault.what)[1]) == pytest.approx(size, rel=0.06)
    assert remedy in fault.remedy


def test_a_stated_delay_leaves_nothing():
    assert list(loop_causes(loop(*late(motion())), 0.05)) == []


def test_a_slip_is_placed_in_the_record_though_a_delay_leaves_out_its_beginning():
    y, force = slipped(motion())
    time = np.arange(len(y)) / FS
    early = loop(y, np.interp(time + 0.06, time, force))
    (fault,) = loop_causes(early, -0.06)
    assert "m at 10 s while" in fault.what  # sample 500 of the file
    begin, end = map(float, re.search(r"span = \[(.*?), (.*?)\]", fault.remedy).groups())
    # The zero of the displacement is right before the slip alone.
    assert begin == 0.0
    assert 9.5 < end <= 10.0


def zero_off(y):
    return y, sliders(y) + 40.0 + 30.0 * np.arange(len(y)) / len(y)


def worn(y):
    return y, sliders(y) * (1 - 0.15 * np.arange(len(y)) / len(y))


LONGER = 1e-3 * np.sin(2 * np.pi * np.arange(6 * CYCLE) / CYCLE)


def test_a_zero_that_is_off_and_drifts_is_named_with_its_size():
    record = loop(*zero_off(LONGER))
    (fault,) = loop_causes(record, 0.0)
    half = 0.5 * np.ptp(record.channels["restoring_force"])
    offset, drift = map(float, re.findall(r"([\d.]+) %", fault.what))
    # The half range contains the drift and the noise, 3 %, and the printed digits are three.
    assert offset == pytest.approx(100 * 40.0 / half, rel=0.05)
    assert drift == pytest.approx(100 * 30.0 / half, rel=0.05)
    assert list(loop_causes(record, 0.0, "drift")) == []
    (left,) = loop_causes(record, 0.0, "offset")
    assert "begins 0.0 %" in left.what


def test_a_force_before_any_motion_is_a_zero_that_is_off_whatever_the_law():
    y = np.append(np.zeros(80), LONGER)
    play = np.sign(y) * np.maximum(np.abs(y) - 3e-4, 0.0)  # backlash, which no slider has
    record = loop(y, sliders(play) + 30.0)
    (fault,) = loop_causes(record, 0.0)
    half = 0.5 * np.ptp(record.channels["restoring_force"])
    assert float(re.search(r"begins ([\d.]+) %", fault.what)[1]) == pytest.approx(
        100 * 30.0 / half, rel=0.03
    )
    assert list(loop_causes(loop(y, sliders(play)), 0.0)) == []


def test_a_joint_that_wears_is_named_unless_its_law_does():
    record = loop(*worn(LONGER))
    (fault,) = loop_causes(record, 0.0)
    # From the middle of the second of five cycles to that of the last, of six turns.
    falls = 1 - (1 - 0.15 * 4.75 / 6) / (1 - 0.15 * 1.75 / 6)
    assert float(re.search(r"falls by (\d+) %", fault.what)[1]) == pytest.approx(100 * falls, abs=1)
    assert "`span = [" in fault.remedy
    assert list(loop_causes(record, 0.0, laws=("bwbn",))) == []
