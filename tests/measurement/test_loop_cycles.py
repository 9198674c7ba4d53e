"""Loops cycle by cycle against closed forms: the slider, its works, a drift, both sides apart."""

import numpy as np
import pytest

from jbw.measurement.curves import ForcedLoop
from jbw.measurement.loops import (
    lopsided,
    passages,
    readings_of_cycles,
)

K, SLIP, CYCLE = 4e5, 1e-3, 400  # stiffness [N/m] of a spring and of a slider, slip [m], samples
AMPLITUDES = (0.5e-3, 2e-3, 2e-3, 3e-3)


def triangle(amplitudes=AMPLITUDES):
    """One cycle each from y = 0, in straight lines whose corners are samples."""
    phase = np.arange(CYCLE) / CYCLE
    one = 4.0 * np.abs((phase + 0.75) % 1.0 - 0.5) - 1.0
    return np.append(np.concatenate([a * one for a in amplitudes]), 0.0)


def slider(y):
    force, held = np.zeros(len(y)), 0.0
    for i in range(1, len(y)):
        held = np.clip(held + y[i] - y[i - 1], -SLIP, SLIP)
        force[i] = K * (y[i] + held)
    return force


def test_every_cycle_is_found_where_it_passes_the_middle():
    assert passages(triangle())[::2] == [0, CYCLE + 1, 2 * CYCLE + 1, 3 * CYCLE + 1, 4 * CYCLE]
    assert passages(5.0 + triangle((1e-3, 1e-3)))[::2][0] == 0


def test_stiffness_and_work_of_a_slider_are_closed_forms():
    r"""$W = 4 k s (a - s)$ and $k (1 + s / a)$ of a slider of slip s beside a spring."""
    y = triangle((2e-3, 2e-3, 3e-3, 3e-3))
    read = readings_of_cycles(ForcedLoop(1.0, y, slider(y)))
    assert [one.repeated for one in read] == [True] * 4
    for one in read[1::2]:  # the first of an amplitude comes from another
        a = one.amplitude
        assert one.stiffness == pytest.approx(K * (1 + SLIP / a), rel=1e-9)
        # Passages lie a sample away from y = 0, whose step is a hundredth of the amplitude.
        assert one.work == pytest.approx(4 * K * SLIP * (a - SLIP), rel=1e-3)
        assert one.damping == pytest.approx(one.work / (2 * np.pi * one.stiffness * a**2))
        assert one.retained == pytest.approx(1.0, rel=1e-9)


def test_an_offset_changes_nothing_and_a_drift_hardly():
    y = triangle()
    force, time = slider(y), np.linspace(0.0, 1.0, len(y))
    plain = readings_of_cycles(ForcedLoop(1.0, y, force))
    # The ends of a cycle lie a sample apart, of up to 30 um, in which a drift does work.
    for moved, most in ((force + 300.0, 1e-12), (force + 300.0 * time, 0.05)):
        for one, other in zip(plain, readings_of_cycles(ForcedLoop(1.0, y, moved)), strict=True):
            assert other.stiffness == pytest.approx(one.stiffness, rel=most)
            assert other.work == pytest.approx(one.work, rel=most, abs=75.0 * 3e-5)


def test_a_degrading_stiffness_is_retained_in_part():
    y = triangle((2e-3,) * 5)
    lost = np.repeat(0.95 ** np.arange(5), CYCLE)
    read = readings_of_cycles(ForcedLoop(1.0, y, 1e5 * y * np.append(lost, lost[-1])))
    np.testing.assert_allclose([one.retained for one in read], 0.95 ** np.arange(5), rtol=1e-9)


def test_the_sides_are_read_beside_an_offset():
    y = triangle((1e-3, *(2e-3,) * 6))
    force = slider(y)
    offset = 0.2 * np.ptp(force)
    assert abs(lopsided(ForcedLoop(1.0, y, force + offset))) < 1e-9
    assert lopsided(ForcedLoop(1.0, y, np.where(force < 0, 3 * force, force))) == pytest.approx(
        -0.5
    )
    assert abs(lopsided(ForcedLoop(1.0, y, force))) < 1e-9
