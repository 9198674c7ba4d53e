"""What summary.json says: numbers that JSON can hold, and what is not known said so."""

import json
from dataclasses import replace

import pytest

from jbw import rig
from jbw.identification.linear_step import linear_step
from jbw.study.summary import _linear


@pytest.mark.filterwarnings("ignore:The .* hann window resolves")
def test_one_record_has_no_cv():
    (noise,) = rig.measure(seed=1, tests=["noise_0p005V"], repeats=2).tests
    alone = replace(noise, records=noise.records[:1])
    summary = _linear(linear_step(alone), {})
    json.dumps(summary, allow_nan=False)
    assert {row["cv"] for row in summary["parameters"].values()} == {None}
    assert "There is no CV" in summary["statements"][0]
    both = _linear(linear_step(noise), {})
    assert both["parameters"]["zeta"]["cv"] > 0
    assert "CVs are the coefficients of variation between 2 repeats" in both["statements"][0]
