"""Calibration of controlled tests over campaigns of the rig, alone and with decays.

A file of its own, for files are shared out among processes.
"""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
from controlled_scores import BLOCK, CAMPAIGNS, LEAST_P, p_value, score_campaigns

NUM_CAMPAIGNS = 30


@pytest.mark.release
@pytest.mark.filterwarnings("ignore")  # of the decays' few values
@pytest.mark.parametrize("name", CAMPAIGNS)
def test_controlled_tests_are_calibrated(name):
    """On each of three blocks of seeds, by Kolmogorov and Smirnov against the standard normal."""
    blocks = score_campaigns(name, NUM_CAMPAIGNS, 3, report=lambda _: None)
    assert len(blocks) == 3
    assert NUM_CAMPAIGNS <= BLOCK
    for block in blocks:
        for parameter in block[0].z:
            p = p_value(np.array([score.z[parameter] for score in block]))
            assert p > LEAST_P, f"{name}, {parameter}: {p}"
