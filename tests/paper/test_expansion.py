"""Kernels to order 7 against an exact expansion: substitution in rational complex numbers."""

from fractions import Fraction
from itertools import combinations
from math import factorial

import numpy as np
import pytest

from jbw.paper.kernel_responses import repeated_kernel
from jbw.paper.polynomial import PolynomialOscillator
from jbw.paper.probing import kernel, leading_diagonals

DAMPING, STIFFNESS, RHO, LAMBDA_3 = (Fraction(x, 10) for x in (3, 17, 9, -6))
SYSTEM = PolynomialOscillator(*map(float, (DAMPING, STIFFNESS, RHO, LAMBDA_3)))
OMEGA = [Fraction(x, 8) for x in (3, -7, 10, 4, 17, -2, 5)]


class Rational:
    """A complex number of two fractions."""

    def __init__(self, real, imag=0):
        self.real, self.imag = Fraction(real), Fraction(imag)

    def __add__(self, other):
        return Rational(self.real + other.real, self.imag + other.imag)

    def __mul__(self, other):
        real = self.real * other.real - self.imag * other.imag
        return Rational(real, self.real * other.imag + self.imag * other.real)

    def inverse(self):
        size = self.real**2 + self.imag**2
        return Rational(self.real / size, -self.imag / size)

    def __complex__(self):
        return complex(float(self.real), float(self.imag))


def product(one, other):
    """Product of polynomials {set of symbols: coefficient} that are linear in every symbol."""
    total = {}
    for left, x in one.items():
        for right, y in other.items():
            if not left & right:
                total[left | right] = total.get(left | right, Rational(0)) + x * y
    return total


def expanded(omega):
    """y of y'' + d y' + k y + rho y^2 + lambda_3 y^3 = sum_i X_i exp(j w_i t), linear in each X_i.

    Each pass of the fixed-point iteration makes one more order exact.
    """
    symbols = range(len(omega))
    drive = {frozenset([i]): Rational(1) for i in symbols}
    subsets = [frozenset(s) for n in symbols for s in combinations(symbols, n + 1)]
    frequency = {subset: sum(omega[i] for i in subset) for subset in subsets}
    receptance = {
        subset: Rational(STIFFNESS - w**2, DAMPING * w).inverse() for subset, w in frequency.items()
    }
    y = {}
    for _ in symbols:
        force, square = dict(drive), product(y, y)
        for parts, factor in ((square, -RHO), (product(square, y), -LAMBDA_3)):
            for subset, value in parts.items():
                force[subset] = force.get(subset, Rational(0)) + value * Rational(factor)
        y = {subset: value * receptance[subset] for subset, value in force.items()}
    return y


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5, 6, 7])
def test_kernel_is_the_exact_expansion(order):
    omega = OMEGA[:order]
    exact = complex(expanded(omega)[frozenset(range(order))]) / factorial(order)
    # Some thousand products of double precision at order 7.
    np.testing.assert_allclose(kernel(SYSTEM, *map(float, omega)), exact, rtol=1e-12)


def test_repeated_frequencies_and_diagonals_are_the_exact_expansion():
    w, v = OMEGA[0], OMEGA[2]
    repeated = [w, w, -w, v, -v]
    exact = complex(expanded(repeated)[frozenset(range(5))]) / factorial(5)
    found = repeated_kernel(SYSTEM, np.array([float(w), float(v)]), (2, 1, 1, 1))
    np.testing.assert_allclose(found, exact, rtol=1e-12)
    diagonals = leading_diagonals(SYSTEM, float(w), 7)
    for order in (3, 5, 7):
        exact = complex(expanded([w] * order)[frozenset(range(order))]) / factorial(order)
        np.testing.assert_allclose(diagonals[order - 1], exact, rtol=1e-12)
