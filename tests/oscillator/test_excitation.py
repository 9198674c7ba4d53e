"""Inputs against their definitions written in numpy."""

import numpy as np
import pytest

from jbw.oscillator.excitation import sampled, sweep

FS, N = 256.0, 1024
T = np.arange(N) / FS


def test_sweep_has_its_frequency_and_ends_in_silence():
    u = np.asarray(sampled(sweep(3.0, 2.0, 20.0, 3.0), FS, N))
    inside = T < 3.0
    expected = 3.0 * np.sin(2 * np.pi * (2.0 * T + 3.0 * T**2))
    assert np.allclose(u[inside], expected[inside], atol=1e-11)
    assert np.all(u[~inside] == 0.0)


def test_sweep_fades_without_a_step():
    plain = np.asarray(sampled(sweep(1.0, 0.0, 20.3, 3.0), FS, N))
    faded = np.asarray(sampled(sweep(1.0, 0.0, 20.3, 3.0, fade=0.25), FS, N))
    assert np.array_equal(plain[T <= 2.75], faded[T <= 2.75])
    half = int(2.875 * FS)
    assert faded[half] == pytest.approx(0.5 * plain[half], rel=1e-12)
    assert abs(faded[int(3.0 * FS) - 1]) < 1e-3
