"""Responses to tones against integration of the polynomial system and harmonic balance."""

from itertools import permutations
from math import comb

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import root

from jbw.errors import ConfigError, ModelError
from jbw.paper.kernel_responses import (
    Lines,
    merge_lines,
    multinomial,
    repeated_kernel,
    synthesize,
    tone_response,
    tone_terms,
    tones,
)
from jbw.paper.kernels import h1
from jbw.paper.polynomial import PolynomialOscillator, kernel_2, kernel_3
from jbw.paper.probing import kernel

SYSTEM = PolynomialOscillator(damping=0.25, stiffness=1.0, rho=0.4, lambda_3=-0.3)
BASE = 0.05
TONES = np.array([0.25, 0.40, 0.65])
PHASORS = np.array([1.0, np.exp(0.7j), 0.6 * np.exp(-1.1j)])


def line(lines, *combination):
    (place,) = np.flatnonzero((np.asarray(lines.combination) == combination).all(axis=1))
    return complex(lines.amplitude[place])


def integrated(system, omega, amplitude, t, start):
    """Steady state of the polynomial system over its common period, by DOP853."""

    def rate(time, state):
        y, v = state
        u = np.sum(amplitude * np.exp(1j * omega * time)).real
        spring = system.stiffness * y + system.rho * y**2 + system.lambda_3 * y**3
        return [v, u - system.damping * v - spring]

    # Two periods of 126 s at damping / 2 = 0.125: what the start lacks dies by exp(-31).
    settle = 2 * 2 * np.pi / BASE
    span = (0.0, settle + t[-1])
    options = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-16}
    return solve_ivp(rate, span, start, t_eval=settle + t, **options).y[0]


@pytest.mark.parametrize(("num_tones", "rho"), [(1, 0.4), (2, 0.4), (3, 0.4), (3, 0.0)])
def test_error_against_integration_falls_with_the_next_order(num_tones, rho):
    system = PolynomialOscillator(SYSTEM.damping, SYSTEM.stiffness, rho, SYSTEM.lambda_3)
    omega, phasors = TONES[:num_tones], PHASORS[:num_tones]
    t = np.linspace(0.0, 2 * np.pi / BASE, 64, endpoint=False)
    errors = []
    for amplitude in (0.02, 0.01):
        lines = tone_response(system, omega, amplitude * phasors)
        y = np.asarray(synthesize(lines, t))
        start = [y[0], float(jnp.sum((1j * lines.omega * lines.amplitude).real))]
        errors.append(np.max(np.abs(integrated(system, omega, amplitude * phasors, t, start) - y)))
    # What is left out is of order 4, of order 5 without rho; at these amplitudes the order after
    # that still bends the slope by a few per cent.
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4 if rho else 5, abs=0.15)


def test_terms_carry_their_multinomial_weights():
    terms = tone_terms(SYSTEM, TONES, PHASORS, 3)
    assert len(terms.weight) == comb(8, 3)
    # All weights of an order sum to (number of slots)^order.
    assert np.sum(terms.weight) == 6**3
    row = np.flatnonzero((np.asarray(terms.exponents) == [1, 1, 1, 0, 0, 0]).all(axis=1))
    assert terms.weight[row] == 6
    np.testing.assert_array_equal(np.asarray(terms.combination)[row], [[0, 1, 0]])
    a, b = TONES[:2]
    expected = 6 / 8 * abs(PHASORS[0]) ** 2 * PHASORS[1] * kernel_3(SYSTEM, a, -a, b)
    np.testing.assert_allclose(np.asarray(terms.coefficient)[row], [expected], rtol=1e-13)


def test_known_lines_of_two_tones():
    (a, b), (x, y) = TONES[:2], PHASORS[:2]
    lines = tone_response(SYSTEM, TONES[:2], PHASORS[:2])
    mean = kernel_2(SYSTEM, a, -a) * abs(x) ** 2 / 2 + kernel_2(SYSTEM, b, -b) * abs(y) ** 2 / 2
    expected = {
        (0, 0): mean,
        (2, 0): kernel_2(SYSTEM, a, a) * x**2 / 2,
        (1, 1): kernel_2(SYSTEM, a, b) * x * y,
        (1, -1): kernel_2(SYSTEM, a, -b) * x * np.conj(y),
        (3, 0): kernel_3(SYSTEM, a, a, a) * x**3 / 4,
        (2, -1): kernel_3(SYSTEM, a, a, -b) * x**2 * np.conj(y) * 3 / 4,
        (1, 2): kernel_3(SYSTEM, a, b, b) * x * y**2 * 3 / 4,
    }
    for combination, amplitude in expected.items():
        assert line(lines, *combination) == pytest.approx(complex(amplitude), rel=1e-13)
    # |N| + |M| <= 3 leaves 25 combinations, of which the mean and half of the rest are kept.
    assert len(lines.omega) == 13
    assert len(tone_response(SYSTEM, TONES, PHASORS).omega) == 32


