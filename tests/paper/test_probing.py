"""Kernels of any order against brute-force harmonic probing with truncated polynomials."""

from math import factorial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jbw.errors import ConfigError
from jbw.paper.polynomial import (
    PolynomialOscillator,
    kernel_1,
    kernel_2,
    kernel_3,
    nonlinear_force,
)
from jbw.paper.probing import cross_kernel, kernel, leading_diagonals

SYSTEM = PolynomialOscillator(damping=0.21, stiffness=1.7, rho=0.9, lambda_3=-0.6)
OMEGA = (0.31, -0.83, 1.27, 0.53, 2.11)


def receptance(system, omega):
    return 1 / (system.stiffness - omega**2 + 1j * system.damping * omega)


def product(a, b, limit):
    """Product of two polynomials {powers: coefficient}, without terms above `limit`."""
    total = {}
    for powers_a, x in a.items():
        for powers_b, y in b.items():
            powers = tuple(i + j for i, j in zip(powers_a, powers_b, strict=True))
            if all(i <= top for i, top in zip(powers, limit, strict=True)):
                total[powers] = total.get(powers, 0) + x * y
    return total


def probe(system, omega, limit, signs=None):
    """Response to sum_i X_i exp(j w_i t), as a polynomial in the X_i, by fixed-point iteration."""
    unit = np.eye(len(omega), dtype=int)
    signs = signs or [1] * len(omega)
    u = {tuple(row): sign for row, sign in zip(unit.tolist(), signs, strict=True)}
    y = {}
    for _ in range(sum(limit)):
        square = product(y, y, limit)
        cube = product(square, y, limit)
        force = dict(u)
        for powers, value in square.items():
            force[powers] = force.get(powers, 0) - system.rho * value
        for powers, value in cube.items():
            force[powers] = force.get(powers, 0) - system.lambda_3 * value
        y = {n: x * receptance(system, float(np.dot(n, omega))) for n, x in force.items()}
    return y


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
def test_kernel_is_the_probed_coefficient(order):
    omega, ones = OMEGA[:order], (1,) * order
    probed = probe(SYSTEM, omega, ones)[ones] / factorial(order)
    # Some sixty products and sums of double precision.
    np.testing.assert_allclose(kernel(SYSTEM, *omega), probed, rtol=1e-13)


def test_kernel_agrees_with_the_formulas_written_out():
    np.testing.assert_allclose(kernel(SYSTEM, OMEGA[0]), kernel_1(SYSTEM, OMEGA[0]), rtol=1e-14)
    np.testing.assert_allclose(kernel(SYSTEM, *OMEGA[:2]), kernel_2(SYSTEM, *OMEGA[:2]), rtol=1e-13)
    np.testing.assert_allclose(kernel(SYSTEM, *OMEGA[:3]), kernel_3(SYSTEM, *OMEGA[:3]), rtol=1e-13)


def test_kernel_is_symmetric_and_broadcasts():
    rows = np.array([OMEGA[:3], OMEGA[1:4]])
    np.testing.assert_allclose(
        jax.jit(kernel)(SYSTEM, *rows.T), kernel(SYSTEM, *rows[:, ::-1].T), rtol=1e-13
    )


def test_leading_diagonals_are_the_probed_powers():
    omega = 0.37
    probed = probe(SYSTEM, (omega,), (5,))
    expected = [probed[(order,)] for order in range(1, 6)]
    np.testing.assert_allclose(leading_diagonals(SYSTEM, omega), expected, rtol=1e-13)


def test_fourth_and_fifth_diagonals_in_closed_form():
    omega = np.linspace(0.1, 2.0, 7)
    h = [None, *leading_diagonals(SYSTEM, omega)]
    rho, lambda_3 = SYSTEM.rho, SYSTEM.lambda_3
    fourth = rho * (2 * h[1] * h[3] + h[2] ** 2) + 3 * lambda_3 * h[1] ** 2 * h[2]
    fifth = rho * (2 * h[1] * h[4] + 2 * h[2] * h[3])
    fifth = fifth + lambda_3 * (3 * h[1] ** 2 * h[3] + 3 * h[1] * h[2] ** 2)
    np.testing.assert_allclose(h[4], -receptance(SYSTEM, 4 * omega) * fourth, rtol=1e-13)
    np.testing.assert_allclose(h[5], -receptance(SYSTEM, 5 * omega) * fifth, rtol=1e-13)


def test_fifth_kernels_of_the_cubic_oscillator():
    cubic = PolynomialOscillator(SYSTEM.damping, SYSTEM.stiffness, 0.0, SYSTEM.lambda_3)
    w = np.linspace(0.1, 2.0, 7)
    one, three, five = (receptance(cubic, n * w) for n in (1, 3, 5))
    square = cubic.lambda_3**2
    back = np.conj(one)
    np.testing.assert_allclose(
        leading_diagonals(cubic, w)[4], 3 * square * one**5 * three * five, rtol=1e-13
    )
    np.testing.assert_allclose(
        kernel(cubic, w, w, w, w, -w),
        0.3 * square * three * (4 * three + 6 * one) * one**4 * back,
        rtol=1e-13,
    )
    np.testing.assert_allclose(
        kernel(cubic, w, w, w, -w, -w),
        0.3 * square * one**4 * back**2 * (6 * one + 3 * back + three),
        rtol=1e-13,
    )


def test_golden_diagonals_of_the_cubic_oscillator(golden):
    for case in golden["cubic_equivalent_steady"]["cases"]:
        omega_0, w = case["omega0"], case["w"]
        system = PolynomialOscillator(2 * case["zeta"] * omega_0, omega_0**2, 0.0, case["lambda3"])
        diagonals = leading_diagonals(system, w)
        found = [
            diagonals[2],
            kernel(system, w, w, -w),
            diagonals[4],
            kernel(system, w, w, w, w, -w),
        ]
        names = ["H3_diag", "H3_wwmw", "H5_diag", "H5_wwwwmw"]
        expected = [complex(*case[name]) for name in names]
        np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize("inputs", [(1, 1, 1), (0, 1, 1), (1, 0, 0), (0, 0, 0)])
def test_cross_kernels_carry_the_sign_of_u0(inputs):
    ones, omega = (1, 1, 1), OMEGA[:3]
    signs = [1 if number else -1 for number in inputs]
    probed = probe(SYSTEM, omega, ones, signs)[ones] / factorial(3)
    np.testing.assert_allclose(cross_kernel(SYSTEM, omega, inputs), probed, rtol=1e-13)


def test_nonlinear_force_collects_one_order():
    # (1 + x)-type check: y = sum_i x^i has y^2 = sum (n - 1) x^n, y^3 = sum C(n - 1, 2) x^n.
    system = PolynomialOscillator(0.0, 1.0, 10.0, 100.0)
    forces = [float(nonlinear_force(system, [jnp.ones(())] * (n - 1))) for n in (2, 3, 4, 5)]
    assert forces == [10.0, 120.0, 330.0, 640.0]


def test_bad_arguments_are_refused():
    with pytest.raises(ConfigError, match="at least one frequency"):
        kernel(SYSTEM)
    with pytest.raises(ConfigError, match="`inputs` must name"):
        cross_kernel(SYSTEM, OMEGA[:2], (1, 2))
    with pytest.raises(ConfigError, match="each of the 2 frequencies"):
        cross_kernel(SYSTEM, OMEGA[:2], (1,))
