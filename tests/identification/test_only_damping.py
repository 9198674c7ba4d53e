"""Damping without hysteresis, and intervals narrower than the instruments."""

import numpy as np
import pytest

from jbw.identification.equivalent import Effects, hysteresis_finding

RNG = np.random.default_rng(0)
NOTHING = 1e-4 * RNG.standard_normal(500)
SOFTER = -3e-3 + NOTHING
DAMPED = 0.4 + 0.01 * RNG.standard_normal(500)


@pytest.mark.parametrize(("misses", "status"), [(True, "failed"), (False, "usable")])
def test_damping_that_leaves_the_frequency_alone_is_no_hysteresis(misses, status):
    found = hysteresis_finding(Effects(NOTHING, DAMPED), 1e-3, ("bouc_wen",), misses=misses)
    assert found.status == status
    assert "No hysteresis is seen" in found.reason
    assert "40 % [" in found.reason
    assert 'laws = ["quadratic_damping"]' in found.action


@pytest.mark.parametrize(
    ("added", "laws"),
    [
        (Effects(SOFTER, DAMPED), ("bouc_wen",)),  # hysteresis
        (Effects(NOTHING, NOTHING), ("bouc_wen",)),  # no joint
        (Effects(0 * NOTHING, DAMPED), ("quadratic_damping",)),  # as it was told
    ],
)
def test_hysteresis_no_joint_and_drag_itself_are_not_doubted(added, laws):
    assert hysteresis_finding(added, 1e-3, laws, misses=True) is None
