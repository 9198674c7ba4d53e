"""Harmonics along sweeps of known polynomials, and of a Duffing oscillator SciPy integrates."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jbw.errors import ConfigError, DataError
from jbw.measurement.nonlinearity import largest_share, swept_harmonics

FS, SPAN = 1024.0, 20.0
T = np.arange(int(FS * SPAN)) / FS


def linear(t):
    return 2 * np.pi * (10 * t + 20 / SPAN * t**2 / 2)  # 10 to 30 Hz


def exponential(t):
    rate = SPAN / np.log(3)
    return 2 * np.pi * 10 * rate * (np.exp(t / rate) - 1)


@pytest.mark.parametrize("phase", [linear, exponential, lambda t: -linear(SPAN - t)])
def test_harmonics_of_a_polynomial_are_those_of_trigonometry(phase):
    a, b, c, size = 2.0, 0.3, 0.5, 1.5
    u = size * np.cos(phase(T))
    found = swept_harmonics(u, a * u + b * u**2 + c * u**3, FS)
    inner = slice(2, -2)  # the phase of the analytic signal is off at both ends
    exact = [a * size + 0.75 * c * size**3, b * size**2 / 2, c * size**3 / 4]
    for order, value in enumerate(exact):
        # The source's phase by a Hilbert transform errs by a few thousandths of a radian.
        np.testing.assert_allclose(found.response[order, inner], value, rtol=0.015)
    assert np.all(np.abs(found.response[3:, inner]) < 0.01 * exact[0])
    hz = np.gradient(phase(T), T) / (2 * np.pi)
    assert found.freq.min() > hz.min() - 0.1
    assert found.freq.max() < hz.max() + 0.1


def test_noise_is_told_by_its_standard_deviation():
    u, noise = np.cos(linear(T)), 0.02
    rng = np.random.default_rng(0)
    rows = [swept_harmonics(u, u + noise * rng.normal(size=len(T)), FS) for _ in range(5)]
    third = np.array([one.response[2, 3:-3] for one in rows])
    seen = np.sqrt(np.mean(np.abs(third) ** 2) / 2)
    told = np.sqrt(np.mean([one.std[3:-3] ** 2 for one in rows]))
    # The parabola within a window spreads the noise of a constant by about three halves.
    assert 0.8 < seen / told < 2.0
    share, error, _ = largest_share(rows[0], 3)
    assert share < 5 * error


def test_third_harmonic_of_a_duffing_oscillator_is_of_first_order_in_its_cubic():
    omega_n, zeta, cubic, force = 2 * np.pi * 20, 0.05, 3e7, 8.0

    def rate(t, state):
        y, v = state
        u = force * np.cos(linear(t))
        return v, u - 2 * zeta * omega_n * v - omega_n**2 * y - cubic * y**3

    y = solve_ivp(rate, (0, T[-1]), (0, 0), "RK45", T, rtol=1e-7, atol=1e-11).y[0]
    found = swept_harmonics(force * np.cos(linear(T)), y, FS, num_orders=5)
    omega = 2 * np.pi * found.freq
    inner = (found.freq > 13) & (found.freq < 28)
    third = 3 * omega
    receptance = 1 / (omega_n**2 - third**2 + 2j * zeta * omega_n * third)
    exact = -cubic / 4 * found.response[0] ** 3 * receptance
    # Y_3 = -k_3 Y_1^3 H(3 omega) / 4, but for the mean stiffness that the cubic adds (a percent)
    # and the sweep's lag within a window of half a second.
    size = np.abs(exact[inner]).max()
    np.testing.assert_allclose(found.response[2, inner], exact[inner], atol=0.05 * size)
    assert np.abs(found.response[1, inner]).max() < 0.02 * size
    share, error, hz = largest_share(found, 3)
    assert share > 10 * error
    assert hz == pytest.approx(found.freq[np.argmax(np.abs(found.response[2]))])


def test_a_distorted_source_is_no_nonlinear_joint():
    u = np.cos(linear(T)) + 0.05 * np.cos(3 * linear(T) + 0.4)
    share, error, _ = largest_share(swept_harmonics(u, 3 * u, FS), 3)
    assert share < 0.002 + 5 * error


def test_what_cannot_be_swept_is_refused():
    with pytest.raises(DataError, match="constant"):
        swept_harmonics(np.zeros(100), np.zeros(100), FS)
    with pytest.raises(DataError, match="windows"):
        swept_harmonics(np.cos(linear(T[:500])), T[:500], FS)
    with pytest.raises(ConfigError, match="num_orders"):
        swept_harmonics(np.cos(linear(T)), T, FS, num_orders=0)


def test_a_source_that_is_no_sweep_is_refused():
    rng = np.random.default_rng(3)
    spectrum = np.zeros(len(T) // 2 + 1, complex)
    spectrum[200:600] = np.exp(2j * np.pi * rng.random(400))  # a random multisine, 10 to 30 Hz
    u = np.fft.irfft(spectrum, len(T))
    with pytest.raises(DataError, match="must be a sweep, but its amplitude varies by"):
        swept_harmonics(u, u + u**3, FS)
