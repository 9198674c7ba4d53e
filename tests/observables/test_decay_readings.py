"""Frequency and damping read along decays: their values, and that only a scale of time is free."""

import numpy as np
import pytest

from jbw.measurement.demodulation import band_filter, demodulate, read_decay

FS, HZ, LINEAR, QUADRATIC, SOFTENING = 512.0, 20.0, 0.5, 0.6, 0.008
BAND = (10.0, 40.0)


def softening_decay(seconds=12.0, noise=0.0, seed=0):
    """A decay of dA/dt = -(a A + b A^2), in closed form, and frequency f (1 - c A)."""
    t = np.arange(round(seconds * FS)) / FS
    amplitude = LINEAR / ((LINEAR + QUADRATIC) * np.exp(LINEAR * t) - QUADRATIC)
    # The integral of A is log((a + b) - b exp(-a t)) / b - log(a) / b.
    area = np.log((LINEAR + QUADRATIC - QUADRATIC * np.exp(-LINEAR * t)) / LINEAR) / QUADRATIC
    x = amplitude * np.cos(2 * np.pi * HZ * (t - SOFTENING * area))
    return x + noise * np.random.default_rng(seed).standard_normal(len(t))


def readings(samples, fs=FS, band=BAND):
    chosen = band_filter(band, fs)
    return [
        read_decay(demodulate(x, chosen)[1][:: chosen.step], chosen.step_s, chosen.centre_hz)
        for x in samples
    ]


def test_readings_are_the_decay_s_own():
    (read,) = readings([softening_decay()])
    exact = (LINEAR + QUADRATIC * read.amplitude) / (2 * np.pi * read.frequency_hz)
    assert len(read.amplitude) > 20  # twelve seconds are ten of its time constants
    # The cubic term of a window T adds T^2 A''/40 to the slope of A: T = 0.36 s, a quarter of the
    # time constant over the first decade, and A''/A = (a + 2 b A)(a + b A) < 1.9 / s^2 make 0.6 %.
    np.testing.assert_allclose(read.damping, exact, rtol=6e-3)
    expected = HZ * (1 - SOFTENING * read.amplitude)
    np.testing.assert_allclose(read.frequency_hz, expected, rtol=6e-3 * SOFTENING)


@pytest.mark.parametrize("times", [2.0**-6, 0.02, 100.0, 6e4])
def test_time_scaled_decays_have_the_same_readings(times):
    x = softening_decay(noise=2e-3)
    (plain,) = readings([x])
    (scaled,) = readings([x], FS * times, tuple(times * edge for edge in BAND))
    exactly = 1e-12 if np.log2(times) % 1 == 0 else 1e-9  # round-off of the filter's design
    np.testing.assert_allclose(scaled.amplitude, plain.amplitude, rtol=exactly)
    np.testing.assert_allclose(scaled.frequency_hz, times * plain.frequency_hz, rtol=exactly)
    np.testing.assert_allclose(scaled.damping, plain.damping, rtol=exactly)


@pytest.mark.parametrize("factor", [-1.0, 1e-9, 1e3])
def test_size_and_sign_change_no_reading(factor):
    x = softening_decay(noise=2e-3)
    (plain,), (scaled,) = readings([x]), readings([factor * x])
    np.testing.assert_allclose(scaled.amplitude, abs(factor) * plain.amplitude, rtol=1e-9)
    np.testing.assert_allclose(scaled.frequency_hz, plain.frequency_hz, rtol=1e-9)
    np.testing.assert_allclose(scaled.damping, plain.damping, rtol=1e-9)


def test_noise_before_the_blow_and_after_the_decay_is_no_reading():
    rng, noise = np.random.default_rng(1), 1e-3
    late = np.concatenate([noise * rng.standard_normal(2 * int(FS)), softening_decay(noise=noise)])
    quiet = np.concatenate([late, noise * rng.standard_normal(20 * int(FS))])
    (read,) = readings([quiet])
    assert np.all(read.damping > 0)
    in_noise = np.mean(read.amplitude < 2 * noise)
    assert in_noise < 0.2  # 22 s of 34 s are noise, of whose windows few look like a decay


def test_growth_is_no_reading():
    (read,) = readings([softening_decay()[::-1]])
    assert len(read.amplitude) == 0


def test_a_window_that_is_stated_is_taken():
    chosen = band_filter(BAND, FS)
    envelope = demodulate(softening_decay(), chosen)[1][:: chosen.step]
    read = read_decay(envelope, chosen.step_s, chosen.centre_hz, 0.5)
    assert len(read.amplitude) == len(envelope) // round(0.5 / chosen.step_s)