def test_truncation_of_the_cubic_oscillator(golden):
    for case in golden["cubic_equivalent_steady"]["cases"]:
        omega_0, zeta, w, amplitude = case["omega0"], case["zeta"], case["w"], case["A"]
        lambda_3 = case["lambda3"]
        system = PolynomialOscillator(2 * zeta * omega_0, omega_0**2, 0.0, lambda_3)
        third = tone_response(system, np.array([w]), np.array([amplitude]), max_order=3)
        fifth = tone_response(system, np.array([w]), np.array([amplitude]), max_order=5)
        one, three = h1(w, omega_0, zeta), h1(3 * w, omega_0, zeta)
        leading = amplitude**3 / 4 * complex(*case["H3_diag"])
        # The golden ratio 4 Y(3w) / (A^3 H3) to first order, as the formula of the truncation.
        bracket = 1.5 * three + 2.25 * one
        ratio = 1 - lambda_3 * amplitude**2 * abs(one) ** 2 * bracket
        np.testing.assert_allclose(line(third, 3), leading, rtol=1e-12)
        true_ratio = complex(*case["Y3"]) / line(third, 3)
        np.testing.assert_allclose(true_ratio, complex(*case["Y3_over_leading"]), rtol=1e-10)
        np.testing.assert_allclose(line(fifth, 3) / leading, ratio, rtol=1e-12)
        np.testing.assert_allclose(ratio, complex(*case["Y3_ratio_first_order"]), rtol=1e-11)
        fundamental = amplitude * one
        fundamental += 0.75 * amplitude**3 * complex(*case["H3_wwmw"])
        fundamental += 0.625 * amplitude**5 * kernel(system, w, w, w, -w, -w)
        np.testing.assert_allclose(line(fifth, 1), fundamental, rtol=1e-12)


def periodic_harmonics(case):
    """Harmonics of the cubic oscillator's steady state by shooting over one period.

    In units of time 1 / w and displacement |Y1|, so that one tolerance serves y and v.
    """
    omega_0, w = case["omega0"], case["w"]
    size = abs(complex(*case["Y1"]))
    damping, stiffness = 2 * case["zeta"] * omega_0 / w, (omega_0 / w) ** 2
    cubic, drive = case["lambda3"] * (size / w) ** 2, case["A"] / (w**2 * size)
    instants = 2 * np.pi * np.arange(33) / 32

    def rate(t, state):
        y, v = state
        return [v, drive * np.cos(t) - damping * v - stiffness * y - cubic * y**3]

    def period(start):
        options = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-13}
        return solve_ivp(rate, (0, 2 * np.pi), start, t_eval=instants, **options).y

    start = root(lambda start: period(start)[:, -1] - start, [1.0, 0.0], tol=1e-13).x
    return np.fft.rfft(period(start)[0, :-1]) / 16 * size


def test_golden_solution_of_the_cubic_oscillator_by_shooting(golden):
    for case in golden["cubic_equivalent_steady"]["cases"]:
        found = periodic_harmonics(case)[[1, 3, 5]]
        expected = np.array([complex(*case[name]) for name in ("Y1", "Y3", "Y5")])
        # Shooting divides the integrator's 1e-12 by how little one period damps, 0.1.
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * abs(expected[0]))


def test_series_meets_the_full_solution_of_the_cubic_oscillator(golden):
    for case in golden["cubic_equivalent_steady"]["cases"]:
        omega_0, zeta, w, amplitude = case["omega0"], case["zeta"], case["w"], case["A"]
        system = PolynomialOscillator(2 * zeta * omega_0, omega_0**2, 0.0, case["lambda3"])
        one, three = (complex(h1(n * w, omega_0, zeta)) for n in (1, 3))
        # The series goes in powers of these: the mean stiffness each line sees, over its own.
        stiffness = abs(case["lambda3"]) * amplitude**2 * abs(one) ** 2
        small = stiffness * max(1.5 * abs(three), 2.25 * abs(one))
        if small > 0.2:
            continue
        fifth = tone_response(system, np.array([w]), np.array([amplitude]), max_order=5)
        assert abs(line(fifth, 1) / complex(*case["Y1"]) - 1) < small**2
        assert abs(line(fifth, 3) / complex(*case["Y3"]) - 1) < 3 * small**2
        assert abs(line(fifth, 5) / complex(*case["Y5"]) - 1) < 3 * small


