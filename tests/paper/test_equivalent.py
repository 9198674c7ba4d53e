"""The equivalent system against golden numbers, quadrature and scipy's integration."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.tree_util import Partial
from scipy.integrate import solve_ivp

from jbw.errors import ConfigError, ModelError
from jbw.oscillator.oscillator import BoucWen
from jbw.paper.coefficients import Smoothing, smoothed_force, smoothing
from jbw.paper.equivalent import (
    equivalent_acceleration,
    simulate_equivalent,
    smoothed_harmonics,
    square_wave,
)

JOINT = BoucWen(118.12388377497622, 0.00444, 497.40, 340.21, 32.84)


def tone(amplitude, omega, t):
    return amplitude * jnp.cos(omega * t)


def last_harmonics(response, omega, num_samples):
    """Odd harmonics 1, 3, 5 of the last `num_samples` samples, whole periods of the tone."""
    t, y = np.asarray(response.t[-num_samples:]), np.asarray(response.y[-num_samples:])
    return np.array([2 * np.mean(y * np.exp(-1j * n * omega * t)) for n in (1, 3, 5)])


def reference(joint, polynomial, force, times, initial):
    """Eq. (14) written out, by scipy, restarted at every turning point where its force jumps."""

    def field(t, state, direction):
        y, v = state
        rho = -direction * polynomial.lambda_2
        spring = (joint.k + polynomial.lambda_1) * y + rho * y**2 + polynomial.lambda_3 * y**3
        damping = 2 * joint.zeta * joint.omega_n * v
        return [v, force(t) - damping - spring - direction * polynomial.lambda_0]

    def turning(t, state, direction):
        return state[1]

    turning.terminal = True
    states = np.full((2, len(times)), np.nan)
    t, state, direction = times[0], np.array(initial, float), np.sign(initial[1])
    while t < times[-1]:
        turning.direction = -direction
        run = solve_ivp(
            field,
            (t, times[-1]),
            state,
            method="DOP853",
            dense_output=True,
            events=turning,
            args=(direction,),
            rtol=1e-11,
            atol=1e-14,
        )
        inside = (times >= t) & (times <= run.t[-1])
        states[:, inside] = run.sol(times[inside])
        # The event leaves v at rounding; the next leg starts clear of it, with the other sign.
        t, state, direction = run.t[-1], run.y[:, -1] * [1, 0], -direction
    return states


# --- the switched force -------------------------------------------------------------------------


def test_square_wave_golden(golden):
    for case in golden["square_wave_eq15"]["cases"]:
        theta = case["w"] * case["t"]
        printed = square_wave(case["lambda0"], theta, "printed")
        np.testing.assert_allclose(printed, case["eq15"][0], rtol=0, atol=1e-17)
        corrected = square_wave(case["lambda0"], theta)
        np.testing.assert_array_equal(corrected, -printed)


def test_square_wave_approaches_the_sign_of_the_velocity():
    # y = cos(theta), so v < 0 on (0, pi). Partial sums are off by 1/(num_terms sin(theta)).
    theta = np.array([0.4, 1.5, 2.8, 3.6, 5.0, 6.0])
    wave = square_wave(0.7, theta, num_terms=2000)
    np.testing.assert_allclose(wave, -0.7 * np.sign(np.sin(theta)), atol=1e-3)


def test_two_terms_hold_90_percent_of_the_power():
    theta = 2 * np.pi * np.arange(64) / 64
    power = np.mean(np.square(square_wave(1.0, theta)))
    np.testing.assert_allclose(power, 8 / np.pi**2 * (1 + 1 / 9), rtol=1e-14)


# --- formulation --------------------------------------------------------------------------------


@pytest.mark.parametrize("variant", ["least_squares", "chebyshev"])
def test_harmonic_content(variant):
    y_peak = 2.4e-3
    polynomial = smoothing(JOINT, y_peak, variant)
    nodes, weights = np.polynomial.legendre.leggauss(40)
    z = np.zeros(2, complex)
    for low in (0.0, np.pi):
        theta = low + np.pi * (nodes + 1) / 2
        v = -np.sin(theta)
        force = np.asarray(smoothed_force(polynomial, y_peak * np.cos(theta), v))
        z += [np.sum(weights * force * np.exp(-1j * n * theta)) / 2 for n in (1, 3)]
    np.testing.assert_allclose(smoothed_harmonics(polynomial, y_peak), z, rtol=1e-13, atol=1e-15)


def test_acceleration_is_equation_14():
    joint = BoucWen(10.0, 0.1, 30.0, 0.0, 0.0)
    polynomial = Smoothing(lambda_0=0.5, lambda_1=20.0, lambda_2=3.0, lambda_3=-1.0)
    # By hand at y = 2, v = -1: 7 + 2 - (70 + 20) 2 - 3 * 4 + 8 + 0.5, then rho and u_0 flipped.
    down, up = -1.0, 1.0
    np.testing.assert_allclose(equivalent_acceleration(joint, polynomial, 2.0, down, 7.0), -174.5)
    np.testing.assert_allclose(equivalent_acceleration(joint, polynomial, 2.0, up, 7.0), -155.5)
    given = equivalent_acceleration(joint, polynomial, 2.0, up, 7.0, u_0=0.25)
    np.testing.assert_allclose(given, -155.25)


# --- time response ------------------------------------------------------------------------------


@pytest.mark.slow
def test_response_to_a_function_agrees_with_scipy():
    polynomial = smoothing(JOINT, 2e-3, "chebyshev")
    fs, num_samples = 256.0, 512

    def force(t):
        return 3.0 * jnp.cos(37.0 * t) + 2.0 * jnp.sin(71.0 * t)

    initial = (1e-3, 0.05)
    times = np.arange(num_samples) / fs
    exact = reference(
        JOINT,
        polynomial,
        lambda t: 3.0 * np.cos(37.0 * t) + 2.0 * np.sin(71.0 * t),
        times,
        initial,
    )
    errors = []
    for substeps in (4, 16):
        response = simulate_equivalent(
            JOINT,
            polynomial,
            force,
            fs,
            initial=initial,
            substeps=substeps,
            num_samples=num_samples,
        )
        errors.append(np.max(np.abs(response.y - exact[0])) / np.max(np.abs(exact[0])))
    # First order: the steps run over the jumps, up to 0.07 N/kg, of turning points far from
    # Y; measured 2.4e-3 and 5e-4, on to 3e-5 with 256 steps a sample.
    assert errors[0] < 4e-3
    assert errors[1] < 1e-3
    np.testing.assert_array_equal(response.t, times)
    np.testing.assert_array_equal((response.y[0], response.v[0]), initial)


def test_response_to_samples_is_linear_between_them():
    # A smooth cubic system, so only the input's corners count, and they fall on steps.
    polynomial = Smoothing(lambda_0=0.0, lambda_1=480.0, lambda_2=0.0, lambda_3=-6e7)
    fs, num_samples = 128.0, 200
    u = 5.0 * np.random.default_rng(7).standard_normal(num_samples)
    times = np.arange(num_samples) / fs

    state, states = np.zeros(2), [np.zeros(2)]
    for n in range(num_samples - 1):

        def field(t, x, n=n):
            force = u[n] + (t - times[n]) * fs * (u[n + 1] - u[n])
            spring = (JOINT.k + 480.0) * x[0] - 6e7 * x[0] ** 3
            return [x[1], force - 2 * JOINT.zeta * JOINT.omega_n * x[1] - spring]

        run = solve_ivp(field, times[n : n + 2], state, method="DOP853", rtol=1e-12, atol=1e-15)
        state = run.y[:, -1]
        states.append(state)
    exact = np.array(states).T
    response = simulate_equivalent(JOINT, polynomial, u, fs, substeps=8)
    # Tsit5 with omega h = 0.12: local error 1e-8 a step, 1e3 steps.
    np.testing.assert_allclose(response.y, exact[0], rtol=0, atol=2e-6 * np.max(np.abs(exact[0])))
    np.testing.assert_allclose(response.v, exact[1], rtol=0, atol=2e-6 * np.max(np.abs(exact[1])))
    balance = response.a + 2 * JOINT.zeta * JOINT.omega_n * response.v + JOINT.k * response.y
    np.testing.assert_allclose(balance + response.z, u, rtol=0, atol=1e-11)


@pytest.mark.slow
def test_cubic_system_golden(golden):
    force = Partial(tone)
    for case in golden["cubic_equivalent_steady"]["cases"]:
        joint = BoucWen(case["omega0"], case["zeta"], 0.0, 0.0, 0.0)
        polynomial = Smoothing(0.0, 0.0, 0.0, case["lambda3"])
        omega, orders = case["w"], np.array([1, 3, 5])
        expected = np.array([complex(*case[f"Y{n}"]) for n in orders])
        start = (np.sum(expected).real, np.sum(1j * orders * omega * expected).real)
        response = simulate_equivalent(
            joint,
            polynomial,
            Partial(force, case["A"], omega),
            128 * omega / (2 * np.pi),
            initial=start,
            substeps=2,
            num_samples=128 * 20 + 1,
        )
        found = last_harmonics(response, omega, 128)
        # From the golden orbit, whose harmonics from the 7th on are left out: 5e-11 of Y_1. The
        # fixed step adds 1e-9, and a tone near omega_n/3 enlarges both in Y_3.
        scale = abs(expected[0])
        assert abs(found[0] - expected[0]) < 1e-8 * scale
        assert abs(found[1] - expected[1]) < 2e-5 * abs(expected[1])
        assert abs(found[2] - expected[2]) < 1e-8 * scale


@pytest.mark.slow
def test_steady_response_is_near_the_true_oscillator(golden):
    # Chebyshev keeps Y_1; Y_3 carries what the fit leaves of its sine part: measured 0.3 % at
    # 0.24 mm and below 1 % at 0.8 mm, against 7.5 % and 8 % of the uniform fit.
    for case in golden["true_oscillator_steady"]["cases"]:
        if (case["A"], case["f_hz"]) not in [(3.0, 6.0), (3.0, 6.5), (10.0, 5.0)]:
            continue
        omega = 2 * np.pi * case["f_hz"]
        expected = np.array([complex(*case[f"Y{n}"]) for n in (1, 3)])
        for variant, error_1, error_3 in [
            ("chebyshev", 1e-5, 0.015),
            ("least_squares", 1e-4, 0.09),
        ]:
            response = simulate_equivalent(
                JOINT,
                smoothing(JOINT, case["ymax"], variant),
                Partial(tone, case["A"], omega),
                128 * case["f_hz"],
                initial=tuple(case["state_at_t0"][:2]),
                substeps=2,
                num_samples=128 * 100 + 1,
            )
            found = last_harmonics(response, omega, 128)[:2]
            assert abs(found[0] / expected[0] - 1) < error_1
            assert abs(found[1] / expected[1] - 1) < error_3


def test_switched_force_from_outside():
    # With Eq. (15) as a function of time, the two terms drive y like any input, from the left.
    polynomial = Smoothing(lambda_0=0.3, lambda_1=490.0, lambda_2=0.0, lambda_3=0.0)
    fs, omega = 256.0, 40.0

    def minus_wave(t):
        return 2.0 - square_wave(0.3, omega * t)

    apart = simulate_equivalent(
        JOINT,
        polynomial,
        np.full(100, 2.0),
        fs,
        u_0=lambda t: square_wave(0.3, omega * t),
    )
    bare = Smoothing(lambda_0=0.0, lambda_1=490.0, lambda_2=0.0, lambda_3=0.0)
    together = simulate_equivalent(JOINT, bare, minus_wave, fs, num_samples=100)
    np.testing.assert_allclose(apart.y, together.y, rtol=0, atol=1e-15)
    np.testing.assert_allclose(apart.a, together.a, rtol=0, atol=1e-12)


def test_printed_switching_makes_energy_above_resonance():
    # Work of the switched force over a period, by hand: -(4/3) lambda_2 Y^3 s with the branches
    # of du/dt; above resonance u and y have opposite signs, so that s = -1 and energy is made.
    polynomial = Smoothing(lambda_0=0.0, lambda_1=480.0, lambda_2=-6e4, lambda_3=0.0)
    fs, omega = 2048.0, 2 * np.pi * 40.0
    response = simulate_equivalent(
        JOINT, polynomial, Partial(tone, 10.0, omega), fs,
        num_samples=int(fs * 80) + 1, variant="printed",
    )  # fmt: skip
    last = int(fs * 2)  # whole periods
    y, z = (np.asarray(part)[-last - 1 :] for part in (response.y, response.z))
    work = np.sum((z[1:] + z[:-1]) / 2 * np.diff(y)) / 80
    y_peak = np.max(np.abs(y))
    assert work == pytest.approx(-4 / 3 * 6e4 * y_peak**3, rel=0.02)
    right = simulate_equivalent(
        JOINT, polynomial, Partial(tone, 10.0, omega), fs, num_samples=int(fs * 80) + 1
    )
    y, z = (np.asarray(part)[-last - 1 :] for part in (right.y, right.z))
    work = np.sum((z[1:] + z[:-1]) / 2 * np.diff(y)) / 80
    assert work == pytest.approx(4 / 3 * 6e4 * np.max(np.abs(y)) ** 3, rel=0.02)


def test_smooth_switching_is_scipys():
    polynomial = smoothing(JOINT, 2e-3, "chebyshev")
    fs, num_samples, width = 256.0, 256, 0.05
    times = np.arange(num_samples) / fs

    def field(t, state):
        y, v = state
        z = polynomial.lambda_1 * y + polynomial.lambda_3 * y**3
        z += np.tanh(v / width) * (polynomial.lambda_0 - polynomial.lambda_2 * y**2)
        return [v, 3 * np.cos(37 * t) - 2 * JOINT.zeta * JOINT.omega_n * v - JOINT.k * y - z]

    options = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-15}
    exact = solve_ivp(field, (0, times[-1]), [1e-3, 0.05], t_eval=times, **options).y
    response = simulate_equivalent(
        JOINT, polynomial, Partial(tone, 3.0, 37.0), fs, num_samples=num_samples,
        initial=(1e-3, 0.05), substeps=8, width=width,
    )  # fmt: skip
    # Tsit5 at omega h = 0.06 where nothing jumps: 1e-8 of the motion over a second.
    np.testing.assert_allclose(response.y, exact[0], rtol=0, atol=1e-7 * np.max(np.abs(exact[0])))


@pytest.mark.slow
def test_response_gradients_forward_and_reverse():
    u = 4.0 * np.sin(0.3 * np.arange(64))

    def energy(x, adjoint):
        joint = BoucWen(x[0], x[1], x[2], 340.21, 32.84)
        polynomial = Smoothing(0.0, x[2], 0.0, x[3])
        response = simulate_equivalent(joint, polynomial, u, 128.0, substeps=2, adjoint=adjoint)
        return 1e6 * jnp.sum(response.y**2)

    x = jnp.array([118.0, 0.01, 497.0, -6e7])
    reverse = jax.grad(energy)(x, None)
    forward = jax.jacfwd(energy)(x, diffrax.ForwardMode())
    # Two modes through 126 identical steps: rounding.
    np.testing.assert_allclose(forward, reverse, rtol=1e-10, atol=1e-12 * float(energy(x, None)))
    for i in (0, 3):
        h = 1e-4 * float(x[i]) * np.eye(4)[i]
        slope = (energy(x + h, None) - energy(x - h, None)) / (2 * h[i])
        # Central differences: (1e-4)^2 times the curvature of a record of 10 periods.
        np.testing.assert_allclose(reverse[i], slope, rtol=1e-4)
    # alpha and lambda_1 together leave the linear stiffness alone: Eq. (26).
    assert abs(float(reverse[2]) * 497.0) < 1e-9 * abs(float(reverse[0]) * 118.0)


def test_doors():
    polynomial = Smoothing(0.0, 497.4, 0.0, 0.0)
    with pytest.raises(ConfigError, match="`num_samples` must be given"):
        simulate_equivalent(JOINT, polynomial, jnp.sin, 100.0)
    with pytest.raises(ConfigError, match="`num_samples` must equal the 5 samples"):
        simulate_equivalent(JOINT, polynomial, np.zeros(5), 100.0, num_samples=6)
    with pytest.raises(ConfigError, match="`u` must have one axis"):
        simulate_equivalent(JOINT, polynomial, np.zeros((2, 5)), 100.0)
    with pytest.raises(ConfigError, match="`fs` must be greater than 0"):
        simulate_equivalent(JOINT, polynomial, np.zeros(5), 0.0)
    with pytest.raises(ConfigError, match="`substeps` must be at least 1"):
        simulate_equivalent(JOINT, polynomial, np.zeros(5), 100.0, substeps=0)
    with pytest.raises(ConfigError, match='"corrected" or "printed"'):
        simulate_equivalent(JOINT, polynomial, np.zeros(5), 100.0, variant="wrong")
    with pytest.raises(ConfigError, match="`width` must be at least 0"):
        simulate_equivalent(JOINT, polynomial, np.zeros(5), 100.0, width=-1.0)
    with pytest.raises(TypeError, match="unexpected keyword argument 'widht'"):
        simulate_equivalent(JOINT, polynomial, np.zeros(5), 100.0, widht=1.0)
    with pytest.raises(ModelError, match="`u` must be finite"):
        simulate_equivalent(JOINT, polynomial, np.array([0.0, np.nan]), 100.0)
    with pytest.raises(ConfigError, match='"corrected" or "printed"'):
        square_wave(1.0, 0.0, "wrong")
