"""Forced response of an identified joint: response curves, base motion, random vibration, shock.

Functions take many draws of a joint at once: `equivalent_motion(joint)` of an oscillator whose
leaves have the shape (draw,), and force amplitudes per unit modal mass of the shape (draw, level).

Examples:
    The resonance moves from 118.1 to 117.3 rad/s as the force grows from 0.01 to 0.5 N/kg:

    >>> import jbw; jbw.enable_x64()
    >>> import numpy as np
    >>> joint = jbw.BoucWen(omega_n=118.12, zeta=0.00444, alpha=497.4, delta=340.2, gamma=32.8)
    >>> motion = jbw.forced.equivalent_motion(joint)
    >>> found = jbw.forced.resonance(motion, np.array([[0.01, 0.5]]))  # (draw, level)
    >>> print(found.peak.omega.round(1), "rad/s,", (1e3 * found.peak.y).round(2), "mm")
    [[118.1 117.3]] rad/s, [[0.08 3.38]] mm
"""

from jbw.forced.curves import ForcedCurve, Peaks, Resonance, exact_points, peaks, resonance
from jbw.forced.equivalent import EquivalentMotion, equivalent_motion
from jbw.forced.random import RandomResponse, random_response
from jbw.forced.shock import ShockResponse, classical_pulse, pulse_of, shock_response
from jbw.forced.sine_on_random import SineOnRandom, sine_on_random
from jbw.forced.sweeps import base_gain, held_ratio, level_that_holds, swept, whole_curve

__all__ = [
    "EquivalentMotion",
    "ForcedCurve",
    "Peaks",
    "RandomResponse",
    "Resonance",
    "ShockResponse",
    "SineOnRandom",
    "base_gain",
    "classical_pulse",
    "equivalent_motion",
    "exact_points",
    "held_ratio",
    "level_that_holds",
    "peaks",
    "pulse_of",
    "random_response",
    "resonance",
    "shock_response",
    "sine_on_random",
    "swept",
    "whole_curve",
]
