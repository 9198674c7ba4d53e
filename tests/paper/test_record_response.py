"""Response to a record: cascade, multiple convolutions and integration against each other."""

import itertools

import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jbw.errors import ConfigError, DataError
from jbw.paper.kernel_responses import (
    periodic_response,
    synthesize,
    tone_response,
    tone_terms,
    volterra_response,
    volterra_sums,
)
from jbw.paper.polynomial import PolynomialOscillator

SYSTEM = PolynomialOscillator(damping=0.8, stiffness=4.0, rho=0.7, lambda_3=-0.5)


def record(fs, duration=2.0):
    t = np.arange(round(duration * fs) + 1) / fs
    return np.cos(3 * t) * np.exp(-t) + 0.3 * t


def integrated(u, fs, hold, hierarchy):
    """(y, v) of the system, or of its first three orders, sample by sample by DOP853."""

    def full(y, u):
        return u - 4.0 * y - 0.7 * y**2 + 0.5 * y**3

    def orders(y, u):
        drive = [u, -0.7 * y[0] ** 2, -1.4 * y[0] * y[1] + 0.5 * y[0] ** 3]
        return drive - 4.0 * y

    count = 3 if hierarchy else 1
    spring = orders if hierarchy else full
    state, found = np.zeros(2 * count), [np.zeros(2 * count)]
    for start, end in itertools.pairwise(u):
        rise = (end - start) * fs if hold == "first" else 0.0

        def rate(t, state, start=start, rise=rise):
            y, v = state[:count], state[count:]
            return np.concatenate([v, spring(y, start + rise * t) - 0.8 * v])

        options = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-18}
        state = solve_ivp(rate, (0.0, 1 / fs), state, **options).y[:, -1]
        found.append(state)
    return np.array(found).T


@pytest.mark.parametrize("hold", ["first", "zero"])
def test_cascade_matches_the_integrated_orders(hold):
    fs = 20.0
    u = record(fs)
    expected = integrated(u, fs, hold, hierarchy=True)
    errors = []
    for substeps in (1, 2):
        response = volterra_response(SYSTEM, u, fs, hold=hold, substeps=substeps)
        found = np.concatenate([response.y, response.v])
        peaks = np.max(np.abs(expected), axis=1)
        errors.append(np.max(np.abs(found - expected), axis=1) / peaks)
    # The first order is exact: only rounding and the integrator's tolerance remain.
    assert max(errors[0][[0, 3]]) < 1e-11
    higher = [1, 2, 4, 5]
    # omega_0 = 2 at 20 Hz makes m = 63 steps a cycle: the stated (2.5 / m)^4 is 2.5e-6.
    assert np.all(errors[0][[1, 2]] < (2.5 / 63) ** 4)
    np.testing.assert_allclose(np.log2(errors[0] / errors[1])[higher], 4, atol=0.3)


def test_cascade_error_against_the_nonlinear_system_is_of_fourth_order():
    fs, errors = 20.0, []
    for amplitude in (0.04, 0.02):
        u = amplitude * record(fs)
        response = volterra_response(SYSTEM, u, fs, substeps=8)
        expected = integrated(u, fs, "first", hierarchy=False)[0]
        errors.append(np.max(np.abs(np.sum(response.y, axis=0) - expected)))
    # y_4 is the first order left out; y_5 bends the slope by a few per cent.
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4, abs=0.1)


@pytest.mark.slow
def test_cascade_is_the_sum_over_kernels():
    differences = []
    for fs in (8.0, 16.0):
        u = record(fs, duration=1.5)
        cascade = volterra_response(SYSTEM, u, fs, substeps=4).y
        sums = volterra_sums(SYSTEM, u, fs, memory=len(u))
        differences.append((np.asarray(sums) - cascade)[:, :: round(fs / 8.0)])
    peaks = np.max(np.abs(cascade), axis=1)
    coarse, fine = (np.max(np.abs(d), axis=1) / peaks for d in differences)
    # The trapezoid rule halves its step: the difference falls by four ...
    np.testing.assert_allclose(np.log2(coarse / fine), 2, atol=0.1)
    # ... and extrapolates to nothing but the next power of the step.
    rest = np.max(np.abs((4 * differences[1] - differences[0]) / 3), axis=1) / peaks
    assert np.all(rest < 5e-4)


def test_fourth_and_fifth_orders_continue_the_cascade():
    # The sum of n orders of a short record misses the n+1 st: its size falls by the amplitude.
    fs, amplitude = 20.0, 0.05
    u = amplitude * record(fs)
    response = volterra_response(SYSTEM, u, fs, substeps=8, max_order=5)
    expected = integrated(u, fs, "first", hierarchy=False)[0]
    errors = [np.max(np.abs(np.sum(response.y[:n], axis=0) - expected)) for n in (1, 2, 3, 4, 5)]
    assert all(after < 0.1 * before for before, after in itertools.pairwise(errors))


def test_short_memory_keeps_the_recent_past():
    fs = 8.0
    u = record(fs)
    full = volterra_sums(SYSTEM, u, fs, memory=len(u))
    short = volterra_sums(SYSTEM, u, fs, memory=7)
    np.testing.assert_allclose(short[:, :7], full[:, :7], rtol=1e-12, atol=1e-18)
    assert np.max(np.abs(short - full)[:, -1]) > 1e-6


