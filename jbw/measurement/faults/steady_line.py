"""A line that neither decays nor follows the drive: mains hum, or a running machine."""

from collections.abc import Iterator

import numpy as np

from jbw.measurement.channels import Complexes, Reals
from jbw.measurement.faults.hypothesis import (
    Facts,
    Fits,
    Hypothesis,
    remainder,
)
from jbw.measurement.readings.decay import DecayCause, DecayFits, DecaySignal
from jbw.measurement.readings.slow_flow import strongest_line
from jbw.measurement.readings.sweep import SweepCause, SweepFits, SweepSignal
from jbw.report.messages import decay_faults as messages
from jbw.report.messages.message import FaultText

# fraction of the initial amplitude below which a line does not affect frequency and damping
LEAST = 2e-3
# largest amplitude of a steady line, relative to the start of a decay; once the decay has fallen to
# a tenth, the error is 10 %
SPOILS = 0.01
# Largest change of the logarithm of a line's amplitude over a record. A line that falls faster is
# motion of the mode, which damps less when it is small.
STEADY = 0.7
FASTEST = 30.0  # largest such change that is tried
STANDS_OUT = 60.0  # smallest height above the local median of a sweep's residual


class UndecayingLine(Hypothesis):
    """A line of constant amplitude: amplitude, phase, frequency and, of a decay, its fall."""

    name = "steady line"

    def causes(self, fits: Fits, basis: str) -> Iterator[DecayCause | SweepCause]:
        """Yield a line at the frequency at which the residual of the given fit is strongest."""
        residual = fits.fits[basis].residual
        yield (
            _in_decay(fits, residual) if isinstance(fits, DecayFits) else _in_sweep(fits, residual)
        )

    def matters(self, values: Reals, fits: Fits) -> bool:
        """Return whether the line exceeds 0.2 % of a decay, or stands out of the residual."""
        if self.turn(values, fits) <= -2 * np.pi * fits.signal.centre_hz:
            # At such a negative frequency, the line is the mirror image of the mode's own
            # oscillation.
            return False
        if isinstance(fits, SweepFits):
            return remainder(fits).line > STANDS_OUT
        return self.share(values, fits) > LEAST and abs(values[3]) < STEADY

    def fault(self, values: Reals, fits: Fits, facts: Facts) -> FaultText:
        """Return the text on a steady line: its frequency and size."""
        hz = fits.signal.centre_hz + self.turn(values, fits) / (2 * np.pi)
        # The digits suffice to distinguish neighbouring lines of the record's spectrum.
        periods = abs(hz) * facts.record.num_samples / facts.record.fs
        digits = max(4, 1 + int(np.ceil(np.log10(periods))))
        named = f"{hz:.{digits}g}"
        if isinstance(fits, SweepFits):
            return messages.line_beside_drive(named)
        return messages.steady_line(named, self.share(values, fits))

    def spoils(self, values: Reals, fits: Fits) -> bool:
        """Return whether the line exceeds 1 % of a decay."""
        return isinstance(fits, DecayFits) and self.share(values, fits) > SPOILS

    def share(self, values: Reals, fits: DecayFits) -> float:
        """Return the line's amplitude, relative to the initial amplitude in the band.

        A line in the band counts with its amplitude before the band's filter, another line with
        what the filter leaves of it.
        """
        signal, turn = fits.signal, self.turn(values, fits)
        size = float(np.hypot(values[0], values[1]))
        if abs(turn) > 2 * np.pi * signal.half_width_hz:
            return size
        mode = float(fits.fits["linear"].theta[3]) * fits.scale
        return size * signal.passed(mode) / signal.passed(turn)

    def turn(self, values: Reals, fits: Fits) -> float:
        """Return the line's angular frequency relative to the centre of the band [rad/s]."""
        if isinstance(fits, DecayFits):
            return float(values[2]) / fits.signal.time[-1] * 2 * np.pi
        return float(values[0]) / float(np.ptp(fits.signal.time)) * 2 * np.pi


def _in_decay(fits: DecayFits, residual: Complexes) -> DecayCause:
    """Return a steady line as a possible cause of a decay's residual, with starting values."""
    signal = fits.signal
    turn, size = strongest_line(residual * fits.weight**2, signal.step_s)
    level = size / np.sum(fits.weight**2) / signal.a0
    lines = turn * signal.time[-1] / (2 * np.pi)

    def with_line(signal: DecaySignal, model: Complexes, values: Reals) -> Complexes:
        pole = 2j * np.pi * values[2] - np.clip(values[3], -FASTEST, FASTEST)
        wave = np.exp(pole * signal.time / signal.time[-1])
        return model + signal.a0 * (values[0] + 1j * values[1]) * wave

    return DecayCause(np.array([level.real, level.imag, lines, 0.0]), with_line)


def _in_sweep(fits: SweepFits, residual: Complexes) -> SweepCause:
    """Return a steady line as a possible cause of a sweep's residual, with a starting frequency."""
    signal = fits.signal
    frame = signal.phase - 2 * np.pi * signal.centre_hz * signal.time
    turn, _ = strongest_line(residual * np.exp(1j * frame), signal.step_s)
    length = float(np.ptp(signal.time))

    def with_line(signal: SweepSignal, columns: Complexes, values: Reals) -> Complexes:
        turned = 2 * np.pi * (values[0] / length + signal.centre_hz) * signal.time - signal.phase
        return np.column_stack([columns, np.exp(1j * turned)])

    return SweepCause(np.array([turn * length / (2 * np.pi)]), with_line)
