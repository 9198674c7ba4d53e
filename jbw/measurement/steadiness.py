"""Whether tones and steps had settled, and whether their third harmonic stands above the noise."""

import warnings
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from jbw.errors import JbwError
from jbw.measurement.checks import Fault
from jbw.measurement.harmonics import DRIFT_LIMIT, Harmonics, harmonics
from jbw.measurement.probing import NOISE_FLOOR
from jbw.measurement.records import Record

THIRD = 3  # the highest order looked at
LISTED = 6  # tones named in a message


def unsteady(
    record: Record,
    tones_hz: Sequence[float],
    *,
    settle: float = 0.0,
    dwell: float | None = None,
) -> tuple[Fault, ...]:
    """What is doubtful in a record of steady tones.

    Args:
        record: A record of kind tones or stepped.
        tones_hz: Frequencies present at once, or in turn [Hz].
        settle: Time discarded first, in the record or in each step [s].
        dwell: Duration of each step [s]; None when all tones are present at once.
    """
    y = record.channels[record.response]
    fitted, refused = [], []
    for i, tone in enumerate(tones_hz):
        part, others = y, [f for f in tones_hz if f != tone]
        if dwell is not None:
            part, others = y[round(i * dwell * record.fs) : round((i + 1) * dwell * record.fs)], []
        try:
            fitted.append(_fitted(part, record, tone, settle, others))
        except JbwError as error:
            what = f"Tone {tone:.4g} Hz: {error.what}"
            refused.append(Fault("error", record.response, what, error.why, error.remedy))
    found = [*refused[:1], _drifting(fitted, record.response)]
    # Only a probing test, whose tones are all present at once, is read for its third harmonic.
    found += [] if dwell is not None else [_buried(fitted, record.response)]
    return tuple(finding for finding in found if finding)


def _fitted(
    y: NDArray[np.float64], record: Record, tone: float, settle: float, others: Sequence[float]
) -> Harmonics:
    # Harmonics of one tone may coincide with another tone; those are fitted once.
    apart = [f for f in others if all(abs(f - n * tone) > 1e-6 * tone for n in (1, 2, THIRD))]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the drift becomes a finding
        return harmonics(
            y,
            record.fs,
            2 * np.pi * tone,
            THIRD,
            response=record.response,
            start=settle,
            also=[2 * np.pi * f for f in apart],
        )


def _drifting(fitted: Sequence[Harmonics], role: str) -> Fault | None:
    drifting = [
        one
        for one in fitted
        if one.drift > DRIFT_LIMIT and one.drift > NOISE_FLOOR * float(one.drift_std)
    ]
    if not drifting:
        return None
    worst = max(float(one.drift) for one in drifting)
    return Fault(
        "warning",
        role,
        f"{_named(drifting)}: the amplitude changes by {worst:.1%} from one half of the record to "
        "the other.",
        "A transient is left, or the frequency is not exact.",
        "Raise settle, or correct tones.",
    )


def _buried(fitted: Sequence[Harmonics], role: str) -> Fault | None:
    buried = [one for one in fitted if abs(one.amplitudes[-1]) < NOISE_FLOOR * _third_std(one)]
    if not buried:
        return None
    third, std = abs(buried[0].amplitudes[-1]), _third_std(buried[0])
    return Fault(
        "warning",
        role,
        f"{_named(buried)}: the third harmonic ({third:.2g} m) does not stand above the noise "
        f"({std:.2g} m).",
        "This record alone then says nothing of the joint's third-order kernel.",
        "Raise the level, measure longer, or leave the tone out.",
    )


def _third_std(fitted: Harmonics) -> float:
    """Standard deviation of each component of the third harmonic [m]."""
    return float(np.sqrt(fitted.variance[-1] / 2))


def _named(fitted: Sequence[Harmonics]) -> str:
    tones = ", ".join(f"{one.omega / (2 * np.pi):.4g}" for one in fitted[:LISTED])
    more = f" and {len(fitted) - LISTED} more" if len(fitted) > LISTED else ""
    return f"Tone {tones} Hz{more}"
