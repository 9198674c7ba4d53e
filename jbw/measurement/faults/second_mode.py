r"""Modes besides the first one: a second mode within the band, and modes outside the band.

A second mode or a steady line near the resonance of a record of noise or a multisine is found by
rational functions of one and of two modes, fitted to the lines about the resonance,

$$Y = \frac{\sum_{k=0}^{2m-2} b_k s^k\,U + \sum_{k=-1}^{2m-1} c_k s^k}
           {s^{2m} + \sum_{k=0}^{2m-1} a_k s^k}, \quad s = j\omega, \quad m = 1, 2,$$

where the constants c represent the states in which the record begins and ends. Each is a linear
least-squares fit that is repeated with weights $1/|D|$ of the last denominator D. A joint leaves a
residual that varies from line to line. Of 85 sound records with strong laws (`benchmarks/outside`)
two modes leave at least 48 % of its sum of squares, of three records with two modes at most 0.04 %.

Reference:
    C. K. Sanathanan, J. Koerner, IEEE Trans. Autom. Control 8 (1963) 56-58.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from jbw.errors import DataError
from jbw.measurement.channels import Complexes, Reals
from jbw.measurement.faults.fault import Fault, doubt
from jbw.measurement.faults.hypothesis import ODDS, Facts, Fits, Hypothesis
from jbw.measurement.faults.plausibility import LOOKED_AT
from jbw.measurement.faults.suspect import (
    Misfit,
    Suspect,
    as_columns,
    is_driven,
    stiffness,
)
from jbw.measurement.readings.decay import DecayCause, DecayFits, DecaySignal
from jbw.measurement.readings.read import decay_fits
from jbw.measurement.readings.slow_flow import strongest_line
from jbw.measurement.readings.sweep import (
    SweepCause,
    SweepFits,
    SweepSignal,
    mirror_of,
    sweep_columns,
)
from jbw.measurement.records import Record
from jbw.measurement.resonances import (
    HALF_WIDTHS,
    WIDE,
    driven_band,
    driven_lines,
    read_lines,
    real_coefficients,
)
from jbw.report.messages import causes
from jbw.report.messages import decay_faults as messages
from jbw.report.messages.message import FaultText

LEAST = 0.02  # smallest amplitude of the second mode, relative to the first mode's at the start
DAMPINGS = (0.2, 6.0)  # range of the second mode's damping ratio, relative to that of the first
NEAREST = 2.0  # smallest distance of the modes in a sweep, in damping rates of the first mode
# largest distance of two modes that beat, in damping rates of the first mode
BEAT = 4.0
# largest change of the first mode's frequency and damping in a narrower band, relative to its
# damping
MOVED = 0.1
# number of frequencies and dampings of additional modes that are tried near a fit
NUM_PLACES, TRIED_DAMPINGS = 96, (0.003, 0.01, 0.03)
# smallest relative distance in frequency of an additional mode from the joint's own mode
APART = 0.05
ROUNDS = 6  # number of weighted fits
PER_MODE = 6  # number of parameters of a rational function for each mode
FEWEST = 6 * PER_MODE  # number of lines, three times that of the parameters of two modes
EXPLAINS = 0.25  # largest fraction of the residual sum of squares that remains with two modes
EXPLAINED = 0.02  # smallest residual that a second mode explains, relative to the response
# A mode whose decay would last this many times the record is a steady line.
STEADY = 3.0


class SecondMode(Hypothesis):
    """A second mode: amplitude, phase; distance and damping in damping rates of the first mode."""

    name = "second mode"

    def causes(self, fits: Fits, basis: str) -> Iterator[DecayCause | SweepCause]:
        """Yield a second mode on each side of the first, or at the residual's strongest line."""
        if isinstance(fits, DecayFits):
            yield from _in_decay(fits, basis)
            return
        if basis != "linear":
            return
        reach = 0.3 * float(np.ptp(fits.signal.rate)) / fits.scale
        for away in (-reach, -3.0, 3.0, reach):
            yield _in_sweep(fits, away)

    def matters(self, values: Reals, fits: Fits) -> bool:
        """Return whether a sweep passes the second mode, or a decay clearly beats with it."""
        low, high = DAMPINGS
        if isinstance(fits, SweepFits):
            rate = fits.signal.rate
            second = 2 * np.pi * first_hz(fits) + float(values[1]) * damping_rate(fits)
            passed = low < abs(values[0]) < high and rate.min() < second < rate.max()
            # A mode nearer than `NEAREST` would be the first mode itself, with a lag.
            return bool(passed and abs(float(values[1])) > NEAREST)
        # If the modes are closer than the sum of their damping rates, one decays before they beat.
        beats = abs(float(values[2])) > 1.0 + abs(float(values[3]))
        return beats and low < abs(values[3]) < high and float(np.hypot(*values[:2])) > LEAST

    def fault(self, values: Reals, fits: Fits, facts: Facts) -> FaultText:
        """Return the text on a second mode: both frequencies, and a band that excludes it.

        That band is tried on a decay: what it leaves of the second mode, or eats of the record,
        must not move the first.
        """
        first = first_hz(fits)
        away = values[2] if isinstance(fits, DecayFits) else values[1]
        second = first + float(away) * damping_rate(fits) / (2 * np.pi)
        band = beside(first, second, facts.band_hz)
        driven = not isinstance(fits, DecayFits)
        narrower = band if driven or _keeps_mode(band, facts) else None
        return messages.second_mode(first, second, narrower, driven=driven)

    def suspects(self, misfit: Misfit) -> Iterator[Suspect]:
        """Yield a second mode at each of many driven frequencies away from the joint's own mode."""
        driven = _driven(misfit)
        if len(driven):
            places = np.geomspace(driven.min(), driven.max(), NUM_PLACES)
            is_apart = np.abs(places / misfit.theta["omega_n"] - 1) > APART
            yield from modes_at(misfit, places[is_apart])


