"""Whether tones and steps had settled, and whether their third harmonic stands above the noise."""

import warnings
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from jbw.errors import JbwError
from jbw.measurement.checks import Finding
from jbw.measurement.harmonics import DRIFT_LIMIT, Harmonics, harmonics
from jbw.measurement.probing import NOISE_FLOOR
from jbw.measurement.records import Record

THIRD = 3  # the highest order looked at


def unsteady(
    record: Record,
    tones_hz: Sequence[float],
    *,
    settle: float = 0.0,
    dwell: float | None = None,
) -> tuple[Finding, ...]:
    """What is doubtful in a record of steady tones.

    Args:
        record: A record of kind tones or stepped.
        tones_hz: Frequencies present at once, or in turn [Hz].
        settle: Time discarded first, in the record or in each step [s].
        dwell: Duration of each step [s]; None when all tones are present at once.
    """
    y = record.channels[record.response]
    found: list[Finding] = []
    for i, tone in enumerate(tones_hz):
        part, others = y, [f for f in tones_hz if f != tone]
        if dwell is not None:
            part, others = y[round(i * dwell * record.fs) : round((i + 1) * dwell * record.fs)], []
        try:
            fitted = _fitted(part, record, tone, settle, others)
        except JbwError as error:
            what = f"Tone {tone:.4g} Hz: {error.what}"
            found.append(Finding("error", record.response, what, error.why, error.remedy))
            continue
        found += [f for f in (_drifts(fitted, record), _buried(fitted, record)) if f]
    return tuple(found)


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


def _drifts(fitted: Harmonics, record: Record) -> Finding | None:
    drift = float(fitted.drift)
    if drift <= DRIFT_LIMIT or drift <= NOISE_FLOOR * float(fitted.drift_std):
        return None
    return Finding(
        "warning",
        record.response,
        f"Tone {fitted.omega / (2 * np.pi):.4g} Hz: its amplitude changes by {drift:.1%} from one "
        "half of the record to the other.",
        "A transient is left, or the frequency is not exact.",
        "Raise settle, or correct tones.",
    )


def _buried(fitted: Harmonics, record: Record) -> Finding | None:
    third, std = abs(fitted.amplitudes[-1]), np.sqrt(fitted.variance[-1] / 2)
    if third > NOISE_FLOOR * std:
        return None
    return Finding(
        "warning",
        record.response,
        f"Tone {fitted.omega / (2 * np.pi):.4g} Hz: the third harmonic ({third:.2g} m) does not "
        f"stand above the noise ({std:.2g} m).",
        "This record alone then says nothing of the joint's third-order kernel.",
        "Raise the level, measure longer, or leave the tone out.",
    )
