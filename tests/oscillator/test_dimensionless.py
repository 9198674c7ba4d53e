"""The dimensionless joint: its motion, scaled back, is that of the joint."""

import numpy as np
import pytest

from jbw.errors import ConfigError, ModelError
from jbw.oscillator.dimensionless import dimensionless
from jbw.oscillator.laws.springs import Cubic
from jbw.oscillator.oscillator import BoucWen

JOINT = BoucWen(118.0, 0.00444, 497.4, 340.21, 32.84)


def test_the_numbers_of_the_dimensionless_problem_by_hand():
    unit, frequency, length = dimensionless(JOINT, 59.0, 10.0)
    assert float(length) == pytest.approx(10.0 / 118.0**2)
    assert float(frequency) == pytest.approx(0.5)
    found = [float(x) for x in (unit.omega_n, unit.zeta, unit.alpha, unit.delta, unit.gamma)]
    expected = [1.0, 0.00444, 497.4 / 118.0**2, 340.21 * float(length), 32.84 * float(length)]
    np.testing.assert_allclose(found, expected, rtol=1e-15)


def test_a_golden_steady_motion_scaled_back(golden):
    from jbw.oscillator.steady.cycle import steady_state

    case = golden["true_oscillator_steady"]["cases"][0]
    joint = BoucWen(*(case[n] for n in ("omega_n", "zeta", "alpha", "delta", "gamma")))
    unit, frequency, length = dimensionless(joint, 2 * np.pi * case["f_hz"], case["A"])
    motion = length * steady_state(unit, frequency, 1.0)
    # Harmonic balance with its default number of harmonics: 6e-8 of Y_1.
    assert abs(complex(motion[0]) / complex(*case["Y1"]) - 1) < 1e-6


def test_a_restoring_force_keeps_its_slope_at_no_load():
    beside = BoucWen(118.0, 0.004, 497.4, 340.0, 33.0, restoring=Cubic(2e9))
    unit, _, length = dimensionless(beside, 59.0, 10.0)
    # By hand: f(l q)/A with f = 2e9 y^3.
    assert float(unit.restoring(0.7)) == pytest.approx(2e9 * (0.7 * float(length)) ** 3 / 10.0)
    still, _, nothing = dimensionless(beside, 59.0, 0.0)
    assert float(nothing) == 0.0
    assert float(still.restoring(0.7)) == 0.0
    assert float(still.delta) == 0.0


def test_what_has_no_dimensionless_form_is_refused():
    with pytest.raises(ModelError, match=r"nu = 1\.5"):
        dimensionless(BoucWen(118.0, 0.004, 497.4, 340.0, 33.0, nu=1.5), 59.0, 10.0)
    with pytest.raises(ConfigError, match="`amplitude` must be at least 0"):
        dimensionless(JOINT, 59.0, -1.0)
