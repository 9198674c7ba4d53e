"""Forced response of a known joint: curves by amplitude, base motion, random vibration, shock.

Functions take draws of a joint at once, `equivalent_motion(joint)` of an oscillator whose leaves
have the shape (draw,), and force amplitudes per unit modal mass of the shape (draw, level).
"""

from jbw.forced.curves import ForcedCurve, Peaks, Resonance, exact_points, peaks, resonance
from jbw.forced.equivalent import EquivalentMotion, equivalent_motion
from jbw.forced.random import RandomResponse, random_response
from jbw.forced.shock import ShockResponse, classical_pulse, pulse_of, shock_response
from jbw.forced.sweeps import base_gain, held_ratio, level_that_holds, swept, whole_curve

__all__ = [
    "EquivalentMotion",
    "ForcedCurve",
    "Peaks",
    "RandomResponse",
    "Resonance",
    "ShockResponse",
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
    "swept",
    "whole_curve",
]
