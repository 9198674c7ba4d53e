"""Whether curves, loops and decays can belong to a structure that only loses energy."""

from dataclasses import replace

import numpy as np

from jbw.measurement.checks import Fault
from jbw.measurement.curves import ForcedLoop, ResponseCurve, displacement_of
from jbw.measurement.records import Record

DEGREES = 20.0  # [rad]; a phase beyond three turns was written in degrees
FEWEST_LINES = 4
DECAYED = 0.9  # last quarter of a decay over its first: more is no decay


def impassive(curve: ResponseCurve) -> tuple[Fault, ...]:
    r"""Doubts about signs and units of a curve.

    The force does the work per cycle $-\pi F\,\mathrm{Im}\,Y$, which a passive structure takes in,
    and the phase of the response falls with frequency through a resonance.
    """
    if len(curve.freq_hz) < FEWEST_LINES:
        return (_short(curve),)
    phase = np.angle(curve.response)
    if np.all(np.abs(phase) == 0):
        return (_in_phase(curve),)
    found = [_negative(curve), _reversed(curve)]
    return tuple(finding for finding in found if finding)


def gives_energy(loop: ForcedLoop) -> tuple[Fault, ...]:
    r"""The doubt that a forced loop is traversed the wrong way round.

    $$W = \int F\,dy$$

    is what the joint takes in; over whole loops it cannot be negative.
    """
    work = float(np.trapezoid(loop.force, loop.displacement))
    stored = float(np.ptp(loop.force) * np.ptp(loop.displacement)) / 8  # of a spring, at its most
    if work > -stored:
        return ()
    return (
        Fault(
            "warning",
            "displacement",
            f"The joint gives out {-work:.3g} J over the record.",
            "Force or displacement has its sign turned: a joint takes energy in.",
            "Turn one: scale = { displacement = -1.0 }.",
        ),
    )


def undecaying(record: Record, settle: float = 0.0) -> tuple[Fault, ...]:
    """The doubt that a free decay does not decay: its last quarter against its first."""
    x = record.channels[record.response][round(settle * record.fs) :]
    quarter = len(x) // 4
    if quarter == 0:
        return ()
    first, last = (float(np.std(part)) for part in (x[:quarter], x[len(x) - quarter :]))
    if last <= DECAYED * first:
        return ()
    times = last / first if first else np.inf
    return (
        Fault(
            "warning",
            record.response,
            f"The response of the last quarter is {times:.2g} times that of the first.",
            "A free decay falls; this record may be driven, or begin before the impact.",
            "Correct kind, or cut the record with span or settle.",
        ),
    )


def phase_in_degrees(phase: np.ndarray) -> tuple[Fault, ...]:
    """The doubt that a phase given in radians was written in degrees."""
    largest = float(np.abs(phase).max())
    if largest <= DEGREES:
        return ()
    return (
        Fault(
            "warning",
            "phase",
            f"The phase reaches {largest:.3g} rad, more than three turns.",
            "It reads like degrees.",
            'Give units = { phase = "deg" }.',
        ),
    )


def _short(curve: ResponseCurve) -> Fault:
    return Fault(
        "error",
        curve.response_kind,
        f"The curve has {len(curve.freq_hz)} lines, but at least {FEWEST_LINES} are needed.",
        remedy="Measure more frequencies around the resonance.",
    )


def _in_phase(curve: ResponseCurve) -> Fault:
    return Fault(
        "warning",
        "phase",
        "The response is in phase with the input at every line.",
        "A structure with damping lags; without a phase the damping is not known.",
        "Name the channel that holds the phase.",
    )


def _negative(curve: ResponseCurve) -> Fault | None:
    if curve.source_kind != "force" or np.all(curve.source > 0):
        return None
    return Fault(
        "error",
        curve.source_kind,
        "The input's amplitude must be positive, but it is not at every line.",
        remedy="Give amplitudes, not instantaneous values; correct the polarity in the response.",
    )


def _reversed(curve: ResponseCurve) -> Fault | None:
    falls = _falls(curve)
    upright = curve if falls else replace(curve, response=np.conj(curve.response))
    takes_in = _work(upright) > 0
    if falls and takes_in:
        return None
    turned = [] if falls else ["phase = -1.0"]
    turned += [] if takes_in else [f"{curve.response_kind} = -1.0"]
    wrong = [] if falls else ["its phase rises with frequency"]
    wrong += [] if takes_in else ["the force takes energy out"]
    return Fault(
        "warning",
        curve.response_kind,
        f"The response cannot be that of a passive structure: {' and '.join(wrong)}.",
        "A wrong sign gives a joint with negative damping or stiffness.",
        f"Turn the sign: scale = {{ {', '.join(turned)} }}.",
    )


def _work(curve: ResponseCurve) -> float:
    """Work of the force, summed over the lines; the resonance decides its sign."""
    return float(np.sum(-np.imag(displacement_of(curve)) * curve.source))


def _falls(curve: ResponseCurve) -> bool:
    """Whether the phase of the response falls with frequency from end to end."""
    order = np.argsort(curve.freq_hz)
    phase = np.unwrap(np.angle(curve.response[order]))
    return bool(phase[-1] < phase[0])
