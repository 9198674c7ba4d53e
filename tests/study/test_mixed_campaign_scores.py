"""Calibration of the joint route over many campaigns of every kind of test.

A file of its own, for files are shared out among processes.
"""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
from campaign_scores import score_campaigns


@pytest.mark.release
@pytest.mark.filterwarnings(
    "ignore"
)  # of the short window of Step 2, which the line fit allows for
def test_every_kind_of_test_together_is_calibrated():
    result = score_campaigns(20, campaign="mixed", repeats=2, noise_ratio=0.02)
    assert np.quantile(result.khat, 0.9) < 0.7
    for name, p in result.p_values.items():
        assert p > 1e-3, f"{name}: {p}"
    # The decays count among the degrees of freedom, 440 of 27,000, though their noise is a first
    # guess here and far too large; what two repeats say of the noise of few harmonics is rough.
    assert 0.96 < result.chi_square.mean() < 1.02
