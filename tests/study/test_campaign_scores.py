"""Calibration of the joint route over many campaigns of the virtual rig."""

import sys
from pathlib import Path

import numpy as np
import pytest

from jbw.errors import ConfigError

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
from campaign_scores import score_campaigns


@pytest.mark.release
def test_the_truths_z_scores_follow_a_standard_normal():
    result = score_campaigns(24, repeats=4, noise_ratio=0.01)
    # k-hat < 0.7: the weights turn the Laplace approximation into the posterior. Its own estimate
    # from 500 draws scatters, so a few of 24 may exceed.
    assert np.quantile(result.khat, 0.9) < 0.7
    for name, p in result.p_values.items():
        assert p > 1e-3, f"{name}: {p}"
    # Chi-square of about 32,000 residuals has a relative sd of 0.8 %, its mean over 24 of 0.16 %.
    assert abs(result.chi_square.mean() - 1) < 0.006


def test_an_unknown_campaign_is_refused():
    with pytest.raises(ConfigError, match='"sweeps", "mixed", but is "all"'):
        score_campaigns(1, campaign="all")
