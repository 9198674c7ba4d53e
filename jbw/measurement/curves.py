"""What is measured without a time history of the oscillator: response curves and forced loops."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from jbw.errors import DataError
from jbw.measurement.records import INPUTS, RESPONSES, Record
from jbw.quantities import derivative_order


@dataclass(frozen=True)
class ResponseCurve:
    """Measured harmonic response at one level: amplitudes against frequency, line by line.

    The excitation may vary along the curve, as it does where a controller holds the response.
    """

    freq_hz: NDArray[np.float64]  # excitation frequencies, in the order of the file [Hz]
    # Peak amplitude of the excitation at each line, whose phase is zero.
    source: NDArray[np.float64]
    # Complex peak amplitude X of the response x(t) = Re X exp(j order omega t).
    response: NDArray[np.complex128]
    source_kind: str  # `input` or `force`
    response_kind: str  # displacement, velocity or acceleration
    source_unit: str  # SI unit of `source`: V, N/kg or N
    order: int = 1  # harmonic of the excitation frequency at which the response was read
    # Whether the file holds the response per unit of excitation, at an amplitude that it does
    # not tell; `source` is 1 then, and the curve is that of the linear regime.
    is_ratio: bool = False
    name: str = ""  # what to call it in messages
    provenance: Mapping[str, str] = field(default_factory=dict)  # as in the record it came from


@dataclass(frozen=True)
class ForcedLoop:
    """A joint driven through a prescribed displacement while its force is measured."""

    fs: float  # sampling frequency [Hz]
    displacement: NDArray[np.float64]  # prescribed displacement [m]
    # Restoring force of the joint [N], positive against positive displacement.
    force: NDArray[np.float64]
    name: str = ""  # what to call it in messages
    provenance: Mapping[str, str] = field(default_factory=dict)  # as in the record it came from


def response_curve(record: Record, order: int = 1) -> ResponseCurve:
    r"""The curve that a record of kind `frf` holds.

    $$X = x \exp(j \varphi)$$

    with x the response channel and phi the phase of the response relative to the excitation.
    Lines that the record masks are left out.

    Args:
        record: Channels `frequency`, `phase`, `force` or `input`, and a response, line by line.
        order: Harmonic at which the response was read.

    Raises:
        DataError: A channel is missing.
    """
    _must_have(record, (("frequency",), ("phase",), INPUTS, RESPONSES), "a response curve")
    lines = {role: samples[record.valid] for role, samples in record.channels.items()}
    turn = np.exp(1j * lines["phase"])
    return ResponseCurve(
        freq_hz=lines["frequency"],
        source=lines[record.source],
        response=np.asarray(lines[record.response] * turn, dtype=np.complex128),
        source_kind=record.source,
        response_kind=record.response,
        source_unit=record.units[record.source],
        order=order,
        is_ratio="ratio" in record.provenance,
        name=record.name,
        provenance=record.provenance,
    )


def displacement_of(curve: ResponseCurve) -> NDArray[np.complex128]:
    r"""Complex peak displacement of a curve [m].

    $$Y = X / (j n \omega)^p$$

    with n the harmonic order and p = 0, 1, 2 for a displacement, velocity or acceleration.
    """
    omega = 2 * np.pi * curve.order * curve.freq_hz
    return curve.response / (1j * omega) ** derivative_order(curve.response_kind)


def forced_loop(record: Record) -> ForcedLoop:
    """The prescribed displacement and the force that a record of kind `loop` holds.

    Raises:
        DataError: A channel is missing.
    """
    forces = ("restoring_force", "force")
    _must_have(record, (("displacement",), forces), "a forced loop")
    force = next(role for role in forces if role in record.channels)
    return ForcedLoop(
        record.fs,
        record.channels["displacement"],
        record.channels[force],
        record.name,
        record.provenance,
    )


def _must_have(record: Record, wanted: tuple[tuple[str, ...], ...], what: str) -> None:
    for roles in wanted:
        if not any(role in record.channels for role in roles):
            raise DataError(
                f"{record.name}: {what} needs a channel `{' or '.join(roles)}`, "
                f"but the record has {', '.join(record.channels)}.",
                remedy="Name it under channels.",
            )
