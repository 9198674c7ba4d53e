"""Checks of the points of a controlled test: sign of the phase, held phase, branch jumps."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from jbw.measurement.channels import Reals
from jbw.measurement.curves import ControlledCurve, controlled_curve
from jbw.measurement.faults.fault import Fault, doubt, refusal
from jbw.measurement.records import INPUTS, Record
from jbw.report.messages import controlled_faults as messages
from jbw.report.messages.message import first_of

FEWEST_POINTS = 3
LISTED = 8  # largest number of points that a message names
JUMP = 0.3  # smallest jump of log amplitude between neighbouring points: a change by a third
SHIFT = 0.01  # smallest relative jump of a backbone's frequency between neighbouring points
TIMES = 8.0  # A step counts as a jump if it exceeds the median step by this factor.
# smallest simultaneous jump of the phase [rad], used where the phase is measured
TURN = np.radians(20.0)
SAME = 1e-6  # relative difference of frequency below which points belong to the same S-curve


def uncontrolled(
    record: Record, locked_phase: float | None, tolerance: float, *, names_jumps: bool
) -> Iterator[Fault]:
    """Yield faults: too few points, values that are not positive, doubtful phases, jumps.

    Args:
        record: A record of a controlled test.
        locked_phase: Phase of the displacement relative to the force to hold [deg]; None if no
            phase is held.
        tolerance: Largest deviation of a measured phase from `locked_phase` [deg].
        names_jumps: Whether to report jumps.
    """
    role, lines = record.response, record.valid
    channels = {name: samples[lines] for name, samples in record.channels.items()}
    for name in ("frequency", *INPUTS):
        if name in channels and not np.all(channels[name] > 0):
            place = 1 + int(np.argmin(record.channels[name] > 0))
            yield refusal(name, *messages.not_positive(name, place))
            return
    curve = controlled_curve(record).at(lines)
    if len(curve.freq_hz) < FEWEST_POINTS or not np.all(curve.amplitude > 0):
        yield refusal(role, *messages.few_points(FEWEST_POINTS, int(np.sum(curve.amplitude > 0))))
        return
    numbers = 1 + np.flatnonzero(lines)
    if curve.phase is not None and np.median(np.sin(curve.phase)) > 0:
        yield _turned(role, curve.freq_hz, curve.phase)
        return
    if curve.phase is not None and locked_phase is not None:
        yield from _off_phase(role, curve.phase, numbers, locked_phase, tolerance)
    if names_jumps:
        yield from _jumps(role, curve, numbers, is_locked=locked_phase is not None)


def _turned(role: str, freq_hz: Reals, phase: Reals) -> Fault:
    """Return a warning that the displacement leads the force, as if the joint supplied energy."""
    lowest = np.argsort(freq_hz)[: max(1, len(freq_hz) // 4)]
    # Far below the resonance, displacement and force are in phase unless a sign is wrong.
    over = np.mean(np.cos(phase[lowest])) < -0.5
    remedy = messages.put_scale(role) if over else messages.PUT_CONJUGATE
    return doubt(role, *messages.leading(np.degrees(np.median(phase)), remedy))


def _off_phase(
    role: str, phase: Reals, numbers: NDArray[np.intp], held: float, tolerance: float
) -> Iterator[Fault]:
    """Yield a warning if the measured phase is not the one that the controller was to hold."""
    error = np.degrees(np.angle(np.exp(1j * (phase - np.radians(held)))))
    off = np.abs(error) > tolerance
    if not off.any():
        return
    middle = float(np.median(error))
    if abs(middle) > tolerance and np.all(np.abs(error - middle) <= tolerance):
        remedy = messages.put_locked_phase(round(held + middle))
    else:
        most = float(np.ceil(np.abs(error).max()))
        remedy = messages.put_tolerance(most)
    yield doubt(role, *messages.off_phase(_named(numbers[off]), np.abs(error).max(), held, remedy))


def _jumps(
    role: str, curve: ControlledCurve, numbers: NDArray[np.intp], *, is_locked: bool
) -> Iterator[Fault]:
    """Yield a warning if the motion jumped to another branch of the response between two points."""
    steps = _steps_apart(curve, is_locked=is_locked)
    if not steps.any():
        return
    first = int(np.flatnonzero(steps)[0])
    pairs = [f"{numbers[i]} and {numbers[i + 1]}" for i in np.flatnonzero(steps)[:LISTED]]
    jump = (
        messages.frequency_jumps(curve.freq_hz[first], curve.freq_hz[first + 1])
        if is_locked
        else messages.amplitude_jumps(curve.amplitude[first], curve.amplitude[first + 1])
    )
    yield doubt(role, *messages.jumps(pairs, jump))


def _steps_apart(curve: ControlledCurve, *, is_locked: bool) -> np.ndarray:
    """Return a mask of the steps between neighbouring points that are far longer than usual."""
    moved = np.abs(np.diff(np.log(curve.freq_hz)))
    if is_locked:
        return moved > max(SHIFT, TIMES * float(np.median(moved)))
    grown = np.abs(np.diff(np.log(curve.amplitude)))
    within = np.ones(len(grown), bool)
    # If several S-curves follow each other, a step to the next curve is no jump.
    if np.mean(moved < SAME) > 0.5:
        within = moved < SAME
    usual = float(np.median(grown[within]))
    apart = within & (grown > max(JUMP, TIMES * usual))
    if curve.phase is not None:
        apart &= np.abs(np.angle(np.exp(1j * np.diff(curve.phase)))) > TURN
    return apart


def _named(numbers: NDArray[np.intp]) -> str:
    return f"point{'' if len(numbers) == 1 else 's'} {first_of([*map(str, numbers)], LISTED)}"
