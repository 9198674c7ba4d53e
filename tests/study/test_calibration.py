"""Calibration of the joint route over many campaigns of the virtual rig."""

import numpy as np
import pytest

from jbw.study.calibration import calibrate

CASES = {"laser noise": {"repeats": 24}, "one per cent": {"repeats": 4, "noise_ratio": 0.01}}


@pytest.mark.slow
@pytest.mark.parametrize("options", CASES.values(), ids=CASES.keys())
def test_the_truths_z_scores_follow_a_standard_normal(options):
    result = calibrate(50, **options)
    # k-hat < 0.7: the weights turn the Laplace approximation into the posterior. Its own estimate
    # from 500 draws scatters, so a few of 50 may exceed.
    assert np.quantile(result.khat, 0.9) < 0.7
    for name, p in result.p_values.items():
        assert p > 1e-3, f"{name}: {p}"
    # Chi-square of about 32,000 residuals has a relative sd of 0.8 %, its mean over 50 of 0.11 %.
    assert abs(result.chi_square.mean() - 1) < 0.006
