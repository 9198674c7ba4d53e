"""Random vibration beside a sine, against a Monte Carlo without jbw and the limits of each part."""

import json
from pathlib import Path

import numpy as np
import pytest

import jbw
from jbw.errors import ModelError
from jbw.forced.equivalent import equivalent_motion
from jbw.forced.random import random_response
from jbw.forced.sine_on_random import closed_path, sine_on_random

# Made by `benchmarks/random_modes.py`, without jbw.
MONTE_CARLO = json.loads((Path(__file__).parents[1] / "golden_random_modes.json").read_text())
ONE, TAU = np.ones((1, 1)), 2 * np.pi
STATED = MONTE_CARLO["no sine"]["structure"]
MOTION = equivalent_motion(
    jbw.Oscillator(
        TAU * STATED["hz"][0],
        STATED["zeta"][0],
        (jbw.laws.BoucWenLaw(*STATED["joints"][0]),),
    )
)


def density(freq_hz):
    low, high = MONTE_CARLO["no sine"]["band_hz"]
    return np.where((freq_hz >= low) & (freq_hz <= high), MONTE_CARLO["no sine"]["density"], 0.0)


def found_in(level, hz, motion=MOTION):
    return sine_on_random(motion, density, ONE, level * ONE, TAU * hz)


@pytest.mark.parametrize("case", ["sine below", "sine below, strong", "sine above"])
def test_both_parts_are_those_of_a_monte_carlo(case):
    """The strong sine lowers the rms by 20 % and doubles the damping."""
    stated = MONTE_CARLO[case]
    found = found_in(stated["amplitude"], stated["sine_hz"])
    mean, error = stated["rms_y"]
    # Averaging of the energy neglects that the sine's amplitude changes with that of the mode.
    assert found.random.rms()[0] == pytest.approx(mean, abs=max(3 * error, 1e-2 * mean))
    assert abs(found.sine[0, 0]) == pytest.approx(stated["sine_y"][0], rel=1e-3)


def test_without_a_sine_the_random_motion_is_that_alone():
    alone = random_response(MOTION, density, ONE)
    found = found_in(1e-6, 13.1)
    # Beside the sine, free vibration is taken with one harmonic, and loops from a table.
    assert found.random.rms()[0] == pytest.approx(alone.rms()[0], rel=1e-3)


def test_a_linear_joint_superposes_both():
    omega_n, zeta, omega = TAU * 20.0, 0.01, TAU * 13.1
    found = found_in(5.0, 13.1, equivalent_motion(jbw.Oscillator(omega_n, zeta)))
    miles = np.sqrt(2e-3 / (8 * zeta * omega_n**3))
    assert found.random.rms()[0] == pytest.approx(miles, rel=1e-4)
    exact = 5.0 / (omega_n**2 - omega**2 + 2j * zeta * omega_n * omega)
    assert found.sine[0, 0] == pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize(("hz", "times"), [(20.2, ""), (20.0 / 3, "3 times")])
def test_a_sine_at_the_mode_is_refused(hz, times):
    with pytest.raises(ModelError, match=f"{times}.*widths"):
        found_in(0.1, hz)


def test_a_path_closes_near_the_ratio_of_the_frequencies():
    for ratio in (0.2, 0.655, 1.585, 4.0):
        mode, sine = closed_path(ratio)
        assert sine / mode == pytest.approx(ratio, rel=0.07)
        assert np.gcd(mode, sine) == 1
