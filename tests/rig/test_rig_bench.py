"""The integrator of the rig against golden numbers, an adaptive one and a closed form."""

import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jbw import BoucWen, ModelError, Polynomial
from jbw.rig import SLIDERS, TRUTH
from jbw.rig.integrator import GRID, respond

FS = 1024.0


def sine_sweep(t, amplitude, f0, slope):
    return amplitude * np.sin(2 * np.pi * (f0 + slope * t / 2) * t)


def on_grid(signal):
    return lambda i, j: signal(np.arange(i, j) / (GRID * FS))


def relative(found, expected):
    return np.sqrt(np.mean((found - expected) ** 2) / np.mean(expected**2))


def adaptive(joint, force, num_samples):
    """States at the samples by DOP853, whose error control finds the kinks by itself."""
    damping = 2 * joint.zeta * joint.omega_n

    def rate(t, x):
        y, v, z = x
        a = force(t) - damping * v - joint.k * y - z
        return v, a, joint.alpha * v - joint.gamma * abs(v) * z - joint.delta * v * abs(z)

    t = np.arange(num_samples) / FS
    return solve_ivp(rate, (0, t[-1]), np.zeros(3), "DOP853", t, rtol=1e-11, atol=1e-14).y


def test_analog_sweep_matches_the_golden_states(golden):
    case = next(c for c in golden["sweep"]["cases"] if c["input"] == "analytic")

    def force(t):
        return sine_sweep(t, case["A"], case["f0"], case["rate_hz_per_s"])

    response = respond(BoucWen(**case["params"]), on_grid(force), case["N"] + 1, case["fs"])
    # Largest errors found, in units of the rms: 3.5e-7, 3.9e-7, 5.1e-6 (z jumps in slope).
    for x, name, rms, tolerance in zip(
        response, "yvZ", case["rms"], (5e-7, 5e-7, 1e-5), strict=True
    ):
        error = np.abs(x[case["index"]] - np.array(case[name])).max() / rms
        assert error < tolerance, name
        assert np.sqrt(np.mean(x**2)) == pytest.approx(rms, rel=1e-7)


@pytest.mark.parametrize("amplitude", [0.75, 3.0])
def test_velocity_is_right_to_three_in_ten_million(amplitude):
    """The number the documentation states, at the weakest and strongest laboratory sweep."""
    joint = TRUTH

    def force(t):
        return sine_sweep(t, amplitude, 12.0, 5.0)

    num_samples = 2 * 1024 + 1
    _, v, _ = respond(joint, on_grid(force), num_samples, FS)
    _, expected, _ = adaptive(joint, force, num_samples)
    assert relative(v, expected) < 3e-7


def test_linear_joint_follows_its_closed_form():
    """Without delta and gamma the joint is linear: a step of force, exactly."""
    joint = BoucWen(TRUTH.omega_n, 0.05, 497.4, 0.0, 0.0)
    num_samples = 20_000  # more than one block
    y, v, _ = respond(joint, lambda i, j: np.ones(j - i), num_samples, FS)
    t = np.arange(num_samples) / FS
    damped = joint.omega_n * np.sqrt(1 - joint.zeta**2)
    decay = np.exp(-joint.zeta * joint.omega_n * t)
    expected_v = decay * np.sin(damped * t) / damped
    slope = joint.zeta * joint.omega_n / damped
    expected_y = (1 - decay * (np.cos(damped * t) + slope * np.sin(damped * t))) / joint.omega_n**2
    # Runge-Kutta of order 4: (omega_n h)^4 / 120 = 2e-11 a radian.
    np.testing.assert_allclose(v, expected_v, atol=1e-9 * np.abs(expected_v).max())
    np.testing.assert_allclose(y, expected_y, atol=1e-9 * np.abs(expected_y).max())


@pytest.mark.parametrize("amplitude", [0.3, 6.0])
def test_sliders_follow_an_adaptive_integrator(amplitude):
    springs, slips = np.array([200.0, 200.0, 100.0]), np.array([0.3e-3, 1.2e-3, 4.0e-3])
    k, damping = SLIDERS.omega_n**2 - springs.sum(), 2 * SLIDERS.zeta * SLIDERS.omega_n

    def force(t):
        return sine_sweep(t, amplitude, 18.0, 1.0)

    def rate(t, x):
        y, v, z = x[0], x[1], x[2:]
        slides = np.abs(z) >= springs * slips
        a = force(t) - damping * v - k * y - z.sum()
        return np.array([v, a, *np.where(slides & (z * v > 0), 0.0, springs * v)])

    num_samples = 512 + 1
    t = np.arange(num_samples) / FS
    start = np.zeros(5)
    # A slider's limit is overshot by a step's length at most, so the steps are short.
    expected = solve_ivp(rate, (0, t[-1]), start, "RK45", t, rtol=1e-8, atol=1e-11, max_step=3e-5).y
    y, v, z = respond(SLIDERS, on_grid(force), num_samples, FS)
    assert np.abs(y).max() > (0.3e-3 if amplitude < 1 else 4e-3)  # one slips, or all three do
    # Found: 4e-7 and 5e-6.
    assert relative(v, expected[1]) < 2e-6
    assert relative(z, expected[2:].sum(axis=0)) < 2e-5


def test_refuses_what_it_cannot_integrate():
    def pulse(i, j):
        return np.ones(j - i)

    with pytest.raises(ModelError, match="nu"):
        respond(BoucWen(118.0, 0.004, 497.0, 340.0, 33.0, nu=2.0), pulse, 8, FS)
    unknown = BoucWen(118.0, 0.004, 497.0, 340.0, 33.0, restoring=Polynomial((1e9,)))
    with pytest.raises(ModelError, match="rig does not have the law `polynomial`"):
        respond(unknown, pulse, 8, FS)
    with pytest.raises(ModelError, match="finite"):
        respond(TRUTH, pulse, 4096, 1.0)  # omega_n h = 7: beyond stability
    with jax.enable_x64(False), pytest.raises(ModelError, match="float64"):
        respond(TRUTH, pulse, 8, FS)
