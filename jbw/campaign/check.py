"""The check of a campaign: its records against the file, and its settings against the tests.

Findings stop nothing here: every channel of the campaign is checked to the end.
"""

import json
import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from jbw.campaign.document import toml
from jbw.campaign.files import repeats_of
from jbw.campaign.joints import STRUCTURE, JointsCheck, check_joints
from jbw.campaign.schema import CampaignSpec, read_spec
from jbw.campaign.tables import TestSpec, force_per_unit, gain_of
from jbw.campaign.together import (
    Level,
    ResponseOrigin,
    against_levels,
    held_twice,
    level_of,
    source_of,
)
from jbw.campaign.trial import tried
from jbw.errors import ConfigError, DataError, JbwError
from jbw.inference.samplers.register import SAMPLERS
from jbw.measurement.base_motion import MINUS_BASE
from jbw.measurement.curves import forced_loop, response_curve
from jbw.measurement.faults import responses
from jbw.measurement.faults.begins_late import begins_late, blows_seen
from jbw.measurement.faults.channels import inspect
from jbw.measurement.faults.controlled import uncontrolled
from jbw.measurement.faults.examine import Examined, examined_decay, examined_sweep
from jbw.measurement.faults.fault import Fault, doubt, gathered, refusal, worst
from jbw.measurement.faults.loops import loop_causes, one_sided, travels_freely
from jbw.measurement.faults.noise import noisy_drive, untimely
from jbw.measurement.faults.plausibility import already_moving, doubts, swapped
from jbw.measurement.faults.second_mode import second_resonance
from jbw.measurement.faults.unlike_gains import unlike_gains, unlike_tests
from jbw.measurement.kinds import KINDS, Kind
from jbw.measurement.nonlinearity import MOST_SAMPLES, seen_in
from jbw.measurement.records import BASE, INPUTS, RESPONSES, Record, is_sampled, share_clock
from jbw.measurement.spans import DRIFTS, in_whole_periods, long_records, toml_list
from jbw.measurement.spectra import strongest_line
from jbw.quantities import FED
from jbw.report.messages import campaign_faults as messages
from jbw.report.messages.message import FaultText
from jbw.report.messages.remedies import EXCLUDE, OF_ONE_ROLE, SPAN, exclude

# largest plausible motion of a joint [m]; joints in benches and machines move by centimetres
LARGEST_MOTION = 1.0
FEWEST_SAMPLES = 32  # smallest number of samples from which a motion is judged
# If a fit of one mode has a larger relative residual, the gain from this fit means nothing.
OF_ONE_MODE = 0.3
# settings that only some kinds of test use, with the property that these kinds have
READ_BY: dict[str, Callable[[Kind], bool]] = {
    "fit_levels": lambda kind: kind.is_transient,
    "modes": lambda kind: kind.is_driven,
    "fit_repeats": lambda kind: kind.is_transient or kind.is_free,
    "substeps": lambda kind: kind.is_transient or kind.is_periodic or kind.is_free,
}


@dataclass(frozen=True)
class Row:
    """One row of the table of a check: a channel of a test, or a setting."""

    test: str  # name of the test; "[identify]" for a setting
    channel: str  # name or path of the channel in the file, or key of the setting
    role: str
    unit: str  # unit of the channel as the campaign states it
    fs: float | None  # sampling frequency [Hz]; None if unknown or not a time record
    repeats: int  # number of readable repeats
    status: str  # worst of the findings: ok, warning or error
    findings: tuple[Fault, ...]  # findings of all repeats


@dataclass(frozen=True)
class Check:
    """The result of checking a whole campaign."""

    campaign: str
    rows: tuple[Row, ...]
    # 0 if the campaign is usable, 2 if its file must change, 3 if the records must change
    exit_code: int
    seen: tuple[str, ...] = ()  # sentences on nonlinearity, differences of repeats, and noise
    joints: JointsCheck | None = None  # check of several joints; None for a single joint

    @property
    def status(self) -> str:
        """The worst status of all channels."""
        return worst(finding for row in self.rows for finding in row.findings)


