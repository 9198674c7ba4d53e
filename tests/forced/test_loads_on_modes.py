"""One of several modes: against harmonic balance of all modes, and against SciPy in time."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jbw
from jbw.errors import ConfigError, ModelError
from jbw.forced.curves import peaks, resonance
from jbw.forced.equivalent import equivalent_motion
from jbw.forced.random import random_response
from jbw.forced.sweeps import swept
from jbw.oscillator.laws.bouc_wen import BoucWenLaw

TAU = 2 * np.pi
OMEGA, ZETA = TAU * np.array([20.0, 47.0]), np.array([0.004, 0.005])
H, B, C = np.array([[1.0, -0.8], [0.6, 0.9]]), np.array([1.0, 0.9]), np.array([1.0, 0.7])
# alpha, delta, gamma of each joint
JOINTS = np.array([[1200.0, 300.0, 60.0], [2500.0, 200.0, 90.0]])
ONE_JOINT = jbw.Structure(
    OMEGA, ZETA, h=H[0], p=np.array([1.0, -0.7]), b=B, c=C, laws=(BoucWenLaw(*JOINTS[0]),)
)
TWO_JOINTS = jbw.Structure(
    OMEGA, ZETA, h=H, b=B, c=C, laws=tuple((BoucWenLaw(*joint),) for joint in JOINTS)
)


def motion_of(structure, mode, num_harmonics=1):
    return equivalent_motion(structure, num_harmonics, mode), abs(B[mode])


@pytest.mark.parametrize("structure", [ONE_JOINT, TWO_JOINTS], ids=["one joint", "two joints"])
@pytest.mark.parametrize(("mode", "level"), [(0, 0.5), (1, 8.0)])
def test_a_sweep_is_that_of_the_balance_of_all_modes(structure, mode, level):
    """With one harmonic the equations are the same; loops at each frequency correct the table."""
    motion, share = motion_of(structure, mode)
    peak = peaks(motion, np.array([[share * level]]))
    omega = peak.omega[0, 0] * np.array([0.9, 0.98, 0.995, 1.0, 1.006, 1.02, 1.1])
    y = swept(motion, peak, omega, upward=True)[:, 0]
    output = (y * motion.seen(np.abs(y), np.broadcast_to(omega, y.shape)))[0]
    expected = jbw.steady_state(structure, omega, level, num_harmonics=1)
    # The correction of the amplitude is of first order, of a table that is 1e-2 off.
    np.testing.assert_allclose(np.abs(output), np.abs(expected.y[..., 0].ravel()), rtol=2e-4)


def test_the_peak_is_the_highest_point_of_the_curve():
    motion, share = motion_of(TWO_JOINTS, 0)
    found = resonance(motion, np.array([[share * 0.5]]))
    near = found.peak.omega[0, 0] * (1 + 2e-3 * np.linspace(-1, 1, 9))
    expected = np.abs(jbw.steady_state(TWO_JOINTS, near, 0.5, num_harmonics=1).q[:, 0, 0])
    assert found.peak.y[0, 0] == pytest.approx(expected.max(), rel=1e-4)
    assert 3 <= np.argmax(expected) <= 5
    half = jbw.steady_state(TWO_JOINTS, found.half_power[0, 0], 0.5, num_harmonics=1)
    np.testing.assert_allclose(np.abs(half.q[:, 0, 0]), found.peak.y[0, 0] / np.sqrt(2), rtol=1e-5)


def integrated(level, omega, cycles):
    """Return the amplitude of the output of `TWO_JOINTS` by DOP853, in the last ten cycles."""
    stiffness, (alpha, delta, gamma) = OMEGA**2, JOINTS.T

    def rate(t, state):
        q, v, z = np.split(state, 3)
        x, speed = H @ q, H @ v
        dz = alpha * speed - gamma * np.abs(speed) * z - delta * speed * np.abs(z)
        push = B * level * np.cos(omega * t) - H.T @ (z - alpha * x)
        return np.concatenate([v, push - 2 * ZETA * OMEGA * v - stiffness * q, dz])

    period = TAU / omega
    t = period * np.linspace(cycles - 10, cycles, 641)[:-1]
    # The balance is the start, so that the transient is small: after 150 cycles exp(-3.8) of it.
    q = np.asarray(jbw.steady_state(TWO_JOINTS, omega, level, num_harmonics=1).q)[:, 0]
    start = np.concatenate([q.real, np.real(1j * omega * q), alpha * (H @ q.real)])
    found = solve_ivp(rate, (0, t[-1]), start, "DOP853", t, rtol=1e-8, atol=1e-11)
    return 2 * abs(np.mean(C @ found.y[:2] * np.exp(-1j * omega * t)))


@pytest.mark.slow
@pytest.mark.parametrize("offset", [0.985, 1.0, 1.01])
def test_a_slow_sweep_of_two_joints_is_that_of_scipy_in_time(offset):
    motion, share = motion_of(TWO_JOINTS, 0)
    peak = peaks(motion, np.array([[share * 0.5]]))
    omega = offset * peak.omega[0]
    y = swept(motion, peak, omega, upward=True)[:, 0]
    output = np.abs(y * motion.seen(np.abs(y), np.broadcast_to(omega, y.shape)))
    # One harmonic misses 1e-3; the transient is as large.
    assert output[0, 0] == pytest.approx(integrated(0.5, omega[0], 150), rel=2e-3)


def test_linear_modes_have_miles_rms():
    linear = replace(TWO_JOINTS, laws=((), ()))
    for mode in range(2):
        motion, share = motion_of(linear, mode)
        found = random_response(
            motion, lambda freq_hz: 0.01 + 0.0 * freq_hz, share * np.ones((1, 1))
        )
        miles = share * np.sqrt(0.01 / (8 * ZETA[mode] * OMEGA[mode] ** 3))
        # The force of resonance moves the other mode along, by terms of zeta^2.
        assert found.rms()[0] == pytest.approx(miles, rel=1e-4)


@pytest.mark.parametrize(("mode", "error"), [(2, ConfigError), (-1, ConfigError)])
def test_a_mode_that_does_not_exist_is_refused(mode, error):
    with pytest.raises(error, match="mode"):
        equivalent_motion(TWO_JOINTS, mode=mode)


def test_a_mode_that_the_source_does_not_drive_is_refused():
    with pytest.raises(ModelError, match="does not act"):
        equivalent_motion(replace(TWO_JOINTS, b=np.array([1.0, 0.0])), mode=1)