def test_tones_at_one_and_three_times_a_frequency_merge():
    omega, amplitude = np.array([0.3, 0.9]), np.array([0.2, 0.1 * np.exp(0.4j)])
    lines = tone_response(SYSTEM, omega, amplitude)
    merged = merge_lines(lines)
    # Eight times 0.3 takes four factors: 3 * 0.9 - 0.3.
    multiples = np.array([0, 1, 2, 3, 4, 5, 6, 7, 9])
    np.testing.assert_allclose(merged.omega, 0.3 * multiples, atol=1e-12)
    third = kernel_3(SYSTEM, 0.3, 0.3, 0.3) * 0.2**3 / 4 + line(lines, 0, 1)
    np.testing.assert_allclose(merged.amplitude[3], third, rtol=1e-12)
    np.testing.assert_array_equal(np.asarray(merged.combination)[3], [0, 1])
    t = np.linspace(0.0, 30.0, 101)
    np.testing.assert_allclose(synthesize(merged, t), synthesize(lines, t), rtol=0, atol=1e-15)


def test_lines_on_zero_frequency_merge_into_a_real_mean():
    lines = Lines(np.array([[0, 0], [2, -1]]), jnp.array([0.0, 0.0]), jnp.array([1.0 + 0j, 2 + 3j]))
    merged = merge_lines(Lines(lines.combination, lines.omega, lines.amplitude))
    np.testing.assert_array_equal(merged.amplitude, [3.0 + 0j])


def test_response_is_jittable_and_differentiable():
    respond = jax.jit(tone_response, static_argnames="max_order")
    np.testing.assert_allclose(
        respond(SYSTEM, TONES, PHASORS).amplitude,
        tone_response(SYSTEM, TONES, PHASORS).amplitude,
        rtol=1e-13,
    )

    # Reference: the mean is linear in rho at second order.
    def mean(rho):
        system = PolynomialOscillator(SYSTEM.damping, SYSTEM.stiffness, rho, SYSTEM.lambda_3)
        return tone_response(system, TONES, PHASORS).amplitude[0].real

    assert float(jax.grad(mean)(0.4)) == pytest.approx(float(mean(0.4)) / 0.4, rel=1e-12)


def test_input_of_three_tones_is_their_sum():
    t = np.linspace(0.0, 20.0, 31)
    by_hand = np.cos(0.25 * t) + np.cos(0.4 * t + 0.7) + 0.6 * np.cos(0.65 * t - 1.1)
    np.testing.assert_allclose(tones(TONES, PHASORS, t), by_hand, rtol=0, atol=1e-14)


def test_multinomial_counts_the_ways_to_order_factors():
    powers = (2, 1, 0, 1, 1, 0)
    ways = set(permutations("aabcd"))
    assert multinomial(powers) == len(ways) == 60


def test_kernel_at_repeated_frequencies():
    a, b, c = TONES
    found = repeated_kernel(SYSTEM, TONES, (2, 1, 0, 1, 1, 0))
    np.testing.assert_allclose(found, kernel(SYSTEM, a, a, -a, -b, c), rtol=1e-13)


def test_a_tone_on_a_pole_is_refused():
    undamped = PolynomialOscillator(0.0, 4.0, 0.3, -0.5)
    with pytest.raises(ModelError, match="infinite at omega = 2 rad/s"):
        kernel_2(undamped, 0.7, 1.3)
    with pytest.raises(ModelError, match="infinite at omega = 2 rad/s"):
        tone_response(undamped, np.array([0.7, 1.3]), np.array([0.1, 0.1]))
    with pytest.raises(ModelError, match="infinite at omega = 2 rad/s"):
        h1(2.0, 2.0, 0.0)


def test_bad_tones_are_refused():
    with pytest.raises(ConfigError, match="one value for each tone"):
        tone_response(SYSTEM, TONES, PHASORS[:2])
    with pytest.raises(ConfigError, match="`max_order` must be 1"):
        tone_response(SYSTEM, TONES, PHASORS, max_order=0)
    with pytest.raises(ConfigError, match="`powers` must contain two numbers for each of the 3"):
        repeated_kernel(SYSTEM, TONES, (1, 2))
    with pytest.raises(ConfigError, match="`powers` must be 0 or more"):
        multinomial((2, -1))
    with pytest.raises(ConfigError, match="`order` must be 1"):
        tone_terms(SYSTEM, TONES, PHASORS, 0)