def check_campaign(path: str | Path, *, allow_outside: bool = False) -> Check:
    """Check every channel of every record of a campaign.

    Args:
        path: The campaign file.
        allow_outside: Whether `files` may point outside the campaign file's folder.

    Raises:
        ConfigError: The campaign file violates the schema.
    """
    path = Path(path)
    spec, folder = read_spec(path), path.resolve().parent
    joints, of_joints, refused = _checked_joints(spec, folder, allow_outside=allow_outside)
    tests = [_checked_test(test, spec, folder, allow_outside=allow_outside) for test in spec.tests]
    of_tables = [("[identify]", fault) for fault in unread(spec)]
    of_tables += [(STRUCTURE, fault) for fault in of_joints]
    rows = [
        *(Row(name, x.channel, "", "", None, 0, x.severity, (x,)) for name, x in of_tables),
        *(row for test in tests for row in test.rows),
    ]
    sources = [source for test in tests for source in test.sources]
    levels = [level for test in tests for level in test.levels]
    by_name = {test.name: test for test in spec.tests}
    repeated = ((name, beside_stated(fault, by_name[name])) for name, fault in held_twice(sources))
    compared = [*repeated, *against_levels(levels), *_unlike_gains(spec.tests, tests)]
    codes = refused.union(*(test.codes for test in tests))
    codes |= {DataError.exit_code} if worst(fault for _, fault in compared) == "error" else set()
    seen = [sentence for test in tests for sentence in test.seen]
    proposed = [sentence for test in tests for sentence in test.proposed]
    rows = tuple(_with(rows, compared))
    return Check(spec.name, rows, min(codes, default=0), (*seen, *proposed), joints)


def _checked_joints(
    spec: CampaignSpec, folder: Path, *, allow_outside: bool
) -> tuple[JointsCheck | None, Sequence[Fault], set[int]]:
    """Return the check of several joints (None if that failed), its findings and exit codes."""
    try:
        joints, faults = check_joints(spec, folder, allow_outside=allow_outside)
    except JbwError as error:
        refused = refusal("matrices", error.what, error.why, error.remedy)
        return None, [refused], {error.exit_code}
    return joints, faults, {ConfigError.exit_code} if worst(faults) == "error" else set()


@dataclass
class _CheckedTest:
    """Results for the repeats of one test, which are read one after another to save memory."""

    rows: list[Row] = field(default_factory=list)
    codes: set[int] = field(default_factory=set)  # exit codes of all findings of the test
    # findings, each with the name of its repeat
    named: list[tuple[str, Fault]] = field(default_factory=list)
    # errors of repeats that cannot be read
    failures: dict[tuple[str, ...], JbwError] = field(default_factory=dict)
    first: list[Record] = field(default_factory=list)  # the first repeat, without its samples
    # all repeats, as long as they fit into the memory
    small_records: list[Record] = field(default_factory=list)
    repeats: int = 0
    held: int = 0  # number of samples in all stored repeats together
    sources: list[ResponseOrigin] = field(default_factory=list)
    levels: list[Level] = field(default_factory=list)
    # name of each repeat, and the gain fitted to it
    gains: list[tuple[str, float]] = field(default_factory=list)
    # for each repeat, the origin of its samples and how they were processed
    provenances: list[Mapping[str, str]] = field(default_factory=list)
    proposed: list[str] = field(default_factory=list)
    seen: list[str] = field(default_factory=list)

    def take(self, record: Record, test: TestSpec, spec: CampaignSpec) -> None:
        """Add one repeat's findings and facts to the results."""
        per_unit = gain_of(force_per_unit(spec), test.driven_by)
        of_one = has_one_mode(spec)
        first = self.small_records[:1] or self.first
        faults = findings(
            record, test, first, per_unit=per_unit, laws=spec.laws, of_one_mode=of_one
        )
        spoilt = worst(faults) == "error"
        stated = () if self.first or spoilt else tuple(_stated(record, test, spec, faults))
        self.codes |= {DataError.exit_code} if spoilt else set()
        self.codes |= {ConfigError.exit_code} if worst(stated) == "error" else set()
        self.named += [(record.name, fault) for fault in (*faults, *stated)]
        self.gains += gain_read(record, test) if of_one and not spoilt else []
        self.sources.append(source_of(record, test))
        self.provenances.append(record.provenance)
        self.repeats += 1
        self.held += record.num_samples * len(record.channels)
        self.small_records = [*self.small_records, record] if self.held <= MOST_SAMPLES else []
        if self.first:
            return
        self.levels += level_of(record, test)
        self.proposed += [] if spoilt else long_records(test.name, test.traits, record)
        # The record is kept without samples, so that a huge campaign is never held in memory.
        empty = {role: x[:0].copy() for role, x in record.channels.items()}
        self.first = [replace(record, channels=empty)]


