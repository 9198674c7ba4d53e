"""Powers by which laws lose stiffness, and their derivatives, by their formulas."""

import math

import jax
import numpy as np
import pytest

from jbw.oscillator.laws.powers import power

POINTS = [(1e-9, 0.7), (0.3, 0.05), (1.0, 2.5), (4.2, 1.7)]


@pytest.mark.parametrize(("x", "q"), POINTS)
def test_a_power_and_its_derivatives_are_their_formulas(x, q):
    value, log = math.pow(x, q), math.log(x)
    assert float(power(x, q)) == pytest.approx(value, rel=1e-15)
    np.testing.assert_allclose(
        jax.grad(power, (0, 1))(x, q), [q * value / x, value * log], rtol=1e-14
    )
    # Forward over reverse: the second derivative by x, and the mixed one.
    second = jax.jacfwd(jax.grad(power), (0, 1))(x, q)
    expected = [q * (q - 1.0) * value / x**2, (1.0 + q * log) * value / x]
    np.testing.assert_allclose(second, expected, rtol=1e-13)


def test_at_zero_a_power_and_its_derivatives_are_zero():
    assert float(power(0.0, 0.7)) == 0.0
    np.testing.assert_array_equal(jax.grad(power, (0, 1))(0.0, 0.7), [0.0, 0.0])
    np.testing.assert_array_equal(jax.jvp(power, (0.0, 0.7), (1.0, 1.0))[1], 0.0)
    # A rest that rounding has left on the other side of zero.
    np.testing.assert_array_equal(power(-1e-30, 0.7), 0.0)
    np.testing.assert_array_equal(jax.grad(power)(-1e-30, 0.7), 0.0)
