"""Measurements of an oscillator other than time records: response curves and force loops."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jbw.errors import DataError
from jbw.measurement.channels import Complexes, Reals
from jbw.measurement.records import INPUTS, RESPONSES, Record
from jbw.measurement.spans import start_of
from jbw.quantities import Motion, derivative_order


class MeasuredCurve(NamedTuple):
    """A measured response at each frequency of a harmonic excitation, whose level may vary."""

    freq_hz: Reals  # excitation frequencies, in the order of the file [Hz]
    source: Reals  # peak amplitude of the excitation; the phase of the excitation is zero
    response: Complexes  # peak amplitude X of the response x(t) = Re X exp(j omega t)
    source_kind: str  # `input` or `force`
    response_kind: Motion  # displacement, velocity or acceleration
    # Whether the file contains the response per unit of excitation, at an unknown amplitude;
    # `source` is then 1, and the curve is that of the linear regime.
    is_ratio: bool = False


FORCES = ("restoring_force", "force")  # roles of a loop's force


class ForcedLoop(NamedTuple):
    """A force loop: displacement is prescribed to a joint and the joint's force is measured."""

    fs: float  # sampling frequency [Hz]
    displacement: Reals  # [m]
    force: Reals  # force of the joint [N], positive for positive displacement
    begins: float = 0.0  # time of the first sample within the file [s]
    # whether the record is cut from a longer file, so that the joint moved before its first sample
    is_part: bool = False


def response_curve(record: Record) -> MeasuredCurve:
    """Return the response curve X = x exp(j phi) of an `frf` record, without masked lines."""
    _must_have(record, (("frequency",), ("phase",), INPUTS, RESPONSES), "a response curve")
    lines = {role: samples[record.valid] for role, samples in record.channels.items()}
    response = np.asarray(lines[record.response] * np.exp(1j * lines["phase"]), np.complex128)
    is_ratio = "ratio" in record.provenance
    freq_hz, source = lines["frequency"], lines[record.source]
    return MeasuredCurve(freq_hz, source, response, record.source, record.response, is_ratio)


class ControlledCurve(NamedTuple):
    """The points of a controlled test in the order of measurement; NaN where a point was lost."""

    freq_hz: Reals  # [Hz]
    amplitude: Reals  # peak of the displacement's fundamental [m]
    # Phase of the displacement relative to the force [rad]; None if not measured.
    phase: Reals | None
    force: Reals | None  # peak of the source's fundamental [N, V or N/kg]; None if not measured

    @property
    def valid(self) -> NDArray[np.bool_]:
        """A mask of the points at which every measured quantity is finite."""
        columns = (values for values in self if values is not None)
        return np.logical_and.reduce([np.isfinite(values) for values in columns])

    def at(self, points: NDArray[np.bool_]) -> "ControlledCurve":
        """Return the curve restricted to the selected points."""
        phase, force = (None if x is None else x[points] for x in (self.phase, self.force))
        return ControlledCurve(self.freq_hz[points], self.amplitude[points], phase, force)


def controlled_curve(record: Record, locked_phase: float = float("nan")) -> ControlledCurve:
    """Return the points of a controlled test from its record.

    The measured phase is converted to that of the displacement, whatever the response channel is.
    Where no phase was measured, `locked_phase` of the displacement [deg] is used; NaN for none.
    """
    _must_have(record, (("frequency",), RESPONSES), "a controlled test")
    channels, order = record.channels, derivative_order(record.response)
    freq_hz = np.asarray(channels["frequency"], float)
    amplitude = np.abs(channels[record.response]) / (2 * np.pi * freq_hz) ** order
    phase = None
    if "phase" in channels:
        # A negative amplitude means a phase shift of half a cycle.
        turned = np.where(channels[record.response] < 0, np.pi, 0.0) - 0.5 * np.pi * order
        phase = np.angle(np.exp(1j * (channels["phase"] + turned)))
    elif np.isfinite(locked_phase):
        phase = np.full(len(freq_hz), np.radians(locked_phase))
    source = next((role for role in INPUTS if role in channels), None)
    force = None if source is None else np.asarray(channels[record.source], float)
    return ControlledCurve(freq_hz, amplitude, phase, force)


def displacement_of(curve: MeasuredCurve) -> Complexes:
    """Return the peak displacement Y = X / (j omega)^p [m]; p: 1 for velocity, 2 acceleration."""
    omega = 2 * np.pi * curve.freq_hz
    return curve.response / (1j * omega) ** derivative_order(curve.response_kind)


def forced_loop(record: Record, delay: float = 0.0) -> ForcedLoop:
    """Return the prescribed displacement and the joint's force of a record of kind `loop`.

    A force that lags by a `delay` [s] is taken that much later, by linear interpolation; samples
    without a force are then omitted.
    """
    _must_have(record, (("displacement",), FORCES), "a forced loop")
    role = next(role for role in FORCES if role in record.channels)
    y, force = record.channels["displacement"], record.channels[role]
    is_part = start_of(record) > 0
    if delay == 0.0:
        return ForcedLoop(record.fs, y, force, start_of(record), is_part)
    late = delay * record.fs
    at = np.arange(len(y)) + late
    known = (at >= 0) & (at <= len(y) - 1)
    begins = start_of(record) + float(np.argmax(known)) / record.fs
    moved = np.interp(at[known], np.arange(len(y)), force)
    return ForcedLoop(record.fs, y[known], moved, begins, is_part)


def _must_have(record: Record, alternatives: tuple[tuple[str, ...], ...], what: str) -> None:
    for roles in alternatives:
        if not any(role in record.channels for role in roles):
            raise DataError(
                f"{record.name}: {what} needs a channel `{' or '.join(roles)}`, "
                f"but the record has {', '.join(record.channels)}.",
                remedy=f"Name a channel `{' or '.join(roles)}` in `channels`.",
            )
