"""Frequency and damping read along decays: their values, and that only a scale of time is free."""

import numpy as np
import pytest

import jbw
from jbw.measurement.faults.examine import read_decays
from jbw.measurement.records import Record, Test

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


def table(x, fs=FS, band=BAND):
    (read,) = read_decays(
        Test("decay", (Record(fs, {"velocity": x}, {"velocity": "m/s"}),), "ring", band_hz=band)
    )
    return read


def test_readings_are_the_decay_s_own():
    read = table(softening_decay(noise=1e-4))
    expected = HZ * (1 - SOFTENING * read.amplitude)
    decay_rate = LINEAR + QUADRATIC * read.amplitude
    # The velocity's amplitude falls as stated; that of the motion, by which damping is meant,
    # falls slower by the part d ln(omega) / d ln(A).
    along = -SOFTENING * read.amplitude / (1 - SOFTENING * read.amplitude)
    zeta = decay_rate * (1 - along) / (2 * np.pi * expected)
    assert read.amplitude.max() > 20 * read.amplitude.min()
    # Three standard errors in all twelve rows, whose chance is 3 % if they were independent.
    assert np.all(np.abs(read.hz - np.hypot(expected, decay_rate / (2 * np.pi))) < 3 * read.hz_sd)
    assert np.all(np.abs(read.zeta - zeta) < 3 * read.zeta_sd)
    assert np.all(read.zeta_sd < 0.015 * zeta)  # 1.2 % are what averaging leaves open


def test_readings_between_rows_are_the_decay_s_own():
    rows = table(softening_decay())
    between = np.sqrt(rows.amplitude[1:] * rows.amplitude[:-1])
    read = rows.at(between)
    # Cubics through rows that are a factor of 1.4 apart miss a straight line by 1e-4 of its change.
    expected = (LINEAR + QUADRATIC * between) / (2 * np.pi * HZ * (1 - SOFTENING * between))
    away = np.interp(-between, -rows.amplitude, rows.zeta) - read.zeta
    assert np.all(np.abs(read.zeta - expected) < 3 * read.zeta_sd)
    assert np.max(np.abs(away)) < 2e-3 * np.ptp(rows.zeta)
    np.testing.assert_allclose(rows.at(rows.amplitude).zeta_sd, rows.zeta_sd, rtol=1e-9)


@pytest.mark.parametrize("times", [2.0**-6, 0.02, 100.0])
def test_time_scaled_decays_have_the_same_readings(times):
    x = softening_decay(noise=2e-3)
    plain, scaled = table(x), table(x, FS * times, tuple(times * edge for edge in BAND))
    # Least squares end within 1e-8 of their optimum.
    np.testing.assert_allclose(scaled.amplitude, plain.amplitude, rtol=1e-6)
    np.testing.assert_allclose(scaled.hz, times * plain.hz, rtol=1e-6)
    np.testing.assert_allclose(scaled.zeta, plain.zeta, rtol=1e-5)


@pytest.mark.parametrize("factor", [-1.0, 1e-9, 1e3])
def test_size_and_sign_change_no_reading(factor):
    x = softening_decay(noise=2e-3)
    plain, scaled = table(x), table(factor * x)
    np.testing.assert_allclose(scaled.amplitude, abs(factor) * plain.amplitude, rtol=1e-6)
    np.testing.assert_allclose(scaled.hz, plain.hz, rtol=1e-6)
    np.testing.assert_allclose(scaled.zeta, plain.zeta, rtol=1e-5)


def test_a_tail_of_noise_moves_no_reading():
    x = softening_decay(noise=1e-3)
    tail = 1e-3 * np.random.default_rng(1).standard_normal(20 * int(FS))
    plain, longer = table(x), table(np.concatenate([x, tail]))
    away = (longer.at(plain.amplitude[:6]).zeta - plain.zeta[:6]) / plain.zeta_sd[:6]
    assert np.max(np.abs(away)) < 1.0  # the decay is the same, so is its noise


def test_growth_is_no_reading():
    with pytest.raises(jbw.DataError, match=r"must decay in its `band`(.|\n)*last quarter"):
        table(softening_decay()[::-1])