def modes_at(misfit: Misfit, places: Iterable[float]) -> Iterator[Suspect]:
    """Yield possible additional modes at given frequencies [rad/s], with several dampings each."""
    first, driven = misfit.theta["omega_n"] / (2 * np.pi), _driven(misfit) / (2 * np.pi)
    for omega in map(float, places):
        second = omega / (2 * np.pi)
        band = beside(first, second, (driven.min(), driven.max())) if len(driven) else None
        text = messages.second_mode(first, second, band, driven=True)
        yield from (_near_fit(misfit, omega, zeta, text) for zeta in TRIED_DAMPINGS)


def _driven(misfit: Misfit) -> Reals:
    """Return the driven frequencies [rad/s] of all data groups."""
    lines = [s.omega[is_driven(s)] for s in misfit.spectra.values()]
    return np.concatenate([line[line > 0] for line in lines])


def _near_fit(misfit: Misfit, omega: float, zeta: float, text: FaultText) -> Suspect:
    r"""Return a mode's columns: $X = a\,U / (\omega_2^2 - \omega^2 + 2j\zeta_2\omega_2\omega)$."""
    columns = {}
    for label, spectrum in misfit.spectra.items():
        below = stiffness({"omega_n": omega, "zeta": zeta}, spectrum.omega)
        columns[label] = as_columns(spectrum.row(spectrum.factor * spectrum.source / below))
    return Suspect(columns, lambda _: text, mode=(omega, zeta))


def beside(first: float, second: float, band: tuple[float, float]) -> tuple[float, float]:
    """Return a band [Hz] about the first mode that ends midway between both modes."""
    middle = 0.5 * (first + second)
    low, high = (band[0], middle) if second > first else (middle, band[1])
    return float(f"{low:.4g}"), float(f"{high:.4g}")


def _keeps_mode(band_hz: tuple[float, float], facts: Facts) -> bool:
    """Return whether a fit in a narrower band finds the first mode as the fit of both modes did."""
    fits = decay_fits(facts.record, band_hz, facts.settle_s)
    if fits is None:
        return False
    hz, zeta = first_hz(fits), damping_rate(fits) / (2 * np.pi * first_hz(fits))
    expected_hz, expected_zeta = facts.mode
    moved = abs(hz / expected_hz - 1) / expected_zeta, abs(zeta / expected_zeta - 1)
    return max(moved) < MOVED


