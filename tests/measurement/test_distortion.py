"""Distortion told from noise: static polynomials, whose harmonics and linear parts are known."""

import numpy as np
import pytest

from jbw.errors import DataError
from jbw.measurement.nonlinearity import best_linear_approximation, detection_lines, excited_lines

FS, SIZE, PERIODS = 512.0, 1024, 4
RNG = np.random.default_rng(2)


def multisine(lines, count=1, rms=1.0):
    """Periods of random phases, a realisation a row, of shape (realisation, period, time)."""
    spectrum = np.zeros((count, SIZE // 2 + 1), complex)
    spectrum[:, lines] = np.exp(2j * np.pi * RNG.random((count, len(lines))))
    u = np.fft.irfft(spectrum)
    u *= rms / np.sqrt(np.mean(u**2, axis=1, keepdims=True))
    return np.repeat(u[:, None], PERIODS, axis=1)


def test_noise_of_a_linear_system_is_noise_and_no_distortion():
    lines, std, gain = np.arange(10, 300), 0.05, 2.0
    u = multisine(lines, 20)
    found = best_linear_approximation(u, gain * u + std * RNG.normal(size=u.shape), FS)
    np.testing.assert_allclose(found.freq, lines * FS / SIZE)
    # A line of white noise has E|N|^2 = N std^2; a line of the source N^2 rms^2 / (2 F).
    exact = np.sqrt(SIZE * std**2 / (20 * PERIODS) / (SIZE**2 / (2 * len(lines))))
    mean_square = np.sqrt(np.mean(found.noise_std**2))
    # 290 lines of 60 complex degrees of freedom, and of 19.
    assert mean_square == pytest.approx(exact, rel=4 / np.sqrt(4 * 290 * 60))
    assert np.sqrt(np.mean(found.total_std**2)) == pytest.approx(
        exact, rel=4 / np.sqrt(4 * 290 * 19)
    )
    np.testing.assert_allclose(found.h, gain, atol=5 * exact)
    # What is left of distortion by chance is far below a hundredth of the gain's.
    assert np.median(found.distortion_std) < 4 * exact


def test_a_cubic_has_the_gain_of_bussgang_and_distortion_beyond_its_noise():
    lines, a, c = np.arange(1, 200, 2), 2.0, 0.3
    u = multisine(lines, 60)
    found = best_linear_approximation(u, a * u + c * u**3 + 1e-4 * RNG.normal(size=u.shape), FS)
    # Bussgang: a + 3 c rms^2 of a Gaussian source; of F lines it is short by a part of about 1 / F.
    assert np.mean(found.h.real) == pytest.approx(a + 3 * c, rel=0.01)
    assert np.all(found.total_std > 10 * found.noise_std)
    # Of a Gaussian u of unit variance, u^3 - 3 u has the variance 6, spread over lines to 3 times
    # the highest: those of the source hold a part of it, all of them less than the whole.
    share = np.sum(found.distortion_std**2) / (2 * len(lines)) * 2 / (c**2 * 6)
    assert 0.3 < share < 1.0


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_it_is_that_of_another_package(noise):
    """`best-linear-approximation`, of Pintelon and Schoukens' robust methods, of exact and noisy u.

    Equal to round-off, and its distortion is that of the mean of the realisations.
    """
    robust = pytest.importorskip("best_linear_approximation.robust")
    lines, count = np.arange(5, 200, 2), 6
    u = multisine(lines, count)
    y = np.roll(u, 3, axis=-1) + 0.3 * u**3 + 0.05 * RNG.normal(size=u.shape)
    u = u + noise * RNG.normal(size=u.shape)
    found = best_linear_approximation(u, y, FS)
    theirs = np.moveaxis(y, -1, 0)[:, None]  # (time, channel, realisation, period)
    quiet = {"show_warnings": False}  # of periods that it thinks unequal
    if noise:
        other = robust.noisy_input(np.moveaxis(u, -1, 0)[:, None], theirs, FS, lines, **quiet).G
    else:
        other = robust.known_input(u[:, 0].T[:, None], theirs, FS, lines, **quiet).G
    np.testing.assert_allclose(found.h, other.value.ravel(), rtol=1e-12)
    np.testing.assert_allclose(found.noise_std, other.noise.std.ravel(), rtol=1e-10)
    np.testing.assert_allclose(found.total_std, other.total.std.ravel(), rtol=1e-10)
    one = np.sqrt(count) * other.nonlinear.std.ravel()
    np.testing.assert_allclose(found.distortion_std, one, rtol=1e-10)


@pytest.mark.parametrize(("b", "c"), [(0.2, 0.0), (0.0, 0.1)])
def test_even_and_odd_nonlinearities_stand_at_their_own_lines(b, c):
    every = np.arange(5, 201, 2)
    lines = np.setdiff1d(every, every[2::4])  # every fourth odd line listens
    (u,) = multisine(lines)
    y = u + b * u**2 + c * u**3 + 1e-3 * RNG.normal(size=u.shape)
    found = detection_lines(u, y)
    assert found.num_odd == len(every[2::4])
    assert found.num_even == 97
    loud, quiet = (found.even, found.odd) if b else (found.odd, found.even)
    assert loud > 20 * found.noise
    assert quiet < 2 * found.noise
    # The same by hand, from spectra of the polynomial alone.
    idle = np.arange(6, 201, 2) if b else every[2::4]
    clean = np.fft.rfft((b * u**2 + c * u**3)[0])
    size = np.abs(np.fft.rfft((u + b * u**2 + c * u**3)[0]))[lines]
    exact = np.sqrt(np.mean(np.abs(clean[idle[idle < lines[-1]]]) ** 2) / np.mean(size**2))
    assert loud == pytest.approx(exact, rel=0.02)


def test_noise_over_periods_is_that_of_their_mean():
    (u,) = multisine(np.arange(5, 201, 2))
    found = detection_lines(u, u + 0.1 * RNG.normal(size=u.shape))
    assert found.even == pytest.approx(found.noise, rel=0.3)  # 97 lines, three degrees of freedom
    assert np.isnan(found.odd)


def test_what_is_no_periods_is_refused():
    with pytest.raises(DataError, match="must both be"):
        best_linear_approximation(np.ones(8), np.ones(8), FS)
    with pytest.raises(DataError, match="constant"):
        excited_lines(np.zeros((2, 16)))
