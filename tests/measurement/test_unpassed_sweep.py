"""Sweeps that end before the resonance: a linear mode in closed form."""

import numpy as np
import pytest
from scipy.signal import chirp

from jbw.measurement.faults.examine import examined_sweep
from jbw.measurement.records import Record

FS, SECONDS, HZ, ZETA = 128.0, 40.0, 12.0, 0.01
HALF_WIDTH = ZETA * HZ


def examined(low, high, seed=0):
    """What is found in a sweep between two frequencies [Hz], from rest, with noise."""
    t = np.arange(round(FS * SECONDS)) / FS
    force = chirp(t, low, SECONDS, high)
    hz = np.fft.rfftfreq(4 * len(t), 1 / FS)  # the motion ends before the period of the transform
    flexibility = 1 / (HZ**2 - hz**2 + 2j * ZETA * HZ * hz)
    y = np.fft.irfft(np.fft.rfft(force, 4 * len(t)) * flexibility)[: len(t)]
    y += 1e-4 * np.max(np.abs(y)) * np.random.default_rng(seed).standard_normal(len(t))
    record = Record(FS, {"force": force, "displacement": y}, {"force": "N", "displacement": "m"})
    return examined_sweep(record, None, 0.0)


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


@pytest.mark.parametrize("ends", [(8.0, 11.0), (8.0, HZ - 6 * HALF_WIDTH), (16.0, 13.0)])
def test_a_sweep_that_ends_before_the_resonance_is_named_and_not_read(ends):
    found = examined(*ends)
    (fault,) = found.faults
    assert "does not pass the resonance near 12" in fault.what
    assert found.reading is None


@pytest.mark.parametrize("ends", [(8.0, 16.0), (16.0, 8.0), (8.0, HZ + 3 * HALF_WIDTH)])
def test_a_sweep_that_passes_the_resonance_is_read(ends):
    found = examined(*ends)
    assert not found.faults
    hz, sd = found.reading.linear_hz
    assert abs(hz - HZ) < 4 * sd
    assert sd < 0.01 * HALF_WIDTH
