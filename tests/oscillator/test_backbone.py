"""Backbone, frequency responses and continuation against phase resonance, series and shooting."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jbw.errors import ModelError
from jbw.oscillator.oscillator import BoucWen
from jbw.oscillator.periodic import shooting
from jbw.oscillator.steady.backbone import backbone, frequency_response
from jbw.oscillator.steady.balance import dimensionless, linear_response, newton
from jbw.oscillator.steady.continuation import response_curve
from jbw.oscillator.steady.cycle import steady_cycle, steady_state

OMEGA_N = 2 * np.pi * 18.8
PAPER = BoucWen(OMEGA_N, 0.00444, 497.4, 340.21, 32.84)
# Softens faster than it dissipates: three responses between two folds below omega_n.
FOLDED = BoucWen(OMEGA_N, 0.003, 3000.0, 340.21, 3.0)


def test_backbone_is_the_phase_resonance_of_the_balance():
    y_peak = np.array([1e-4, 8e-4, 4.8e-3, 1e-2])
    line = backbone(PAPER, y_peak)
    first = np.asarray(steady_state(PAPER, line.omega, line.amplitude))[:, 0]
    # Leaving the higher harmonics out costs at most 2.5e-4 in Y (theory), and 1e-2 degrees.
    np.testing.assert_allclose(np.abs(first), y_peak, rtol=2.5e-4)
    np.testing.assert_allclose(np.degrees(np.angle(first)), -90.0, atol=1e-2)
    np.testing.assert_allclose(line.amplitude, 2 * line.zeta * line.omega**2 * y_peak, rtol=1e-14)


def test_backbone_at_small_amplitude():
    y_peak = np.array([0.0, 1e-6])
    line = backbone(PAPER, y_peak)
    # Leading terms of the steady loop; the next ones are (delta Y)^2 = 1e-7 of alpha.
    softening = 4 / (3 * np.pi) * PAPER.alpha * PAPER.delta * y_peak
    np.testing.assert_allclose(line.omega**2, OMEGA_N**2 - softening, rtol=1e-9)
    opening = 2 / (3 * np.pi) * PAPER.alpha * PAPER.gamma * y_peak / line.omega**2
    np.testing.assert_allclose(line.zeta, PAPER.zeta * OMEGA_N / line.omega + opening, rtol=1e-8)
    assert float(line.amplitude[0]) == 0.0


def test_backbone_differentiates():
    slope = jax.grad(
        lambda delta: backbone(BoucWen(OMEGA_N, 0.004, 500.0, delta, 30.0), 1e-6).omega
    )
    # d(omega)/d(delta) = -(2/(3 pi)) alpha Y / omega to leading order.
    wanted = -2 / (3 * np.pi) * 500.0 * 1e-6 / OMEGA_N
    assert float(slope(340.0)) == pytest.approx(wanted, rel=2e-3)


@pytest.mark.slow
def test_frequency_response_is_the_steady_state_over_frequency_and_level():
    omega = 2 * np.pi * np.linspace(17.0, 20.0, 25)
    amplitude = np.array([0.5, 5.0])
    swept = frequency_response(PAPER, omega, amplitude)
    assert swept.shape == (2, 25, 8)
    apart = steady_state(PAPER, omega, amplitude[:, None])
    # One root, two starts: roundoff over the damping.
    assert np.max(np.abs(swept - apart)) < 1e-12 * np.max(np.abs(apart))


@pytest.mark.slow
def test_continuation_survives_where_a_cold_newton_fails():
    joint = BoucWen(OMEGA_N, 0.003, 3000.0, 340.0, 33.0)
    omega, amplitude = 0.97 * OMEGA_N, 10.0
    unit, ratio, _ = dimensionless(joint, omega, jnp.asarray(amplitude))
    _, converged = newton(unit, ratio, linear_response(unit, ratio, 8), 2)
    assert not converged
    alone = steady_state(joint, omega, amplitude)
    swept = frequency_response(joint, np.linspace(1.1, 0.97, 8) * OMEGA_N, amplitude)[-1]
    np.testing.assert_allclose(swept, alone, rtol=0, atol=1e-12 * np.abs(alone[0]))
    # With eight harmonics; this joint softens six times as much as the paper's.
    orbit = shooting(joint, omega, amplitude)
    assert np.max(np.abs(orbit.harmonics - alone)) < 1e-6 * np.abs(alone[0])


@pytest.fixture(scope="module")
def folded_curve():
    return response_curve(FOLDED, 0.8 * OMEGA_N, 1.1 * OMEGA_N, 1.0)


@pytest.mark.slow
def test_curve_goes_round_its_folds(folded_curve):
    back = np.flatnonzero(~folded_curve.onward)
    assert np.all(np.diff(back) == 1)
    before, on, after = back[0] - 2, back[len(back) // 2], back[-1] + 2
    for place, stable in ((before, True), (on, False), (after, True)):
        omega, harmonics = folded_curve.omega[place], folded_curve.harmonics[place]
        cycle = steady_cycle(FOLDED, harmonics, omega, num_points=4)
        orbit = shooting(FOLDED, omega, 1.0, initial=(cycle.y[0], cycle.v[0], cycle.z[0]))
        # What 8 harmonics leave out, magnified near the folds.
        assert np.max(np.abs(orbit.harmonics - harmonics)) < 1e-5 * np.abs(harmonics[0])
        assert (np.max(np.abs(orbit.multipliers)) < 1.0) == stable


@pytest.mark.slow
def test_rising_and_falling_sweeps_differ_between_the_folds(folded_curve):
    between = folded_curve.omega[~folded_curve.onward]
    omega = np.linspace(between.min() - 2.0, between.max() + 2.0, 41)
    rising = np.asarray(frequency_response(FOLDED, omega, 1.0))
    falling = np.asarray(frequency_response(FOLDED, omega[::-1], 1.0))[::-1]
    inside = (omega > between.min() + 0.2) & (omega < between.max() - 0.2)
    outside = (omega < between.min() - 0.2) | (omega > between.max() + 0.2)
    assert np.all(np.abs(falling[inside, 0]) > 2.0 * np.abs(rising[inside, 0]))
    # Outside one response exists.
    np.testing.assert_allclose(falling[outside, 0], rising[outside, 0], rtol=1e-10)


@pytest.mark.release  # a curve with folds is in this file
def test_curve_without_folds_is_the_steady_state():
    curve = response_curve(PAPER, 1.1 * OMEGA_N, 0.9 * OMEGA_N, 2.0)
    assert np.all(curve.onward)
    assert np.all(np.diff(curve.omega) < 0.0)
    apart = np.asarray(steady_state(PAPER, curve.omega, 2.0))
    assert np.max(np.abs(curve.harmonics - apart)) < 1e-11 * np.max(np.abs(apart))


def test_curve_says_where_it_stopped():
    with pytest.raises(ModelError, match="after 5 points"):
        response_curve(PAPER, 0.9 * OMEGA_N, 1.1 * OMEGA_N, 2.0, max_points=5)
