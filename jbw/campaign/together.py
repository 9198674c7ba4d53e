"""Checks that concern several tests of a campaign: names, points, contradictions, repetitions.

Counting samples twice would make every interval too narrow by the root of two, and a record would
be predicted from itself. Links and copies contain the same samples, and so does a part of a record.
"""

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from jbw.campaign.settings import Identify
from jbw.campaign.tables import Assembly, TestSpec
from jbw.measurement.faults.fault import Fault, doubt, refusal
from jbw.measurement.records import BASE, INPUTS, RESPONSES, Record
from jbw.measurement.spans import LEAST, exclude_line, is_by_file, of_all, put_line, span_line
from jbw.report.messages import campaign_faults as messages
from jbw.report.messages.remedies import LEAVE_OUT_BY_NUMBER

# Levels or records whose ratio exceeds this differ by more than imprecise control explains.
APART = 1.5
# Shared fractions of two records above which the pair is doubtful, and above which it counts as the
# same record. If a fifth is shared, intervals are a tenth too narrow.
DOUBTED, MOST_SHARED = 0.2, 0.5
FORCES = ("restoring_force", "force")


def named(tests: Sequence[TestSpec]) -> Iterator[TestSpec]:
    """Yield the tests with unique names; a test without a name is named by its kind and level."""
    names = {test.name for test in tests}
    for test in tests:
        base = test.kind if np.isnan(test.level) else f"{test.kind} {test.level:g}"
        candidates = (base if n == 1 else f"{base} ({n})" for n in range(1, len(tests) + 2))
        name = test.name or next(name for name in candidates if name not in names)
        names.add(name)
        yield test.model_copy(update={"name": name})


def at_every_point(tests: Sequence[TestSpec]) -> Iterator[TestSpec]:
    """Yield each test, followed by a copy of it for every additional response point."""
    for test in tests:
        if not test.points:
            yield test
            continue
        run = test.run or test.name
        yield test.model_copy(update={"points": {}, "run": run})
        (response, *_) = (role for role in RESPONSES if role in test.channels)
        for point, channel in test.points.items():
            name, channels = f"{test.name} at {point}", {**test.channels, response: channel}
            changes = {"name": name, "point": point, "channels": channels, "points": {}, "run": run}
            yield test.model_copy(update=changes)


def of_others(tests: Sequence[TestSpec], assembly: Assembly) -> Iterator[str]:
    """Yield an error if tests belong to several assemblies, but [assembly] describes only one."""
    names = {test.assembly for test in tests if test.assembly} | {assembly.name or None} - {None}
    if len(names) > 1 and list(assembly.keys()):
        yield messages.several_assemblies(len(names), sorted(map(str, names)))


def on_a_base(tests: Sequence[TestSpec], *, is_weighed: bool, several: bool) -> Iterator[str]:
    """Yield an error if tests on a moving base and tests with other drives have unrelated gains.

    Args:
        tests: The tests of the campaign.
        is_weighed: Whether the modal mass is stated, which determines the gain of a force.
        several: Whether the structure has several modes, whose gains differ between the drives.
    """
    drives = sorted({test.driven_by for test in tests if test.traits.is_driven} - {""})
    if BASE in drives and len(drives) > 1:
        others = [drive for drive in drives if drive != BASE]
        if others != ["force"] or several:
            yield messages.base_beside_others(", ".join(others))
        elif not is_weighed:
            yield messages.BASE_WITHOUT_MASS


def among(tests: Sequence[TestSpec], settings: Identify) -> Iterator[str]:
    """Yield an error for each duplicate name, mode outside all bands, and level without a test."""
    names = [test.name for test in tests if test.name]
    for name in sorted({name for name in names if names.count(name) > 1}):
        yield messages.name_of_several(name, names.count(name))
    bands = [test.band for test in tests if test.traits.is_driven and test.band]
    for freq in settings.modes if isinstance(settings.modes, tuple) and bands else ():
        if not any(low <= freq <= high for low, high in bands):
            yield messages.mode_outside(
                freq, ", ".join(f"{low:g} to {high:g} Hz" for low, high in bands)
            )
    levels = sorted({test.level for test in tests if test.level == test.level})
    listed = ", ".join(f"{level:g}" for level in levels) or "none"
    for level in settings.fit_levels or ():
        if level not in levels:
            yield messages.no_level(level, listed)