def _checked_test(
    test: TestSpec, spec: CampaignSpec, folder: Path, *, allow_outside: bool
) -> _CheckedTest:
    """Return the results for all repeats of a test, with one table row per channel."""
    checked = _CheckedTest()
    for item in repeats_of(test, folder, allow_outside=allow_outside):
        if isinstance(item, Record):
            checked.take(item, test, spec)
        elif isinstance(item, ConfigError | DataError):
            checked.failures.setdefault(item.args, item)
        else:
            raise item
    if checked.gains:
        (first,) = checked.first
        checked.named += unlike_gains(checked.gains, first.response, first.source)
    named = gathered(checked.named, checked.repeats)
    faults = [beside_stated(fault, test) for fault in named]
    failures = checked.failures.values()
    checked.codes |= {failure.exit_code for failure in failures}
    checked.seen += blows_seen(test.name, checked.provenances)
    if checked.small_records and worst(faults) != "error":
        checked.seen += seen_in(test, checked.small_records)
    fs = checked.first[0].fs if checked.first and is_sampled(checked.first[0]) else None
    # Errors of unreadable files are reported once per test, in the row of its first channel.
    failed = [refusal("", failure.what, failure.why, failure.remedy) for failure in failures]
    for role, channel in test.channels.items():
        row_faults = sorted(
            [*(fault for fault in faults if fault.channel == role), *failed],
            key=lambda fault: fault.severity,
        )
        unit, repeats = test.units.get(role, ""), checked.repeats
        checked.rows.append(
            Row(test.name, channel, role, unit, fs, repeats, worst(row_faults), tuple(row_faults))
        )
        failed = []
    checked.small_records.clear()
    return checked


def _unlike_gains(
    specs: Sequence[TestSpec], checked: Sequence[_CheckedTest]
) -> Iterator[tuple[str, Fault]]:
    """Yield findings on gains that differ between tests with the same channels and point."""
    setups: dict[tuple[str, ...], dict[str, list[tuple[str, float]]]] = defaultdict(dict)
    for spec, test in zip(specs, checked, strict=True):
        if test.gains:
            (first,) = test.first
            setups[first.response, first.source, spec.point][spec.name] = test.gains
    for (role, source, _), gains in setups.items():
        for name, fault in unlike_tests(gains, role, source):
            yield name, beside_stated(fault, next(spec for spec in specs if spec.name == name))


def gain_read(record: Record, test: TestSpec) -> list[tuple[str, float]]:
    """Return a sweep's name with the gain fitted to it; an empty list for other or faulty records.

    Faults of time, such as a lag, change the sign of the fitted gain.
    """
    driven = any(role in record.channels for role in INPUTS)
    if not (test.traits.is_transient and driven):
        return []
    examined = examined_sweep(record, test.band, test.delay)
    reading = examined.reading
    if examined.faults or reading is None or not reading.holds:
        return []
    if reading.residual > OF_ONE_MODE or np.isnan(reading.gain):
        return []
    return [(record.name, reading.gain)]


def beside_stated(fault: Fault, test: TestSpec) -> Fault:
    """Combine the line that a finding proposes with the line in the test's table.

    A proposed factor is multiplied with the stated one, so that pasting the line does not lose a
    calibration. Files that the test already excludes stay excluded.
    """
    in_file = {MINUS_BASE: BASE} if BASE in test.channels else {}

    def of_roles(match: re.Match[str]) -> str:
        key, role, value = match.groups()
        role = in_file.get(role, role)
        stated = getattr(test, key)
        if key == "scale":
            return f"scale = {toml({**stated, role: stated.get(role, 1.0) * float(value)})}"
        return f"units = {toml({**stated, role: json.loads(value)})}"

    def of_files(match: re.Match[str]) -> str:
        further = [file for file in json.loads(match[1]) if file not in test.exclude]
        return exclude(toml_list([*test.exclude, *further]))

    remedy = EXCLUDE.sub(of_files, OF_ONE_ROLE.sub(of_roles, fault.remedy))
    return replace(fault, channel=in_file.get(fault.channel, fault.channel), remedy=remedy)


