"""Frequency and damping against amplitude, read off curves at a held force without any model."""

import numpy as np
import pytest
from scipy.optimize import fsolve

from jbw.campaign.settings import Identify
from jbw.identification.assemble import assemble, measured
from jbw.identification.diagnosis import diagnose
from jbw.measurement.records import Record, Test
from jbw.observables.drives import readings_of
from jbw.observables.line_fit import at_quadrature

# A spring c y|y| that softens and a damper d v|v|: the first harmonics are closed forms.
OMEGA_N, ZETA, GAIN, SPRING, DAMPER = 500.0, 0.004, 2.0, 3.5e6, 6.0
FACTOR = 8 / (3 * np.pi)
LEVELS = np.array([0.5, 1.0, 2.0, 3.0, 4.5, 6.0])  # N
OMEGA = 2 * np.pi * np.linspace(77.0, 81.0, 121)


def impedance(omega, y):
    """Force per unit mass over the displacement at an amplitude."""
    stiffness = OMEGA_N**2 - FACTOR * SPRING * y - omega**2
    return stiffness + 1j * (2 * ZETA * OMEGA_N * omega + FACTOR * DAMPER * omega**2 * y)


def response(level):
    """Complex displacement at all frequencies, from below the resonance on."""
    found, guess = [], 1e-7
    for w in OMEGA:
        (guess,) = fsolve(lambda y, w=w: abs(impedance(w, y) * y) - GAIN * level, guess)
        found.append(GAIN * level / impedance(w, abs(guess)))
    return np.array(found)


def curve(level):
    y = response(level)
    channels = {
        "frequency": OMEGA / (2 * np.pi),
        "force": np.full(len(OMEGA), level),
        "acceleration": OMEGA**2 * np.abs(y),
        "phase": np.angle(-(OMEGA**2) * y),
    }
    units = {"frequency": "Hz", "force": "N", "acceleration": "m/s^2", "phase": "rad"}
    return Test("frf", (Record(float("nan"), channels, units),), f"{level:g} N", float(level))


def exact(level):
    """Amplitude, frequency and damping where the motion lags by a quarter turn."""

    def left(x):
        value = impedance(x[1], x[0])
        return [value.real, value.imag * x[0] - GAIN * level]

    y, omega = fsolve(left, [GAIN * level / (2 * ZETA * OMEGA_N**2), OMEGA_N], xtol=1e-12)
    return y, omega, GAIN * level / (2 * omega**2 * y)


@pytest.mark.parametrize("level", [0.5, 6.0])
def test_a_quarter_turn_is_read_between_two_points(level):
    found = at_quadrature(OMEGA, np.full(len(OMEGA), level + 0j), response(level), GAIN)
    # A straight line between points a tenth of the peak's width apart.
    np.testing.assert_allclose(found, exact(level), rtol=5e-3)
    np.testing.assert_allclose(found[1], exact(level)[1], rtol=3e-6)


def test_a_curve_that_jumps_or_does_not_turn_tells_none():
    omega = np.array([490.0, 495.0, 499.0, 501.0, 505.0])
    lag = np.exp(-1j * np.array([0.1, 0.3, 0.8, 2.6, 3.0]))
    ones = np.ones(5, complex)
    assert at_quadrature(omega, ones, lag * [1, 2, 5, 1, 0.5], 1.0) is None
    assert at_quadrature(omega[:3], ones[:3], lag[:3], 1.0) is None


def test_curves_at_held_forces_tell_the_diagnosis():
    data = assemble(measured([curve(level) for level in LEVELS], Identify(), laws=(), gain=GAIN))
    read = readings_of(data.parts)
    expected = np.array([exact(level) for level in LEVELS]).T
    # The gain is that of a linear oscillator through the lowest level.
    np.testing.assert_allclose(np.sort(read.y), expected[0], rtol=0.01)
    np.testing.assert_allclose(np.sort(read.omega)[::-1], expected[1], rtol=1e-5)
    found = diagnose(read)
    assert found.softening_exponent[1] == pytest.approx(1.0, abs=0.05)
    assert found.damping_exponent[1] == pytest.approx(1.0, abs=0.1)
    assert found.spring[1] == pytest.approx(-SPRING, rel=0.05)
    assert found.damper[1] == pytest.approx(DAMPER, rel=0.05)
