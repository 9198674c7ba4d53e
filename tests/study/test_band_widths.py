"""The width of a band over what was measured, by hand."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from jbw.verification.bands import band, half_width


def test_a_band_of_known_width():
    """From -3 to 3 about values of +-3: to either side as much as their rms."""
    measured = np.array([3.0, -3.0, 3.0, -3.0])
    edges = np.stack([np.full(4, -3.0), np.zeros(4), np.full(4, 3.0)])
    assert half_width(edges, measured) == pytest.approx(1.0, rel=1e-15)
    # Of widths 2 and 4 the root mean square, sqrt(10), over twice the rms of 3.
    edges = np.array([[-1.0, -2.0], [0.0, 0.0], [1.0, 2.0]])
    assert half_width(edges, np.array([3.0, 3.0])) == pytest.approx(np.sqrt(10) / 6, rel=1e-15)


def test_the_band_of_a_hundred_normal_draws_is_nearly_as_wide_as_of_all():
    """The outermost of a hundred draws lies at 2.508 on average, the end of the band at 2.576."""
    density = lambda x: 100 * x * norm.pdf(x) * norm.cdf(x) ** 99  # noqa: E731
    outermost, _ = quad(density, -10, 10)
    draws = np.random.default_rng(0).standard_normal((100, 20_000))
    low, _, high = band(draws).mean(axis=1)
    # The mean of 20,000 largest draws has a standard error of 0.003.
    assert 0.5 * (high - low) == pytest.approx(outermost, abs=0.01)
    assert outermost / norm.ppf(0.995) == pytest.approx(0.9735, abs=1e-3)