def _with(rows: Sequence[Row], faults: Sequence[tuple[str, Fault]]) -> Iterator[Row]:
    """Yield the table's rows; add findings on a test to the row of the channel that they name."""
    for row in rows:
        more = [fault for test, fault in faults if (test, fault.channel) == (row.test, row.role)]
        row_faults = (*more, *row.findings)
        yield replace(row, findings=row_faults, status=worst(row_faults)) if more else row


def as_json(check: Check) -> dict[str, Any]:
    """Return the check of a campaign as plain values, for scripts."""
    channels = [asdict(row) for row in check.rows]
    facts = {"campaign": check.campaign, "status": check.status, "channels": channels}
    joints = {} if check.joints is None else {"joints": check.joints.as_json()}
    return {**facts, "seen": list(check.seen), **joints}


def unread(spec: CampaignSpec) -> Iterator[Fault]:
    """Yield a finding for every setting that has no effect on the campaign's tests."""
    traits, settings = [test.traits for test in spec.tests], spec.settings
    for name, reads in READ_BY.items():
        if name in settings.keys() and not any(map(reads, traits)):
            readers = ", ".join(kind.name for kind in KINDS.values() if reads(kind))
            yield _unread(name, messages.read_by_kinds(readers))
    for kind in settings.fit or ():
        if kind not in {test.kind for test in spec.tests}:
            yield _unread("fit", messages.no_test_of_kind(kind))
    if settings.offsets == "runs" and len(spec.tests) == 1:
        yield _unread("offsets", messages.ONE_RUN)
    sampler = SAMPLERS.get(settings.sampler)
    if settings.num_warmup and sampler and not sampler.draws[0]:
        yield _unread("num_warmup", messages.nothing_to_adapt(sampler.name))
    if settings.coordinates != "auto":
        from jbw.oscillator.laws import laws_named  # This import loads JAX.

        others = {name for law in laws_named(spec.laws) for name in law.coordinates}
        # The choice of the parameters of Teloli et al. has an effect only if the laws offer others.
        chosen = others if settings.coordinates == "paper" else settings.coordinates in others
        if not chosen:
            laws = ", ".join(spec.laws) or "none"
            reason = messages.no_coordinates(laws)
            yield _unread("coordinates", reason)
    drives = {test.driven_by for test in spec.tests}
    is_fed = not FED.keys().isdisjoint(drives) and {"force", ""}.isdisjoint(drives)
    if spec.modal_mass is not None and is_fed:
        yield _unread("modal_mass", messages.NO_FORCE)
    if "gain" in settings.prior and (spec.gain or (spec.modal_mass and not is_fed)):
        yield _unread("prior gain", messages.GAIN_STATED)
    elif "gain" in settings.prior and not any(kind.is_driven for kind in traits):
        yield _unread("prior gain", messages.NO_GAIN)
    if "zeta" in settings.prior and all(kind.is_prescribed for kind in traits):
        yield _unread("prior zeta", messages.NOTHING_FREE)


def _unread(name: str, reason: str) -> Fault:
    return doubt(name, *messages.unread(name, reason))


def findings(
    record: Record,
    test: TestSpec,
    first: Sequence[Record] = (),
    *,
    per_unit: float | None = None,
    laws: Sequence[str] = (),
    of_one_mode: bool = True,
) -> tuple[Fault, ...]:
    """Return all findings on a record, including its differences from the test's first repeat.

    Each remedy is tried before it is proposed.

    Args:
        record: Record in SI units.
        test: Table of its test.
        first: First repeat of its test; empty if the record is the first.
        per_unit: Force per modal mass for one unit of the input, if known.
        laws: Names of the laws of the joint.
        of_one_mode: Whether the campaign says that records show only one mode.
    """
    facts = _contradicting(record, test, first)
    doubtful = partial(_doubtful, per_unit=per_unit, laws=laws, of_one_mode=of_one_mode)

    def look(record: Record, test: TestSpec) -> list[Fault]:
        stated = [*_contradicting(record, test, first), *_too_short(record, test)]
        if worst(stated) == "error":
            return stated
        return [*stated, *doubtful(record, test, first)]

    is_spoilt = worst(facts) == "error" or any(fault.excludes_others for fault in facts)
    doubts = [] if is_spoilt else doubtful(record, test, first)
    # Contradictions between file and campaign are certain, so that their remedies need no trial,
    # except a remedy that cuts the record.
    certain = [fault for fault in facts if not SPAN.search(fault.remedy)]
    uncertain = [
        replace(fault, remedy=in_whole_periods(fault.remedy, record, test.periods))
        for fault in [*(fault for fault in facts if fault not in certain), *doubts]
    ]
    return (*certain, *tried(uncertain, certain, record, test, look, _examined))


