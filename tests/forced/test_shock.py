"""Shock against closed forms, the golden simulation and SciPy's integration."""

from itertools import pairwise

import numpy as np
import pytest
from joints import GOLDEN, joint
from scipy.integrate import solve_ivp

from jbw.errors import ConfigError
from jbw.forced.equivalent import equivalent_motion
from jbw.forced.shock import SHAPES, classical_pulse, pulse_of, shock_response, shock_spectrum

SHOCK = GOLDEN["shock"]
ONE = np.ones((1, 1))


@pytest.mark.parametrize("peak", [1, 20])
def test_bouc_wens_joint_moves_as_the_golden_simulation(peak):
    golden = SHOCK[f"bouc_wen_half_sine_11ms_{peak}"]
    pulse = classical_pulse(peak, 0.011, "m/s^2")
    found = shock_response(equivalent_motion(joint("bouc_wen")), pulse, -ONE)
    assert np.max(np.abs(found.y)) == pytest.approx(golden["relative_y_max"], rel=1e-5)
    absolute = found.a + found.source
    largest = np.max(np.abs(absolute))
    assert largest == pytest.approx(golden["absolute_acceleration_max"], rel=1e-5)


@pytest.mark.parametrize("product", [0.25, 0.8])
def test_the_spectrum_of_a_half_sine_has_its_closed_form(product):
    golden = SHOCK[f"srs_undamped_fD_{product}"]
    pulse = classical_pulse(1.0, 1.0, "m/s^2", fs=4000.0)
    found = shock_spectrum(pulse.samples, pulse.fs, np.array([product]), np.inf)
    # The peak lies between samples of 1/4000 of the pulse: 2e-7.
    assert found[0] == pytest.approx(golden["closed_form"], rel=1e-6)


def test_a_damped_spectrum_has_the_golden_maximum():
    pulse = classical_pulse(1.0, 1.0, "m/s^2", fs=4000.0)
    found = shock_spectrum(pulse.samples, pulse.fs, np.array([0.25]))
    golden = SHOCK["srs_Q10_fD_0.25"]["maximax_absolute_acceleration"]
    assert found[0] == pytest.approx(golden, rel=1e-6)


@pytest.mark.parametrize("shape", SHAPES)
def test_a_spectrum_is_that_of_scipys_oscillator(shape):
    """An oscillator on the base, integrated under the pulse itself and after it."""
    quality, freq_hz, duration = 7.0, 31.0, 0.02
    pulse = classical_pulse(3.0, duration, "m/s^2", shape, fs=40000.0)
    omega = 2 * np.pi * freq_hz

    def rate(t, x):
        a = 3.0 * float(SHAPES[shape](np.array(t / duration))) if high == duration else 0.0
        return [x[1], -omega / quality * x[1] - omega**2 * x[0] - a]

    ends = [0.0, duration, duration + 1 / freq_hz]
    x, largest = np.zeros(2), 0.0
    for low, high in pairwise(ends):
        inside = np.linspace(low, high, 8001)
        found = solve_ivp(rate, (low, high), x, t_eval=inside, rtol=1e-9, atol=1e-13, max_step=1e-4)
        x = found.y[:, -1]
        largest = max(largest, np.max(np.abs(omega / quality * found.y[1] + omega**2 * found.y[0])))
    found = shock_spectrum(pulse.samples, pulse.fs, np.array([freq_hz]), quality)
    # The largest value lies between samples of 1/1290 of a cycle.
    assert found[0] == pytest.approx(largest, rel=1e-5)


@pytest.mark.parametrize(
    ("shape", "area"), [("half-sine", 2 / np.pi), ("sawtooth", 0.5), ("trapezoid", 0.9)]
)
def test_a_pulse_has_the_area_of_its_shape(shape, area):
    pulse = classical_pulse(3.0, 0.02, "m/s^2", shape)
    # Straight lines between 400 samples miss 5e-6 of a half-sine, a jump to zero half a sample.
    assert np.sum(pulse.samples) / pulse.fs == pytest.approx(3.0 * 0.02 * area, rel=1e-5)


def test_a_pulse_in_words():
    pulse = pulse_of("20g, 11 ms")
    assert pulse.unit == "m/s^2"
    assert np.max(pulse.samples) == pytest.approx(20 * 9.80665)
    assert pulse.duration == pytest.approx(0.011)
    saw = pulse_of("50 m/s^2,6ms,sawtooth")
    assert saw.samples[-2:] == pytest.approx([50.0 * (1 - 1 / 400), 25.0])


@pytest.mark.parametrize("text", ["20,11", "20g", "20g,11kg", "20g,11ms,triangle", "-1g,11ms"])
def test_a_wrong_pulse_is_refused(text):
    with pytest.raises(ConfigError):
        pulse_of(text)


def test_a_spectrum_beyond_half_the_rate_is_refused():
    with pytest.raises(ConfigError, match="half the sampling rate"):
        shock_spectrum(np.ones(10), 100.0, np.array([60.0]))
