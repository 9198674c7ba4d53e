"""Three levels of sweeps and free decays of a linear oscillator: no joint, and no ridge to draw."""

import numpy as np
import pytest
from linear_campaign import write_linear
from toy_campaign import TRUTH

import jbw


@pytest.mark.slow
def test_a_structure_without_a_joint_is_answered_by_its_fit(tmp_path):
    said = []
    study = jbw.identify(jbw.load_campaign(write_linear(tmp_path)), seed=1, report=said.append)
    posterior = study.tree["posterior"].to_dataset()
    assert not {"alpha", "delta", "gamma"} & {*posterior.data_vars}
    for name in ("omega_n", "zeta"):
        z = (float(posterior[name].mean()) - TRUTH[name]) / float(posterior[name].std())
        assert abs(z) < 4, name  # two intervals: a chance of 1e-4
    found = {one.code: one for one in study.verdict.findings}["no_joint"]
    assert found.status == "failed"
    assert "laws = []" in found.action
    assert np.isfinite(found.number)
    # No second posterior, and no record by itself.
    assert not [line for line in said if "alone" in line or "by itself" in line]
    assert "decay" not in study.record["steps"]