def damping_rate(fits: Fits) -> float:
    """Return the damping rate of the fitted linear mode [1/s]."""
    at = 2 if isinstance(fits, DecayFits) else 0
    return abs(float(fits.fits["linear"].theta[at])) * fits.scale


def first_hz(fits: Fits) -> float:
    """Return the frequency of the fitted linear mode [Hz]."""
    at = 3 if isinstance(fits, DecayFits) else 1
    turn = float(fits.fits["linear"].theta[at]) * fits.scale
    return fits.signal.centre_hz + turn / (2 * np.pi)


def _in_decay(fits: DecayFits, basis: str) -> Iterator[DecayCause]:
    signal = fits.signal
    sigma, omega = damping_rate(fits), 2 * np.pi * (first_hz(fits) - signal.centre_hz)
    residual = fits.fits[basis].residual
    strongest, _ = strongest_line(residual, signal.step_s)

    def with_mode(signal: DecaySignal, model: Complexes, values: Reals) -> Complexes:
        pole = 1j * (omega + values[2] * sigma) - abs(values[3]) * sigma
        return model + signal.a0 * (values[0] + 1j * values[1]) * np.exp(pole * signal.time)

    for side in (-1.0, 1.0):
        at = strongest if abs(strongest - omega) > 1.5 * sigma else omega + side * BEAT * sigma
        shape = np.exp((1j * at - sigma) * signal.time)
        size = np.vdot(shape, residual) / np.vdot(shape, shape) / signal.a0
        yield DecayCause(np.array([size.real, size.imag, (at - omega) / sigma, 1.0]), with_mode)


def _in_sweep(fits: SweepFits, away: float) -> SweepCause:
    rate, first = damping_rate(fits), 2 * np.pi * first_hz(fits)

    def with_mode(signal: SweepSignal, columns: Complexes, values: Reals) -> Complexes:
        pole = -(abs(values[0]) + 1e-6) * rate + 1j * (first + values[1] * rate)
        pole = np.full(len(signal.time), pole)
        second, _, _ = sweep_columns(signal, pole, mirror_of(signal, pole))
        return np.column_stack([columns, second[:, 0]])

    return SweepCause(np.array([1.0, away]), with_mode)


class OutsideModes(Hypothesis):
    r"""The response of modes outside the band, common to all tests: $X = (R - M / \omega^2)\,U$."""

    name = "modes outside the band"

    def suspects(self, misfit: Misfit) -> Iterator[Suspect]:
        """Yield columns of a compliance and a mass that represent modes outside the band."""
        columns = {}
        for label, spectrum in misfit.spectra.items():
            stiff, squares = spectrum.factor * spectrum.source, spectrum.omega**2
            mass = np.divide(-stiff, squares, out=np.zeros_like(stiff), where=squares > 0)
            columns[label] = as_columns(spectrum.row(stiff), spectrum.row(mass))
        yield Suspect(columns, lambda terms: causes.residual_term(terms[0]))


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
    (left_by_one, _), (left_by_two, poles) = (_fitted(omega, source, y, modes) for modes in (1, 2))
    num = 2 * len(omega)
    odds = num * np.log(left_by_one / left_by_two) - np.log(num) * PER_MODE
    explained = left_by_one - left_by_two
    if left_by_two > EXPLAINS * left_by_one or odds < ODDS or explained < EXPLAINED**2:
        return
    poles = poles[(omega[0] < poles.imag) & (poles.imag < omega[-1])]
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


def _fitted(omega: Reals, source: Complexes, y: Complexes, modes: int) -> tuple[float, Complexes]:
    """Fit a rational function of a number of modes; choose the best of the weighted fits.

    Returns:
        The residual's sum of squares over that of the response, and the poles of positive
        frequency [rad/s].
    """
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
        fits.append((square, poles))
        weight = 1 / np.abs(below)
    return min(fits, key=lambda fit: fit[0])
