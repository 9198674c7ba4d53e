"""A drive that drops off at a resonance, by its size alone."""

import time
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from jbw.measurement.faults.drop_off import RANDOM, drive_course, drop_off
from jbw.measurement.faults.examine import examined_sweep
from jbw.measurement.records import Record

SIZE = 2000


def drive(least, noise, seed=3):
    """A drive of size one that falls to `least` in the middle, with noise of each sample."""
    rng, place = np.random.default_rng(seed), np.linspace(-1, 1, SIZE)
    fallen = 1 - (1 - least) * np.exp(-((place / 0.15) ** 2))
    return SimpleNamespace(u=fallen + noise * rng.standard_normal(SIZE))


def test_a_drive_that_drops_off_into_its_noise_is_told_with_both_sizes():
    least, noise = drop_off(drive(0.2, 0.03))
    # Averages over 2 % of the values lie 3 % above the least one; the noise is 0.03 / 0.2.
    assert least == pytest.approx(0.2, rel=0.15)
    assert noise == pytest.approx(0.15, rel=0.2)


@pytest.mark.parametrize(
    ("least", "noise"),
    [
        (0.8, 0.03),  # hardly falls
        (0.2, 0.002),  # falls, and is measured well
    ],
)
def test_other_drives_do_not_drop_off(least, noise):
    assert drop_off(drive(least, noise)) is None


def test_a_drive_of_noise_varies_as_rayleigh_s_amplitudes_do():
    rng = np.random.default_rng(5)
    u = rng.standard_normal(4000) + 1j * rng.standard_normal(4000)
    _, varies = drive_course(SimpleNamespace(u=u))
    # Standard deviation over the median, sqrt(2 - pi / 2) / sqrt(pi / 2), of 80 values averaged.
    assert varies == pytest.approx(np.sqrt(4 / np.pi - 1), rel=0.05)
    assert varies > RANDOM


def test_noise_called_a_sweep_is_refused_before_a_mode_is_fitted():
    rng, fs = np.random.default_rng(6), 512.0
    u = rng.standard_normal(8192)
    omega, zeta = 2 * np.pi * 30.0, 0.01
    ((num,), den, _) = cont2discrete(([1.0], [1.0, 2 * zeta * omega, omega**2]), 1 / fs)
    channels = {"force": u, "displacement": lfilter(num, den, u)}
    record = Record(fs, channels, {"force": "N", "displacement": "m"}, "noise.csv")
    begun = time.process_time()
    examined = examined_sweep(record, None, 0.0)
    assert time.process_time() - begun < 1.0  # a mode with all hypotheses takes 17 s and more
    assert (examined.reading, examined.faults) == (None, ())