def test_record_of_a_tone_settles_on_its_lines():
    # Far into a tone the record's response is the steady one of the frequency-domain kernels.
    fs, omega, amplitude = 64.0, 2 * np.pi / 4, 0.3
    t = np.arange(64 * 60 + 1) / fs
    u = amplitude * np.cos(omega * t)
    response = volterra_response(SYSTEM, u, fs)
    steady = synthesize(tone_response(SYSTEM, np.array([omega]), np.array([amplitude])), t)
    late = t > 52.0
    # Joining a cosine by lines lowers its tone by (omega / fs)^2 / 12 = 5e-5; the rest has
    # died by exp(-0.4 * 52) = 1e-9.
    error = np.abs(np.sum(response.y, axis=0) - steady)[late]
    assert np.max(error) < 2e-4 * np.max(np.abs(steady))
    expected = 1 - (omega / fs) ** 2 / 12
    first = np.max(np.abs(response.y[0][late])) / np.max(
        np.abs(
            np.asarray(
                synthesize(tone_response(SYSTEM, np.array([omega]), np.array([amplitude]), 1), t)
            )[late]
        )
    )
    assert first == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("size", [24, 25])
def test_periodic_response_is_the_sum_over_tones(size):
    # Three tones with a whole number of periods, and the kernels at them, line by line; of 24
    # samples the last tone is at the Nyquist frequency.
    fs, lines, phasors = 6.0, np.array([1, 4, 12]), np.array([0.3, 0.2j, -0.1])
    omega, t = 2 * np.pi * fs * lines / size, np.arange(size) / fs
    u = np.real(phasors @ np.exp(1j * np.outer(omega, t)))
    response = periodic_response(SYSTEM, u, fs, max_order=3)
    for order, y, v in zip((1, 2, 3), response.y, response.v, strict=True):
        terms = tone_terms(SYSTEM, omega, phasors, order)
        waves = np.asarray(terms.coefficient) * np.exp(1j * np.outer(t, terms.omega))
        # Some hundred terms of double precision.
        expected = np.sum(waves, axis=1).real
        np.testing.assert_allclose(y, expected, atol=1e-13 * np.max(np.abs(expected)))
        rate = np.sum(1j * np.asarray(terms.omega) * waves, axis=1).real
        np.testing.assert_allclose(v, rate, atol=1e-12 * np.max(np.abs(rate)))


def test_error_of_the_periodic_response_falls_with_the_next_order():
    fs, size, errors = 8.0, 64, []
    t = np.arange(size) / fs
    shape = np.cos(2 * np.pi * t / 8) + 0.5 * np.sin(2 * np.pi * 3 * t / 8)

    def motion(amplitude):
        def rate(t, state):
            u = np.cos(2 * np.pi * t / 8) + 0.5 * np.sin(2 * np.pi * 3 * t / 8)
            y, v = state
            return [v, amplitude * u - 0.8 * v - 4.0 * y - 0.7 * y**2 + 0.5 * y**3]

        # Ten periods of 8 s: what the start lacks dies by exp(-0.4 * 80) = 1e-14.
        options = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-15}
        return solve_ivp(rate, (0, 88.0), [0, 0], t_eval=80.0 + t, **options).y[0]

    for amplitude in (0.2, 0.1):
        response = periodic_response(SYSTEM, amplitude * shape, fs)
        errors.append(np.max(np.abs(np.sum(response.y, axis=0) - motion(amplitude))))
    # y_4 is the first order left out; y_5 bends the slope.
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4, abs=0.25)


def test_response_maps_over_records_and_differentiates():
    fs = 20.0
    batch = np.stack([record(fs), 2 * record(fs)])
    y = jax.vmap(lambda u: volterra_response(SYSTEM, u, fs).y)(batch)
    # Homogeneity: order n scales as the n-th power of the input.
    np.testing.assert_allclose(y[1], y[0] * np.array([[2.0], [4.0], [8.0]]), rtol=1e-12)

    def last(lambda_3):
        system = PolynomialOscillator(0.8, 4.0, 0.0, lambda_3)
        return volterra_response(system, record(fs), fs).y[2, -1]

    # Without rho, y_3 is linear in lambda_3.
    assert float(jax.grad(last)(-0.5)) == pytest.approx(float(last(-0.5)) / -0.5, rel=1e-12)


def test_bad_records_and_options_are_refused():
    u = record(12.0)
    with pytest.raises(ConfigError, match="`hold` must be"):
        volterra_response(SYSTEM, u, 12.0, hold="cubic")
    with pytest.raises(ConfigError, match="must be 1 or more"):
        volterra_response(SYSTEM, u, 12.0, substeps=0)
    with pytest.raises(ConfigError, match="`max_order` must be 1 or more"):
        periodic_response(SYSTEM, u, 12.0, max_order=0)
    with pytest.raises(ConfigError, match="`memory`"):
        volterra_sums(SYSTEM, u, 12.0, memory=0)
    with pytest.raises(DataError, match="one record"):
        volterra_response(SYSTEM, np.stack([u, u]), 12.0)
    with pytest.raises(DataError, match=r"`u\[2\]` is nan"):
        volterra_sums(SYSTEM, np.array([0.0, 1.0, np.nan]), 12.0, memory=2)
