"""Whether a driven record without a band contains several modes: linear modes in closed form."""

import numpy as np
import pytest

from jbw.measurement.faults.responses import several_resonances
from jbw.measurement.records import Record

FS, SIZE = 128.0, 8192


def driven(modes, noise, seed):
    """A periodic noise through modes of given frequency [Hz], damping and share, plus noise."""
    rng = np.random.default_rng(seed)
    force = rng.standard_normal(SIZE)
    hz = np.fft.rfftfreq(SIZE, 1 / FS)
    flexibility = sum(share / (at**2 - hz**2 + 2j * zeta * at * hz) for at, zeta, share in modes)
    y = np.fft.irfft(np.fft.rfft(force) * flexibility, SIZE)
    y += noise * np.sqrt(np.mean(y**2)) * rng.standard_normal(SIZE)
    channels, units = {"force": force, "displacement": y}, {"force": "N", "displacement": "m"}
    return Record(FS, channels, units)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("noise", [1e-3, 0.1, 1.0])
def test_white_noise_is_no_other_mode(seed, noise):
    assert not list(several_resonances(driven([(12.0, 0.02, 1.0)], noise, seed)))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("noise", [1e-3, 0.3])
def test_a_second_mode_of_equal_power_is_named(seed, noise):
    two = driven([(12.0, 0.02, 1.0), (31.0, 0.02, 4.0)], noise, seed)
    (fault,) = several_resonances(two)
    assert "around the strongest resonance" in fault.what