def has_one_mode(spec: CampaignSpec) -> bool:
    """Return whether the campaign states a single mode, so that checks of one mode apply."""
    several = spec.structure is not None and len(spec.structure.modes) > 1
    stated = spec.settings.modes
    neighbours = stated - 1 if isinstance(stated, int) else len(stated[1:])
    return not several and neighbours < 1 and spec.assembled is None


def _contradicting(record: Record, test: TestSpec, first: Sequence[Record]) -> list[Fault]:
    """Return errors in a record's channels, and contradictions between record and campaign file."""
    in_order = test.traits.is_curve and not test.traits.is_controlled
    masked = test.gaps == "mask"
    faults = list(inspect(record, masked=masked, is_curve=in_order, delay_s=test.delay))
    fits = _fits_curve if test.traits.is_curve else _fits_test
    contradictions = list(fits(record, test))
    for other in first:
        if not (np.isnan(record.fs) or share_clock(record.fs, other.fs)):
            contradictions.append(messages.two_rates(record.fs, other.name, other.fs))
    faults += [refusal(record.response, *contradiction) for contradiction in contradictions]
    two_sources = test.drive is None and set(INPUTS) <= record.channels.keys()
    if not first and test.traits.is_driven and two_sources:
        faults.append(doubt("input", *messages.TWO_SOURCES))
    return [*faults, *_started_apart(record, test)]


def _doubtful(
    record: Record,
    test: TestSpec,
    first: Sequence[Record],
    *,
    per_unit: float | None,
    laws: Sequence[str],
    of_one_mode: bool,
) -> list[Fault]:
    """Return the warnings about a single record, with remedies that have not been tested yet."""
    faults = [*_of_metres(record, test), *_believable(record, test, per_unit, laws)]
    if of_one_mode and (examined := _examined(record, test)) is not None:
        faults += examined.faults
    elif test.traits.is_free and test.band is not None:
        faults += begins_late(record, test.band, test.settle)
    elif of_one_mode and test.traits.is_broadband and test.traits.is_driven:
        faults += second_resonance(record, test.band, test.delay)
    if first and test.traits.is_transient and test.traits.is_driven:
        faults += noisy_drive(first[0], record)
    return faults


def _examined(record: Record, test: TestSpec) -> Examined | None:
    """Fit one mode to a decay or driven sweep; return None for other kinds of test."""
    if test.traits.is_free:
        return examined_decay(record, test.band, test.settle)
    if test.traits.is_transient and any(x in record.channels for x in INPUTS):
        return examined_sweep(record, test.band, test.delay)
    return None


def _started_apart(record: Record, test: TestSpec) -> Iterator[Fault]:
    """Yield an error if the file states different starting times for drive and response."""
    if not any(role in record.channels for role in INPUTS) or test.traits.is_curve:
        return
    starts = [
        record.provenance.get(f"start of {role}") for role in (record.source, record.response)
    ]
    if None in starts:
        return
    drive, response = (float(str(text).split()[0]) for text in starts)
    # A channel that started later shows later events at the same sample, so that it leads the other
    # channel.
    delay = drive - response
    if abs(delay - test.delay) > 0.5 / record.fs:
        yield refusal(record.response, *messages.started_apart(abs(delay), delay, later=delay < 0))


def _of_metres(record: Record, test: TestSpec) -> Iterator[Fault]:
    """Yield a warning if the motion amounts to metres, as with a wrong unit or rate."""
    response = record.response
    x = record.channels[response]
    if test.traits.is_curve or record.units[response].startswith("rad") or len(x) < FEWEST_SAMPLES:
        return
    order, amplitude = RESPONSES.index(response), float(np.ptp(x)) / 2
    hz = sum(test.band) / 2 if test.band else strongest_line(x, record.fs, lowest=DRIFTS)
    motion = amplitude / (2 * np.pi * hz) ** order if order else amplitude
    if motion > LARGEST_MOTION:
        yield doubt(response, *messages.motion_of_metres(motion, hz if order else 0.0))


