"""Hum in a decay, in closed form: what is taken out is what was put in, within its stated error."""

import numpy as np
import pytest

from jbw.errors import DataError
from jbw.measurement.steady_lines import without_lines

FS, HZ, RATE, NOISE = 600.0, 30.0, 1.1, 1e-3
TIME = np.arange(6000) / FS


def free():
    """A decay exp(-rate t) whose frequency falls by a hundredth with its size."""
    size = np.exp(-RATE * TIME)
    return size * np.cos(2 * np.pi * HZ * (TIME - 0.01 * (1 - size) / RATE) + 0.3)


def hum(hz, size=0.03, phase=0.0):
    return size * np.sin(2 * np.pi * hz * TIME + phase)


@pytest.mark.parametrize("times", [1e-3, 1.0, 1e4])
@pytest.mark.parametrize("hz", [22.0, 30.2, 30.5, 41.0])
def test_a_line_is_taken_out_to_its_stated_error(hz, times):
    """Also 0.2 Hz beside the mode, one line of the half record's spectrum; eight seeds of noise."""
    misses = []
    for seed in range(8):
        line = hum(hz, phase=seed)
        x = free() + line + NOISE * np.random.default_rng(seed).standard_normal(len(TIME))
        cleaned, (found,) = without_lines(x, times * FS, [times * hz * 1.002])
        misses.append(np.max(np.abs(x - cleaned - line)[: round(FS / hz)]) / found.error)
        assert found.hz == pytest.approx(times * hz, rel=3e-5)
        assert found.error < 0.02 * found.amplitude
    # The largest within a period at the start: its rms over seeds is one error or less, at 0.2 Hz
    # the change of the mode's own frequency adds to it; of eight it scatters by a quarter.
    assert 0.4 < np.sqrt(np.mean(np.square(misses))) < (2.0 if hz == 30.2 else 1.5)


def test_several_lines_are_taken_out_together():
    lines = hum(25.0, 0.02, 1.0) + hum(41.0, 0.04, 2.0)
    x = free() + lines + NOISE * np.random.default_rng(0).standard_normal(len(TIME))
    cleaned, found = without_lines(x, FS, [25.0, 41.0])
    assert [line.amplitude for line in found] == pytest.approx([0.02, 0.04], rel=0.01)
    # Errors at the start add: 4 of some 3e-4.
    assert np.max(np.abs(x - cleaned - lines)) < 1.2e-3


@pytest.mark.parametrize("lines_hz", [[0.5], [300.0]])
def test_a_line_that_a_record_cannot_hold_is_refused(lines_hz):
    with pytest.raises(DataError, match=r"must lie between 1\.6 and 300 Hz"):
        without_lines(free(), FS, lines_hz)


def test_a_line_that_is_not_there_is_refused():
    x = free() + NOISE * np.random.default_rng(0).standard_normal(len(TIME))
    with pytest.raises(DataError, match=r"at 4[0-2][.0-9]* Hz is not significant"):
        without_lines(x, FS, [41.0])
