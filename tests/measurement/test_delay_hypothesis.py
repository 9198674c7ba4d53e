"""A delay as a hypothesis: the beginning of a sweep has it, before the motion is loud."""

import numpy as np
import pytest
from scipy.signal import chirp, lsim

from jbw.measurement.faults.lag import Delay
from jbw.measurement.readings.read import sweep_fits, swept_signal
from jbw.measurement.records import Record

FS, HZ, ZETA, SECONDS = 512.0, 20.0, 0.01, 40.0


def fits_of(lag_s):
    """A linear mode under a sweep from 15 to 25 Hz, first-order hold, its response late."""
    time = np.arange(round(SECONDS * FS)) / FS
    drive = chirp(time, 15.0, SECONDS, 25.0)
    omega = 2 * np.pi * HZ
    _, y, _ = lsim(([1.0], [1.0, 2 * ZETA * omega, omega**2]), drive, time)
    late = np.interp(time - lag_s, time, y)
    channels = {"force": drive, "displacement": late}
    record = Record(FS, channels, {"force": "N", "displacement": "m"}, "sweep.csv")
    signal, _ = swept_signal(record, None, 0.0)
    return sweep_fits(signal)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_delay_that_the_beginning_has_is_one(sign):
    fits = fits_of(sign * 5e-3)
    periods = sign * 5e-3 / fits.signal.mean_period_s
    assert Delay().matters(np.array([periods]), fits)
    # The other way round, or of four times the size, it is not that of the record's beginning.
    assert not Delay().matters(np.array([-periods]), fits)
    assert not Delay().matters(np.array([4 * periods]), fits)


def test_a_lag_that_the_resonance_alone_shows_is_none():
    assert not Delay().matters(np.array([0.3]), fits_of(0.0))
