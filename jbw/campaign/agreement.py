"""Whether a record agrees with what the campaign file says of its test."""

from collections.abc import Iterator, Sequence

import numpy as np

from jbw.campaign.schema import TestSpec
from jbw.measurement.checks import Finding, inspect
from jbw.measurement.curves import forced_loop, response_curve
from jbw.measurement.passivity import gives_energy, impassive, phase_in_degrees, undecaying
from jbw.measurement.plausibility import doubts, swapped
from jbw.measurement.records import INPUTS, Record
from jbw.measurement.steadiness import unsteady


def findings(
    record: Record,
    test: TestSpec,
    first: Sequence[Record] = (),
    *,
    per_unit: float | None = None,
) -> tuple[Finding, ...]:
    """Everything found in a record: by itself, against its test, beside the test's first repeat.

    Args:
        record: A repeat of the test.
        test: What the campaign file says.
        first: The test's first repeat, when this is not it.
        per_unit: Force per modal mass for one unit of the input, when known.
    """
    own = inspect(record, masked=test.gaps == "mask")
    told = [*own, *_fits_test(record, test), *_alike(record, first)]
    if not any(finding.severity == "error" for finding in told):
        told += _believable(record, test, per_unit)
    return tuple(told)


def _alike(record: Record, first: Sequence[Record]) -> Iterator[Finding]:
    """Whether a repeat has the sampling frequency of the test's first one."""
    for other in first:
        if record.fs != other.fs and not np.isnan(record.fs):
            yield Finding(
                "error",
                record.response,
                f"Repeats of a test must have one sampling frequency, but this has "
                f"{record.fs:g} Hz and {other.name} has {other.fs:g} Hz.",
                remedy="Make two tests of them.",
            )


def _fits_test(record: Record, test: TestSpec) -> Iterator[Finding]:
    """What in a record contradicts the campaign file: bands, tones, durations, periods."""
    role = record.response
    if test.kind == "frf":
        yield from _fits_curve(record, test)
        return
    nyquist = record.fs / 2
    if test.band and test.band[1] > nyquist:
        yield Finding(
            "error",
            role,
            f"`band` ends at {test.band[1]:g} Hz, above half the sampling frequency "
            f"({nyquist:g} Hz).",
            remedy=f"Lower the band's end to at most {nyquist:g} Hz, or correct fs.",
        )
    high = [tone for tone in test.tones if 3 * tone >= nyquist]
    if high:
        yield Finding(
            "error",
            role,
            f"Tone {high[0]:g} Hz must lie below a third of half the sampling frequency "
            f"({nyquist / 3:.4g} Hz).",
            "Its third harmonic folds back otherwise.",
            "Drop the tone, or measure with a higher sampling frequency.",
        )
    length = record.num_samples / record.fs
    needed = test.dwell * len(test.tones) if test.kind == "stepped" else test.settle
    if needed > length:
        told = "the steps take" if test.kind == "stepped" else "`settle` alone takes"
        yield Finding(
            "error",
            role,
            f"The record lasts {length:.4g} s, but {told} {needed:.4g} s.",
            remedy="Correct settle, dwell or tones, or give the whole record.",
        )
    if record.num_samples % test.periods:
        yield Finding(
            "error",
            role,
            f"The record's {record.num_samples} samples are not {test.periods} whole periods.",
            "Averages over periods would drift through the record.",
            "Correct periods, or cut the record to whole ones with span.",
        )


def _fits_curve(record: Record, test: TestSpec) -> Iterator[Finding]:
    role, freq = record.response, record.channels["frequency"]
    freq = freq[np.isfinite(freq)]
    if "phase" not in record.channels:
        yield Finding(
            "error",
            role,
            "The response is real and has no phase.",
            "An amplitude alone does not tell the damping from the stiffness.",
            "Name the channel `phase`, or one that holds the complex response.",
        )
    if test.band and len(freq) and not np.any((freq >= test.band[0]) & (freq <= test.band[1])):
        yield Finding(
            "error",
            role,
            f"No line of the curve, {freq.min():.4g} to {freq.max():.4g} Hz, lies in "
            f"`band` = [{test.band[0]:g}, {test.band[1]:g}] Hz.",
            remedy="Correct band, or the unit of frequency: it may be rad/s.",
        )


def _believable(record: Record, test: TestSpec, per_unit: float | None) -> Iterator[Finding]:
    """Doubts that take an estimate from the record, by the kind of its test."""
    driven = any(role in record.channels for role in INPUTS)
    if test.kind in ("noise", "multisine"):
        yield from doubts(record, test.band, delay=test.delay, per_unit=per_unit)
    elif test.kind == "sweep" and driven:
        yield from swapped(record)
    elif test.kind in ("tones", "stepped"):
        dwell = test.dwell if test.kind == "stepped" else None
        yield from unsteady(record, test.tones, settle=test.settle, dwell=dwell)
    elif test.kind == "frf":
        yield from phase_in_degrees(record.channels["phase"])
        yield from impassive(response_curve(record))
    elif test.kind == "loop":
        yield from gives_energy(forced_loop(record))
    elif test.kind == "decay":
        yield from undecaying(record, test.settle)