class Level(NamedTuple):
    """The level of a test, and the rms values of its first record."""

    test: str
    # kind and channels of the test; only tests that agree in both are compared
    alike: tuple[str, ...]
    role: str  # quantity that drives the test
    level: float
    source_rms: float
    response_rms: float


def level_of(record: Record, test: TestSpec) -> list[Level]:
    """Return the level of a driven test and rms values of its first record; empty if not stated."""
    driven = any(role in record.channels for role in INPUTS)
    if not (test.level > 0 and driven):
        return []
    samples = [record.channels[role] for role in (record.source, record.response)]
    finite = [x[np.isfinite(x)] for x in samples]
    if not all(x.size for x in finite):
        return []
    source, response = (float(np.sqrt(np.mean(x**2))) for x in finite)
    setup = (test.kind, record.source, record.response, test.driven_by, test.point)
    return [Level(test.name, setup, record.source, test.level, source, response)]


def against_levels(levels: Sequence[Level]) -> Iterator[tuple[str, Fault]]:
    """Yield a warning if a test has a larger level than another, but smaller drive and response."""
    for first, second in combinations(levels, 2):
        low, high = sorted((first, second), key=lambda level: level.level)
        apart = high.level > APART * low.level and low.alike == high.alike
        turned = low.source_rms > APART * high.source_rms
        if apart and turned and low.response_rms > high.response_rms:
            ratios = high.level / low.level, low.source_rms / high.source_rms
            found = messages.exchanged(high.test, ratios[0], low.test, ratios[1])
            yield high.test, doubt(high.role, *found)


class ResponseOrigin(NamedTuple):
    """The origin of a record's response, and the part of the record that a test uses."""

    test: str
    record: str
    role: str  # measured quantity: the response, or the force under a prescribed displacement
    digest: str  # digest of the samples
    # checksum of the file, name of the channel in it, number of the repeat in it
    channel: tuple[str, str, str]
    span_s: tuple[float, float]  # first and last second of the samples that are used
    band_hz: tuple[float, float]
    tones_hz: tuple[float, ...]
    leaving_out: str = LEAVE_OUT_BY_NUMBER


def source_of(record: Record, test: TestSpec) -> ResponseOrigin:
    """Return the origin of a record's response: hash of samples, file, channel, span and band."""
    is_curve, role = test.traits.is_curve, record.response
    # Two tests may prescribe the same displacement, sample by sample.
    if test.traits.is_prescribed:
        role = next((name for name in FORCES if name in record.channels), role)
    roles = sorted(record.channels) if is_curve else [role]
    samples = [np.ascontiguousarray(record.channels[name]) for name in roles]
    digest = hashlib.sha256()
    is_dead = not any(part.size and np.ptp(part) for part in samples)
    if is_dead:  # Equal constant channels are no duplicates: another check rejects each of them.
        digest.update(f"{test.name}/{record.name}".encode())
    for part in samples:
        digest.update(part.data)
    facts = record.provenance
    repeat = record.name.partition("[")[2]
    file = "" if is_dead else facts.get("sha256", "")
    channel = (file, facts.get(f"channel of {role}", role), repeat)
    start = test.span[0] if test.span else 0.0
    length = 0.0 if is_curve else record.num_samples / record.fs
    band = test.band or (0.0, np.inf)
    return ResponseOrigin(test.name, record.name, role, digest.hexdigest(), channel,
                  (start, start + length), band, test.tones, exclude_line(record))  # fmt: skip


class Repetition(NamedTuple):
    """A record whose samples also occur in an earlier record of the campaign, at least in part."""

    source: ResponseOrigin
    other: ResponseOrigin
    severity: Callable[..., Fault]
    relation: str  # words on how the second record is related to the first
    is_part: bool  # whether the records are overlapping parts of one channel


