"""The width of a band over what was measured, by hand."""

import numpy as np
import pytest
from scipy.stats import norm

from jbw.verification.bands import half_width, noisy_band


def test_a_band_of_known_width():
    """From -3 to 3 about values of +-3: to either side as much as their rms."""
    measured = np.array([3.0, -3.0, 3.0, -3.0])
    edges = np.stack([np.full(4, -3.0), np.zeros(4), np.full(4, 3.0)])
    assert half_width(edges, measured) == pytest.approx(1.0, rel=1e-15)
    # Of widths 2 and 4 the root mean square, sqrt(10), over twice the rms of 3.
    edges = np.array([[-1.0, -2.0], [0.0, 0.0], [1.0, 2.0]])
    assert half_width(edges, np.array([3.0, 3.0])) == pytest.approx(np.sqrt(10) / 6, rel=1e-15)


def test_noise_adds_to_a_band_in_squares():
    """Draws three to either side of their median, with noise whose 99 % band is four wide."""
    draws = np.linspace(-3.0, 3.0, 1001)[:, None] / 0.99  # of these 99 % lie within 3
    low, middle, high = noisy_band(draws, 4.0 / norm.ppf(0.995))
    np.testing.assert_allclose([low[0], middle[0], high[0]], [-5.0, 0.0, 5.0], atol=1e-12)
    # Without a spread of the draws the band is that of the noise, however few they are.
    low, _, high = noisy_band(np.zeros((2, 1)), 1.0)
    assert high[0] == -low[0] == pytest.approx(norm.ppf(0.995), rel=1e-15)
