"""Repeats that differ by noise of a known size, and by known changes beside it."""

import numpy as np
import pytest

from jbw.errors import DataError
from jbw.measurement.nonlinearity import repeatability

T = np.arange(2000) / 500
CLEAN = np.sin(2 * np.pi * (8 * T + T**2)) * np.sin(np.pi * T / 4) ** 2
RMS = np.sqrt(np.mean(CLEAN**2))
RNG = np.random.default_rng(4)


def noisy(rows, noise=0.01):
    return rows + noise * RNG.normal(size=(*np.shape(rows)[:-1], len(T)))


def test_noise_is_told_and_called_noise():
    found = [repeatability(noisy(np.tile(CLEAN, (5, 1)))) for _ in range(300)]
    scatter = np.mean([one.scatter for one in found])
    # 300 times 8,000 degrees of freedom.
    assert scatter == pytest.approx(0.01 / RMS, rel=4 / np.sqrt(2 * 300 * 8000))
    assert np.mean([one.noise for one in found]) == pytest.approx(scatter, rel=1e-3)
    # p is uniform: of 300, 15 are below one in twenty, give or take 3.8.
    small = sum(one.p < 0.05 for one in found)
    assert 15 - 4 * 3.8 <= small <= 15 + 4 * 3.8
    assert sum(one.differ for one in found) <= 3
    assert found[0].floor == pytest.approx(found[0].scatter / np.sqrt(5))


@pytest.mark.parametrize("what", ["size", "time", "pace"])
def test_repeats_of_another_size_time_or_pace_differ(what):
    change = np.linspace(-1, 1, 5)[:, None]
    if what == "size":
        rows = (1 + 0.02 * change) * CLEAN
    elif what == "time":
        rows = np.array([np.interp(T + 4e-4 * s, T, CLEAN) for s in change[:, 0]])
    else:
        rows = np.array([np.interp(T * (1 + 2e-4 * s), T, CLEAN) for s in change[:, 0]])
    found = repeatability(noisy(rows))
    assert found.differ
    assert found.noise == pytest.approx(0.01 / RMS, rel=0.05)
    if what == "size":
        # Five sizes evenly on +- 2 %, whose standard deviation is 2 % times sqrt(5 / 8).
        assert found.size == pytest.approx(0.02 * np.sqrt(5 / 8), rel=0.05)


def test_noise_of_the_responses_own_colour_is_noise():
    def coloured():
        white = np.fft.rfft(RNG.normal(size=(5, len(T))))
        hz = np.fft.rfftfreq(len(T), 1 / 500)
        return np.fft.irfft(np.where((hz > 5) & (hz < 20), white, 0.05 * white), len(T))

    found = [repeatability(CLEAN + 0.05 * coloured()) for _ in range(100)]
    assert sum(one.differ for one in found) <= 3


def test_one_repeat_says_nothing():
    with pytest.raises(DataError, match="two repeats"):
        repeatability(CLEAN[None])
    with pytest.raises(DataError, match="constant"):
        repeatability(np.zeros((2, 50)))