def held_twice(sources: Sequence[ResponseOrigin]) -> Iterator[tuple[str, Fault]]:
    """Yield test name and fault for every record that a campaign contains twice."""
    repetitions = list(_repetitions(sources))
    of_test: dict[str, list[ResponseOrigin]] = {}
    for source in sources:
        of_test.setdefault(source.test, []).append(source)
    by_test: dict[tuple[str, Callable[..., Fault]], list[Repetition]] = {}
    for repetition in repetitions:
        by_test.setdefault((repetition.source.test, repetition.severity), []).append(repetition)
    remedies = {key: _remedy(alike, of_test[key[0]]) for key, alike in by_test.items()}
    for source, other, severity, relation, _ in repetitions:
        listed = [f"`{holder.record}` of test `{holder.test}`" for holder in (source, other)]
        remedy = remedies[source.test, severity]
        fault_text = messages.twice(listed[0], relation, listed[1], remedy)
        yield source.test, severity(source.role, *fault_text)


def _repetitions(sources: Sequence[ResponseOrigin]) -> Iterator[Repetition]:
    by_digest: dict[str, list[ResponseOrigin]] = {}
    by_channel: dict[tuple[str, str, str], list[ResponseOrigin]] = {}
    for source in sources:
        same_samples = by_digest.setdefault(source.digest, [])
        same_channel = by_channel.setdefault(source.channel, []) if source.channel[0] else []
        first = next((other for other in same_samples if _use_the_same(source, other)), None)
        shared = {other: _shared(source, other) for other in same_channel}
        other, share = max(shared.items(), key=lambda pair: pair[1], default=(source, 0.0))
        if first is not None:
            yield Repetition(source, first, refusal, messages.SAME_SAMPLES, is_part=False)
        elif share > DOUBTED:
            severity = refusal if share > MOST_SHARED else doubt
            yield Repetition(source, other, severity, messages.shares(share), is_part=True)
        same_samples.append(source)
        same_channel.append(source)


def _remedy(repetitions: Sequence[Repetition], of_test: Sequence[ResponseOrigin]) -> str:
    """Return the remedy for a test's repeated samples: use another part, or leave records out."""
    by_file = Counter(source.leaving_out for source in of_test)
    if any(is_by_file(x.source.leaving_out) and by_file[x.source.leaving_out] > 1
           for x in repetitions):  # fmt: skip
        # Both records are in files of the same name, which `exclude` cannot distinguish.
        return messages.FILES_ONCE
    return of_all([_of_one(repetition) for repetition in repetitions], len(of_test))


def _of_one(repetition: Repetition) -> str:
    """Return the remedy for one repeated record: use its unique part, or leave it out."""
    source = repetition.source
    left_out = f"{put_line(source.leaving_out)}."
    if not repetition.is_part:
        return left_out
    (first, last), (begin, end) = source.span_s, repetition.other.span_s
    before, after = (first, min(last, begin)), (max(first, end), last)
    start, stop = max(before, after, key=lambda part: part[1] - part[0])
    if stop - start < LEAST * (last - first):
        return left_out
    part = span_line(start - first, stop - first, first)
    return messages.rest_or_leave_out(part, source.leaving_out)


def _use_the_same(source: ResponseOrigin, other: ResponseOrigin) -> bool:
    """Return whether two tests use the same frequencies of a record: common bands or tones."""
    low, high = (max(source.band_hz[0], other.band_hz[0]), min(source.band_hz[1], other.band_hz[1]))
    tones = not (source.tones_hz and other.tones_hz) or set(source.tones_hz) & set(other.tones_hz)
    return low < high and bool(tones)


def _shared(source: ResponseOrigin, other: ResponseOrigin) -> float:
    """Return the overlap of two parts of a record, relative to the shorter part."""
    if not _use_the_same(source, other):
        return 0.0
    (first, last), (begin, end) = source.span_s, other.span_s
    shorter = min(last - first, end - begin)
    return max(0.0, min(last, end) - max(first, begin)) / shorter if shorter > 0 else 0.0
