"""Whether records agree with what the campaign file says, and its settings with its tests."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from jbw.campaign.schema import CampaignSpec, TestSpec
from jbw.inference.samplers.register import SAMPLERS
from jbw.measurement.checks import Fault, inspect
from jbw.measurement.curves import forced_loop, response_curve
from jbw.measurement.kinds import KINDS, Kind
from jbw.measurement.passivity import gives_energy, impassive, phase_in_degrees, undecaying
from jbw.measurement.plausibility import doubts, swapped
from jbw.measurement.records import INPUTS, Record
from jbw.measurement.steadiness import unsteady

# Settings that not every kind of test reads, and the traits of those that do.
READ_BY: dict[str, Callable[[Kind], bool]] = {
    "fit_levels": lambda kind: kind.is_transient,
    "fit_repeats": lambda kind: kind.is_transient or kind.is_free,
    "substeps": lambda kind: kind.is_transient or kind.is_periodic or kind.is_free,
}


def unread(spec: CampaignSpec) -> Iterator[Fault]:
    """Settings that the tests of a campaign cannot use: they change nothing, and are told.

    Args:
        spec: The campaign file, checked.
    """
    traits, settings = [test.traits for test in spec.tests], spec.settings
    for name, reads in READ_BY.items():
        if name in settings.keys() and not any(map(reads, traits)):
            readers = ", ".join(kind.name for kind in KINDS.values() if reads(kind))
            yield _unread(name, f"only tests of kind {readers} read it, of which there are none")
    if settings.modes:
        yield _unread("modes", "one mode is identified, and nothing reads where others lie")
    for kind in settings.fit or ():
        if kind not in {test.kind for test in spec.tests}:
            yield _unread("fit", f"no test is of kind {kind}")
    if settings.offsets == "runs" and len(spec.tests) == 1:
        yield _unread("offsets", "there is one run alone, which nothing can differ from")
    sampler = SAMPLERS.get(settings.sampler)
    if settings.num_warmup and sampler and not sampler.draws[0]:
        yield _unread("num_warmup", f"sampler {sampler.name} has nothing to adapt")
    if "gain" in settings.prior and not (spec.gain is None and spec.modal_mass is None):
        yield _unread("prior gain", "the campaign states the gain, which is not identified then")
    elif "gain" in settings.prior and not any(kind.is_driven for kind in traits):
        yield _unread("prior gain", "no test has a source whose gain could be identified")
    if "zeta" in settings.prior and all(kind.is_prescribed for kind in traits):
        yield _unread("prior zeta", "along a prescribed displacement nothing moves freely")


def _unread(name: str, reason: str) -> Fault:
    return Fault("warning", name, f"`{name}` changes nothing: {reason}.", remedy="Leave it out.")


def findings(
    record: Record,
    test: TestSpec,
    first: Sequence[Record] = (),
    *,
    per_unit: float | None = None,
) -> tuple[Fault, ...]:
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


def _alike(record: Record, first: Sequence[Record]) -> Iterator[Fault]:
    """Whether a repeat has the sampling frequency of the test's first one."""
    for other in first:
        if record.fs != other.fs and not np.isnan(record.fs):
            yield Fault(
                "error",
                record.response,
                f"Repeats of a test must have one sampling frequency, but this has "
                f"{record.fs:g} Hz and {other.name} has {other.fs:g} Hz.",
                remedy="Make two tests of them.",
            )


def _fits_test(record: Record, test: TestSpec) -> Iterator[Fault]:
    """What in a record contradicts the campaign file: bands, tones, durations, periods."""
    role = record.response
    if test.traits.is_curve:
        yield from _fits_curve(record, test)
        return
    nyquist = record.fs / 2
    if test.band and test.band[1] > nyquist:
        yield Fault(
            "error",
            role,
            f"`band` ends at {test.band[1]:g} Hz, above half the sampling frequency "
            f"({nyquist:g} Hz).",
            remedy=f"Lower the band's end to at most {nyquist:g} Hz, or correct fs.",
        )
    high = [tone for tone in test.tones if 3 * tone >= nyquist]
    if high:
        yield Fault(
            "error",
            role,
            f"Tone {high[0]:g} Hz must lie below a third of half the sampling frequency "
            f"({nyquist / 3:.4g} Hz).",
            "Its third harmonic folds back otherwise.",
            "Drop the tone, or measure with a higher sampling frequency.",
        )
    length = record.num_samples / record.fs
    needed = test.dwell * len(test.tones) if test.traits.is_stepped else test.settle
    if needed > length:
        told = "the steps take" if test.traits.is_stepped else "`settle` alone takes"
        yield Fault(
            "error",
            role,
            f"The record lasts {length:.4g} s, but {told} {needed:.4g} s.",
            remedy="Correct settle, dwell or tones, or give the whole record.",
        )
    if record.num_samples % test.periods:
        yield Fault(
            "error",
            role,
            f"The record's {record.num_samples} samples are not {test.periods} whole periods.",
            "Averages over periods would drift through the record.",
            "Correct periods, or cut the record to whole ones with span.",
        )


def _fits_curve(record: Record, test: TestSpec) -> Iterator[Fault]:
    role, freq = record.response, record.channels["frequency"]
    freq = freq[np.isfinite(freq)]
    if "phase" not in record.channels:
        yield Fault(
            "error",
            role,
            "The response is real and has no phase.",
            "An amplitude alone does not tell the damping from the stiffness.",
            "Name the channel `phase`, or one that holds the complex response.",
        )
    if test.band and len(freq) and not np.any((freq >= test.band[0]) & (freq <= test.band[1])):
        yield Fault(
            "error",
            role,
            f"No line of the curve, {freq.min():.4g} to {freq.max():.4g} Hz, lies in "
            f"`band` = [{test.band[0]:g}, {test.band[1]:g}] Hz.",
            remedy="Correct band, or the unit of frequency: it may be rad/s.",
        )


def _believable(record: Record, test: TestSpec, per_unit: float | None) -> Iterator[Fault]:
    """Doubts that take an estimate from the record, by the kind of its test."""
    driven = any(role in record.channels for role in INPUTS)
    traits = test.traits
    if traits.is_broadband:
        yield from doubts(record, test.band, delay=test.delay, per_unit=per_unit)
    elif traits.is_transient and driven:
        yield from swapped(record)
    elif traits.is_steady:
        dwell = test.dwell if traits.is_stepped else None
        yield from unsteady(record, test.tones, settle=test.settle, dwell=dwell)
    elif traits.is_curve:
        yield from phase_in_degrees(record.channels["phase"])
        yield from impassive(response_curve(record))
    elif traits.is_prescribed:
        yield from gives_energy(forced_loop(record))
    elif traits.is_free:
        yield from undecaying(record, test.settle)
