"""The width of a band over what was measured, by hand."""

import numpy as np
import pytest

from jbw.verification.bands import half_width


def test_a_band_of_known_width():
    """From -3 to 3 about values of +-3: to either side as much as their rms."""
    measured = np.array([3.0, -3.0, 3.0, -3.0])
    edges = np.stack([np.full(4, -3.0), np.zeros(4), np.full(4, 3.0)])
    assert half_width(edges, measured) == pytest.approx(1.0, rel=1e-15)
    # Of widths 2 and 4 the root mean square, sqrt(10), over twice the rms of 3.
    edges = np.array([[-1.0, -2.0], [0.0, 0.0], [1.0, 2.0]])
    assert half_width(edges, np.array([3.0, 3.0])) == pytest.approx(np.sqrt(10) / 6, rel=1e-15)
