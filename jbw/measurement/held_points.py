"""What points of a controlled test show of the resonance, without a model of the joint."""

from collections.abc import Iterator

import numpy as np

from jbw.errors import DataError
from jbw.measurement.curves import ControlledCurve, controlled_curve
from jbw.measurement.records import Test
from jbw.measurement.resonances import Reading
from jbw.report.messages import reading as messages


def curves_of_points(test: Test) -> list[ControlledCurve]:
    """The points of every record of a controlled test, those that were lost left out."""
    held = test.locked_phase if test.traits.is_locked else float("nan")
    curves = [controlled_curve(record, held) for record in test.records]
    return [curve.at(curve.valid) for curve in curves]


def readings_of_points(test: Test, gain: float | None) -> list[Reading]:
    r"""Frequency and damping at the amplitude of every point, by the force per unit mass g F.

    $$\omega_r^2 = \omega^2 + \frac{g F \cos\varphi}{Y}, \qquad
      2\zeta\,\omega_r\,\omega = -\frac{g F \sin\varphi}{Y}$$

    Raises:
        DataError: No force or phase was measured, or `gain` [1/kg] is not known.
    """
    curves = curves_of_points(test)
    if any(curve.force is None or curve.phase is None for curve in curves):
        raise DataError(f"Test {test.name} has no force, or no phase to it.")
    if gain is None:
        raise DataError(messages.STATE_MASS)
    return [reading for curve in curves for reading in _readings(curve, gain)]


def _readings(curve: ControlledCurve, gain: float) -> Iterator[Reading]:
    force, phase = np.asarray(curve.force), np.asarray(curve.phase)
    omega, pull = 2 * np.pi * curve.freq_hz, gain * force / curve.amplitude
    squared = omega**2 + pull * np.cos(phase)
    natural = np.sqrt(np.where(squared > 0, squared, np.nan))
    damping = -pull * np.sin(phase) / (2 * natural * omega)
    is_finite = np.isfinite(natural)
    rows = (curve.amplitude[is_finite], natural[is_finite] / (2 * np.pi), damping[is_finite])
    yield from map(Reading, *(row.tolist() for row in rows))


def locked_sentence(test: Test) -> str:
    """How the frequency at the phase that is held goes with the amplitude."""
    curve = curves_of_points(test)[0]
    order = np.argsort(curve.amplitude)
    y, hz = 1e3 * curve.amplitude[order], curve.freq_hz[order]
    return messages.held_phase(test.name, test.locked_phase, (y[0], y[-1]), (hz[0], hz[-1]))