def _fits_test(record: Record, test: TestSpec) -> Iterator[FaultText]:
    """Yield the contradictions between a time record and the campaign file."""
    nyquist = record.fs / 2
    if test.band and test.band[1] > nyquist:
        yield messages.band_beyond(test.band[1], nyquist)
    high = [tone for tone in test.tones if 3 * tone >= nyquist]
    if high:
        yield messages.tone_beyond(high[0], nyquist / 3)
    length = record.num_samples / record.fs
    needed = test.dwell * len(test.tones) if test.traits.is_stepped else test.settle
    if needed > length:
        yield messages.too_short(length, needed, is_stepped=test.traits.is_stepped)
    if record.num_samples % test.periods:
        yield messages.broken_periods(record.num_samples, test.periods)


def _fits_curve(record: Record, test: TestSpec) -> Iterator[FaultText]:
    freq = record.channels["frequency"]
    freq = freq[np.isfinite(freq)]
    if "phase" not in record.channels and not test.traits.is_controlled:
        yield messages.AMPLITUDE_ALONE
    if test.band and len(freq) and not np.any((freq >= test.band[0]) & (freq <= test.band[1])):
        yield messages.no_line_in_band((freq.min(), freq.max()), test.band)


def _stated(
    record: Record, test: TestSpec, spec: CampaignSpec, faults: Sequence[Fault]
) -> Iterator[Fault]:
    """Yield warnings about keys that a test states or lacks, judged by its first record.

    Several modes are searched unless one of the record's `faults` explains its residual.

    `jbw look` also reads decays without a band; an identification leaves them out.
    """
    if test.traits.is_free and test.band is None:
        yield from responses.bandless(record, test.settle)
    yield from _too_short(record, test)
    driven = test.traits.is_transient and test.traits.is_driven
    is_whole = spec.structure is None and spec.assembled is None
    is_unnamed = all(fault.leaves is None for fault in faults)
    if driven and test.band is None and is_whole and is_unnamed:
        yield from responses.several_resonances(record)
    if test.traits.is_prescribed:
        loop = forced_loop(record, test.delay)
        yield from travels_freely(loop, spec.laws)
        yield from one_sided(loop)
    if not (test.traits.is_free or test.traits.is_controlled):
        yield from responses.level_unlike(record, test.level)


def _too_short(record: Record, test: TestSpec) -> Iterator[Fault]:
    """Yield an error for a decay with too few independent values in its band."""
    if test.traits.is_free and test.band is not None and test.band[1] < record.fs / 2:
        yield from responses.too_short(record, test.band, test.settle)


def _believable(
    record: Record, test: TestSpec, per_unit: float | None, laws: Sequence[str]
) -> Iterator[Fault]:
    """Yield warnings that need an estimate from the record, which depends on the kind of test."""
    driven = any(role in record.channels for role in INPUTS)
    traits = test.traits
    if traits.is_broadband:
        late = list(untimely(record, test.delay)) if driven else []
        yield from doubts(record, test.band, test.delay, per_unit, signed=not late)
        yield from late
    elif traits.is_transient and driven:
        yield from swapped(record)
        yield from already_moving(record, test.band, test.settle)
    elif traits.is_steady:
        dwell = test.dwell if traits.is_stepped else None
        yield from responses.unsteady(record, test.tones, test.settle, dwell)
    elif traits.is_curve:
        phase = record.channels.get("phase", np.zeros(1))
        if in_degrees := list(responses.phase_in_degrees(phase)):
            # If the phase has a wrong unit, the checks of its sign and of its control mean nothing.
            yield from in_degrees
        elif traits.is_controlled:
            held, tolerance = test.locked_phase if traits.is_locked else None, test.phase_tolerance
            yield from uncontrolled(record, held, tolerance, names_jumps=test.jumps == "doubt")
        else:
            yield from responses.impassive(response_curve(record))
    elif traits.is_prescribed:
        loop = forced_loop(record, test.delay)
        turned = list(responses.gives_energy(loop))
        yield from turned or loop_causes(record, test.delay, test.load_cell, laws)
