"""Bouc-Wen's steady loop in closed form, and its fundamental by SciPy's quadrature."""

from functools import partial

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq


def describing_function(joint, y_peak):
    """Return the fundamental of Bouc-Wen's steady force along Y cos(theta), over Y, by quadrature.

    With nu = 1 and during unloading by w from Y, dz/dw = -alpha + t z while z > 0, t = delta -
    gamma, and -alpha - s z afterwards, s = delta + gamma; the tip is z(Y) = -z(-Y).
    """
    rises, falls = joint.delta + joint.gamma, joint.delta - joint.gamma

    def to_zero(tip):
        return -np.log1p(-falls * tip / joint.alpha) / falls

    def down(y, tip):
        """Return the force at y during unloading from z = tip at Y."""
        way, zero = y_peak - y, to_zero(tip)
        if way <= zero:
            return tip - (joint.alpha / falls - tip) * np.expm1(falls * way)
        return joint.alpha / rises * np.expm1(-rises * (way - zero))

    most = min(joint.alpha * y_peak, joint.alpha / rises)  # fully stuck, or saturated
    tip = brentq(lambda z: down(-y_peak, z) + z, 0, most, xtol=1e-15 * most)

    def part(wave, theta):
        return 2 / np.pi * down(y_peak * np.cos(theta), tip) * wave(theta)

    kink = np.arccos(1 - to_zero(tip) / y_peak)
    real, imaginary = (
        sum(quad(partial(part, wave), *ends, epsabs=0, epsrel=1e-12)[0]
            for ends in ((0, kink), (kink, np.pi)))
        for wave in (np.cos, np.sin)
    )  # fmt: skip
    # a cos + b sin = Re (a - j b) exp(j theta)
    return complex(real, -imaginary) / y_peak
