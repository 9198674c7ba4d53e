"""Laws from a millionth of their slip displacement to a hundred times it, against mpmath.

The references are integrals of 40 digits and more of the laws' own equations. Bouc-Wen's law of the
exponents 1/2, 1 and 2 takes elementary functions along a stretch w, from its limit L on by the
e-folds q of w = L (1 - exp(-q)): a hundred slip displacements are some 200 e-folds.
"""

import functools

import mpmath as mp
import numpy as np
import pytest
from known_laws import compiled
from stretched import way

from jbw.oscillator.laws.bouc_wen_nu import BoucWenNu

MULTIPLES = (1e-6, 1e-3, 0.1, 1.0, 3.0, 7.0, 10.0, 30.0, 100.0)
ALPHA, MM = 1e4, mp.mpf("1e-3")


def moment(c, w, nu):
    """The integral of t / (1 - c t^nu) from 0 to w."""
    if nu == 1:
        return -w / c - mp.log(1 - c * w) / c**2
    if nu == 2:
        return -mp.log(1 - c * w**2) / (2 * c)
    r = mp.sqrt(w)
    return -2 * (r**3 / (3 * c) + r**2 / (2 * c**2) + r / c**3 + mp.log(1 - c * r) / c**4)


@functools.cache
def reference(d, g, nu, multiple):
    """Slip displacement [m], stretch of the tip [m], stiffness and damping over alpha."""
    with mp.workdps(250 if multiple > 20 else 60):
        nu, slip = mp.mpf(nu), MM * mp.mpf(d + g) ** (-1 / mp.mpf(nu))
        less, more = (mp.mpf(c) / MM**nu for c in (d - g, d + g))
        peak, limit = slip * mp.mpf(multiple), more ** (-1 / nu)

        def stretch(q):
            return limit * (1 - mp.exp(-q))

        low, high = mp.mpf(0), 4 * peak / limit * max(nu, 1)
        for _ in range(int(3.4 * mp.mp.dps) + 10):  # a digit is 3.3 halvings
            q = (low + high) / 2
            above = way(less, stretch(q), nu) + way(more, stretch(q), nu) > 2 * peak
            low, high = (low, q) if above else (q, high)
        zero = peak - way(less, stretch(q), nu)
        reach = min(q, mp.mpf(100))  # beyond, nothing is left of exp(-q)

        def height(t):
            at = reach * mp.sin(t)
            both = (zero + way(less, stretch(at), nu), zero - way(more, stretch(at), nu))
            roots = sum(mp.sqrt(max(1 - (y / peak) ** 2, 0)) for y in both)
            return roots * limit * mp.exp(-at) * reach * mp.cos(t)

        edges = [0, *(mp.asin(min(1, x / reach)) for x in (0.1, 1, 4, 16, 50) if x < reach)]
        with mp.workdps(40):
            real = 2 / (mp.pi * peak) * mp.quad(height, [*edges, mp.pi / 2])
        lost = moment(more, stretch(q), nu) - moment(less, stretch(q), nu)
        imaginary = 2 / (mp.pi * peak**2) * lost
        return float(slip), float(stretch(q)), float(real), float(imaginary)


@compiled
def tip_and_loop(law, y_peak):
    return law.at_tip(y_peak), law.loop(y_peak)


@pytest.mark.parametrize("multiple", MULTIPLES)
@pytest.mark.parametrize("nu", [0.5, 1.0, 2.0])
@pytest.mark.parametrize(("d", "g"), [(0.4, 0.3), (0.1, 0.6), (0.5, 0.02)])
def test_the_loop_of_a_free_exponent_is_that_of_mpmath(d, g, nu, multiple):
    slip, stretch, stiffness, damping = reference(d, g, nu, multiple)
    law, y_peak = BoucWenNu(ALPHA, d, g, nu), slip * multiple
    tip, loop = tip_and_loop(law, y_peak)
    # Rounding: sums of a hundred terms, and a loop's root of a difference.
    np.testing.assert_allclose(tip, stretch, rtol=1e-12)
    np.testing.assert_allclose(loop.stiffness, ALPHA * stiffness, rtol=1e-11)
    np.testing.assert_allclose(loop.damping, ALPHA * damping, rtol=1e-11)
