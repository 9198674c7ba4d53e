"""Inputs against their definitions written in numpy."""

import jax
import numpy as np
import pytest

from jbw.errors import ConfigError
from jbw.oscillator.excitation import band_noise, multisine, sampled, sweep, tone

FS, N = 256.0, 1024
T = np.arange(N) / FS


def test_tone_and_multisine():
    assert np.allclose(sampled(tone(2.0, 30.0, 0.4), FS, N), 2 * np.cos(30 * T + 0.4), atol=1e-12)
    u = sampled(
        multisine(np.array([1.0, 0.5]), np.array([10.0, 23.0]), np.array([0.0, 1.0])), FS, N
    )
    assert np.allclose(u, np.cos(10 * T) + 0.5 * np.cos(23 * T + 1.0), atol=1e-12)


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


@pytest.mark.parametrize("gaussian", [True, False])
def test_band_noise_fills_its_band_alone(gaussian):
    u = np.asarray(band_noise(jax.random.key(0), 0.7, (10.0, 60.0), FS, N, gaussian=gaussian))
    spectrum = np.abs(np.fft.rfft(u)) / N
    f = np.fft.rfftfreq(N, 1 / FS)
    inside = (f >= 10.0) & (f <= 60.0)
    assert spectrum[~inside].max() < 1e-15
    # 201 lines: the mean square of Gaussian noise scatters by 1/sqrt(201) = 7 %.
    assert np.mean(u**2) == pytest.approx(0.49, rel=0.3 if gaussian else 1e-12)
    if not gaussian:
        assert np.ptp(spectrum[inside]) < 1e-14


def test_band_without_a_line_is_refused():
    with pytest.raises(ConfigError, match="band_hz"):
        band_noise(jax.random.key(0), 1.0, (10.01, 10.02), FS, N)
