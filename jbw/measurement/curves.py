"""What is measured without a time history of the oscillator: response curves and forced loops."""

from typing import NamedTuple

import numpy as np

from jbw.errors import DataError
from jbw.measurement.channels import Complexes, Reals
from jbw.measurement.records import INPUTS, RESPONSES, Record
from jbw.quantities import Motion, derivative_order


class ResponseCurve(NamedTuple):
    """Measured harmonic response, line by line; a controller may vary the excitation along it."""

    freq_hz: Reals  # excitation frequencies, in the order of the file [Hz]
    source: Reals  # peak amplitude of the excitation, whose phase is zero
    response: Complexes  # peak amplitude X of the response x(t) = Re X exp(j omega t)
    source_kind: str  # `input` or `force`
    response_kind: Motion  # displacement, velocity or acceleration
    # Whether the file holds the response per unit of excitation, at an amplitude that it does
    # not tell; `source` is 1 then, and the curve is that of the linear regime.
    is_ratio: bool = False


class ForcedLoop(NamedTuple):
    """A joint driven through a prescribed displacement while its force is measured."""

    fs: float  # sampling frequency [Hz]
    displacement: Reals  # [m]
    force: Reals  # of the joint [N], positive against positive displacement


def response_curve(record: Record) -> ResponseCurve:
    """The curve X = x exp(j phi) that a record of kind `frf` holds, without its masked lines."""
    _must_have(record, (("frequency",), ("phase",), INPUTS, RESPONSES), "a response curve")
    lines = {role: samples[record.valid] for role, samples in record.channels.items()}
    response = np.asarray(lines[record.response] * np.exp(1j * lines["phase"]), np.complex128)
    is_ratio = "ratio" in record.provenance
    freq_hz, source = lines["frequency"], lines[record.source]
    return ResponseCurve(freq_hz, source, response, record.source, record.response, is_ratio)


def displacement_of(curve: ResponseCurve) -> Complexes:
    """Complex peak displacement [m], Y = X / (j omega)^p; p of velocity is 1, of acceleration 2."""
    omega = 2 * np.pi * curve.freq_hz
    return curve.response / (1j * omega) ** derivative_order(curve.response_kind)


def forced_loop(record: Record) -> ForcedLoop:
    """The prescribed displacement and the force that a record of kind `loop` holds."""
    forces = ("restoring_force", "force")
    _must_have(record, (("displacement",), forces), "a forced loop")
    force = next(role for role in forces if role in record.channels)
    return ForcedLoop(record.fs, record.channels["displacement"], record.channels[force])


def _must_have(record: Record, wanted: tuple[tuple[str, ...], ...], what: str) -> None:
    for roles in wanted:
        if not any(role in record.channels for role in roles):
            raise DataError(
                f"{record.name}: {what} needs a channel `{' or '.join(roles)}`, "
                f"but the record has {', '.join(record.channels)}.",
                remedy="Name it under channels.",
            )
