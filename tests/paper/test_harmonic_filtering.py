"""Harmonic filtering and kernel estimation against closed forms and the measurement's own route."""

import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jbw.errors import ConfigError, DataError
from jbw.measurement.probing import third_order_kernel
from jbw.paper.kernels import estimated_kernel, harmonic_amplitudes, harmonic_response

FS, OMEGA = 512.0, 2 * np.pi * 6.3
T = np.arange(1700) / FS


def test_amplitudes_of_a_sum_of_harmonics_are_found():
    expected = np.array([2e-3 - 1e-3j, 3e-4j, -1e-4 + 5e-5j, 0.0])
    x = 7e-4 + np.real(np.exp(1j * OMEGA * np.outer(T, np.arange(1, 5))) @ expected)
    found = harmonic_amplitudes(np.stack([x, 2 * x]), FS, OMEGA, 4)
    # A fit of 1,700 values that the harmonics make exactly: rounding of the normal equations.
    np.testing.assert_allclose(found, np.stack([expected, 2 * expected]), rtol=0, atol=1e-15)


def test_the_filter_is_that_of_the_measurement():
    x = np.cos(OMEGA * T) + 0.1 * np.cos(3 * OMEGA * T + 0.4)
    u = 2.0 * np.cos(OMEGA * T - 0.3)
    theirs = third_order_kernel(u, x, FS, OMEGA, num_harmonics=5)
    amplitude = harmonic_amplitudes(u, FS, OMEGA, 5)[0]
    y_3 = harmonic_amplitudes(x, FS, OMEGA, 5)[2]
    # Without noise both are exact: rounding of the normal equations.
    np.testing.assert_allclose(estimated_kernel(y_3, amplitude), theirs.h3[0], rtol=1e-11)


def test_estimation_inverts_the_response():
    h_1, h_3, amplitude = 7e-5 - 2e-7j, 3e-8 - 3e-9j, 10.0 * np.exp(0.6j)
    y_1, y_3 = harmonic_response(h_1, h_3, amplitude)
    np.testing.assert_allclose(y_1, amplitude * h_1, rtol=1e-15)
    # By hand: cos^3 has a quarter of its amplitude at three times the frequency.
    np.testing.assert_allclose(y_3, 1000.0 * np.exp(1.8j) / 4 * h_3, rtol=1e-14)
    np.testing.assert_allclose(estimated_kernel(y_3, amplitude), h_3, rtol=1e-14)


def test_filter_is_differentiable_in_record_and_frequency():
    x = jnp.cos(OMEGA * T[:200]) + 0.2 * jnp.sin(2 * OMEGA * T[:200])
    check_grads(lambda x, w: jnp.abs(harmonic_amplitudes(x, FS, w, 2)), (x, OMEGA), 1, eps=1e-5)


def test_what_cannot_be_filtered_is_refused():
    with pytest.raises(ConfigError, match="`num_harmonics` must be 1"):
        harmonic_amplitudes(T, FS, OMEGA, 0)
    with pytest.raises(ConfigError, match=r"Harmonic 41 of 6\.3 Hz must lie below the Nyquist"):
        harmonic_amplitudes(T, FS, OMEGA, 41)
    with pytest.raises(DataError, match="needs 7 samples, but the record has 6"):
        harmonic_amplitudes(T[:6], FS, OMEGA, 3)
    with pytest.raises(DataError, match="amplitude must not be zero"):
        estimated_kernel(1e-6, 0.0)
