"""Damping without hysteresis, and intervals narrower than the instruments."""

import numpy as np
import pytest
import xarray as xr

from jbw.identification.calibration import calibration_sentences
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


def test_intervals_narrower_than_a_clock_or_a_sensor_say_what_they_leave_out():
    white = RNG.standard_normal((4, 500))

    def posterior(omega, gain):
        values = {"omega_n": 120.0 * (1 + omega * white), "gain": 15.0 * (1 + gain * white)}
        return xr.Dataset({name: (("chain", "draw"), x) for name, x in values.items()})

    # 99 % of a normal lie within 2.576 standard deviations; of 2000 draws to 5 %.
    frequency, gain = calibration_sentences(posterior(1e-6, 1e-4))
    half = float(frequency.split(", ")[1].split(" ppm")[0])
    assert half == pytest.approx(2.576, rel=0.08)
    assert "sampling rate" in frequency
    assert "calibration of the sensors" in gain
    assert calibration_sentences(posterior(1e-3, 0.1)) == []
