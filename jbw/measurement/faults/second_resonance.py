r"""A second mode or a steady line near the resonance of a record of noise or a multisine.

Rational functions of one and of two modes are fitted to the lines about the resonance,

$$Y = \frac{\sum_{k=0}^{2m-2} b_k s^k\,U + \sum_{k=-1}^{2m-1} c_k s^k}
           {s^{2m} + \sum_{k=0}^{2m-1} a_k s^k}, \quad s = j\omega, \quad m = 1, 2,$$

where the constants c represent the states in which the record begins and ends. Each is a linear
least-squares fit that is repeated with weights $1/|D|$ of the last denominator D. A joint leaves a
residual that varies from line to line. Of 85 sound records with strong laws (`benchmarks/outside`)
two modes leave at least 48 % of its sum of squares, of three records with two modes at most 0.04 %.

Reference:
    C. K. Sanathanan, J. Koerner, IEEE Trans. Autom. Control 8 (1963) 56-58.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from jbw.errors import DataError
from jbw.measurement.channels import Complexes, Reals
from jbw.measurement.faults.fault import Fault, doubt
from jbw.measurement.faults.hypothesis import ODDS
from jbw.measurement.faults.plausibility import LOOKED_AT
from jbw.measurement.faults.second_mode import beside
from jbw.measurement.records import Record
from jbw.measurement.resonances import (
    HALF_WIDTHS,
    WIDE,
    driven_band,
    driven_lines,
    read_lines,
    real_coefficients,
)
from jbw.report.messages import decay_faults as messages

ROUNDS = 6  # number of weighted fits
FEWEST = 36  # number of lines, three times that of the parameters of two modes
EXPLAINS = 0.25  # largest fraction of the residual sum of squares that remains with two modes
LEAST = 0.02  # smallest residual that a second mode explains, relative to the response
# A mode whose decay would last this many times the record is a steady line.
STEADY = 3.0


class _Rational(NamedTuple):
    """A rational function fitted to a response, with its poles of positive frequency [rad/s]."""

    square: float  # sum of squares of the residual over that of the response
    poles: Complexes
    num_parameters: int


def second_resonance(
    record: Record, band_hz: tuple[float, float] | None, delay_s: float
) -> Iterator[Fault]:
    """Yield a warning if two modes, or a mode and a steady line, explain a resonance better."""
    channels = {role: x[:LOOKED_AT] for role, x in record.channels.items()}
    record = replace(record, channels=channels)
    try:
        lines = driven_lines(record, band_hz)
        if not np.all(np.isfinite(lines.y)) or not np.any(lines.y):
            return
        first = read_lines(lines)
    except DataError:  # The record has no resonance that could be read.
        return
    centre = 2 * np.pi * first.frequency_hz
    half = max(WIDE, 2 * HALF_WIDTHS * abs(first.damping)) * centre
    near = np.abs(lines.omega - centre) < half
    if np.count_nonzero(near) < FEWEST:
        return
    omega, source = lines.omega[near], lines.source[near]
    y = lines.y[near] * np.exp(1j * omega * delay_s)
    one, two = (_fitted(omega, source, y, modes) for modes in (1, 2))
    num = 2 * len(omega)
    odds = num * np.log(one.square / two.square) - np.log(num) * (
        two.num_parameters - one.num_parameters
    )
    explained = one.square - two.square
    if two.square > EXPLAINS * one.square or odds < ODDS or explained < LEAST**2:
        return
    poles = two.poles[(omega[0] < two.poles.imag) & (two.poles.imag < omega[-1])]
    if len(poles) < 2:
        return
    mode, other = sorted(poles, key=lambda pole: abs(pole - 1j * centre))
    length = record.num_samples / record.fs
    if abs(other.real) * length < 1 / STEADY:
        yield doubt(record.response, *messages.line_beside_drive(f"{_hz(other):.5g}"))
    elif max(mode.real, other.real) < 0:
        band = beside(_hz(mode), _hz(other), band_hz or driven_band(record))
        text = messages.second_mode(_hz(mode), _hz(other), band, driven=True)
        yield doubt(record.response, *text)


def _hz(pole: complex) -> float:
    return abs(pole) / (2 * np.pi)


def _fitted(omega: Reals, source: Complexes, y: Complexes, modes: int) -> _Rational:
    """Fit a rational function of a number of modes; return the best of the weighted fits."""
    centre, order = float(np.mean(omega)), 2 * modes
    s = 1j * omega / centre
    powers = s[:, None] ** np.arange(-1, order)
    own, driven = (x / np.sqrt(np.mean(np.abs(x) ** 2)) for x in (y, source))
    columns = np.concatenate(
        [own[:, None] * powers[:, 1:], -driven[:, None] * powers[:, 1:-1], -powers], axis=1
    )
    weight, fits = np.ones(len(omega)), []
    for _ in range(ROUNDS):
        coefficients = real_coefficients(weight[:, None] * columns, -weight * own * s**order)
        below = s**order + powers[:, 1:] @ coefficients[:order]
        model = -(columns[:, order:] @ coefficients[order:]) / below
        square = float(np.mean(np.abs(own - model) ** 2))
        roots: Any = np.roots([1.0, *coefficients[:order][::-1]])
        poles = centre * roots[roots.imag > 0]
        fits.append(_Rational(square, poles, len(coefficients)))
        weight = 1 / np.abs(below)
    return min(fits, key=lambda fit: fit.square)
