"""Two modes or a steady line near the resonance of a driven record: linear modes in closed form."""

import numpy as np
import pytest

from jbw.measurement.faults.second_mode import second_resonance
from jbw.measurement.records import Record

FS, SIZE = 128.0, 8192
BAND = (6.0, 20.0)
MODE = (12.0, 0.02, 1.0)
LAG_S = 0.01


def found(modes, *, line=0.0, noise=1e-3, lag_s=0.0, seed=0):
    """What is said of periodic noise through modes of given frequency [Hz], damping and share."""
    rng = np.random.default_rng(seed)
    force = rng.standard_normal(SIZE)
    hz = np.fft.rfftfreq(SIZE, 1 / FS)
    flexibility = sum(share / (at**2 - hz**2 + 2j * zeta * at * hz) for at, zeta, share in modes)
    y = np.fft.irfft(np.fft.rfft(force) * flexibility * np.exp(-2j * np.pi * hz * lag_s), SIZE)
    rms = np.sqrt(np.mean(y**2))
    y += line * rms * np.sin(2 * np.pi * 9.13 * np.arange(SIZE) / FS)
    y += noise * rms * rng.standard_normal(SIZE)
    channels, units = {"force": force, "displacement": y}, {"force": "N", "displacement": "m"}
    return [fault.what for fault in second_resonance(Record(FS, channels, units), BAND, lag_s)]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("noise", [0.0, 1e-3, 0.3])
def test_one_mode_is_one_mode(seed, noise):
    assert not found([MODE], noise=noise, seed=seed)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("second", [(13.2, 0.03, 0.6), (10.5, 0.01, 0.3)])
def test_a_second_mode_is_named_with_its_frequency(seed, second):
    """Also if a known lag turns the phases."""
    for lag_s in (0.0, LAG_S):
        (what,) = found([MODE, second], seed=seed, lag_s=lag_s)
        assert f"contains two modes, at 12 and {second[0]:g} Hz" in what


@pytest.mark.parametrize("seed", range(4))
def test_a_line_that_the_drive_does_not_cause_is_named(seed):
    (what,) = found([MODE], line=0.1, seed=seed)
    assert "line at 9.13 Hz" in what


def test_a_mode_outside_the_band_is_none_of_its_business():
    assert not found([MODE, (40.0, 0.01, 5.0)])
