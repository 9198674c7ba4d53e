"""Records that a campaign holds twice: the same samples under two tests, or twice within one.

Counted twice they would make every interval too narrow by the root of two, and a record would be
predicted from itself. Links and copies are the same samples, and so is a part of a record.
"""

import hashlib
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from jbw.campaign.tables import TestSpec
from jbw.measurement.checks import Fault, doubt, refusal
from jbw.measurement.records import Record
from jbw.report.messages import campaign_faults as messages

# Of a record, in common with another: a fifth makes intervals too narrow by a tenth; beyond one
# half it is the same record.
DOUBTED, MOST_SHARED = 0.2, 0.5
FORCES = ("restoring_force", "force")


class ResponseOrigin(NamedTuple):
    """Where the response of a record comes from, and what of it a test uses."""

    test: str
    record: str
    role: str  # of what was measured: the response, along a prescribed displacement the force
    digest: str  # of its samples
    channel: tuple[str, str, str]  # checksum of the file, its channel, the repeat in the file
    span_s: tuple[float, float]  # first and last second of it
    band_hz: tuple[float, float]
    tones_hz: tuple[float, ...]


def source_of(record: Record, test: TestSpec) -> ResponseOrigin:
    """Where a record of a test comes from."""
    is_curve, role = test.traits.is_curve, record.response
    if (
        test.traits.is_prescribed
    ):  # whose displacement may well be commanded twice, sample by sample
        role = next((name for name in FORCES if name in record.channels), role)
    roles = sorted(record.channels) if is_curve else [role]
    samples = (np.ascontiguousarray(record.channels[name]).data for name in roles)
    digest = hashlib.sha256()
    for part in samples:
        digest.update(part)
    facts = record.provenance
    repeat = record.name.partition("[")[2]
    channel = (facts.get("sha256", ""), facts.get(f"channel of {role}", role), repeat)
    start = test.span[0] if test.span else 0.0
    length = 0.0 if is_curve else record.num_samples / record.fs
    band = test.band or (0.0, np.inf)
    return ResponseOrigin(test.name, record.name, role, digest.hexdigest(), channel,
                  (start, start + length), band, test.tones)  # fmt: skip


def held_twice(sources: Sequence[ResponseOrigin]) -> Iterator[tuple[str, Fault]]:
    """The second test of every record that a campaign holds twice, and the refusal."""
    by_digest: dict[str, list[ResponseOrigin]] = {}
    by_channel: dict[tuple[str, str, str], list[ResponseOrigin]] = {}
    for source in sources:
        same_samples = by_digest.setdefault(source.digest, [])
        same_channel = by_channel.setdefault(source.channel, []) if source.channel[0] else []
        first = next((other for other in same_samples if _use_the_same(source, other)), None)
        shared = {other: _shared(source, other) for other in same_channel}
        other, share = max(shared.items(), key=lambda pair: pair[1], default=(source, 0.0))
        if first is not None:
            yield source.test, _fault(refusal, source, first, messages.SAME_SAMPLES)
        elif share > DOUBTED:
            severity = refusal if share > MOST_SHARED else doubt
            yield source.test, _fault(severity, source, other, f"shares {share:.0%} with")
        same_samples.append(source)
        same_channel.append(source)


def _fault(
    severity: Callable[..., Fault], source: ResponseOrigin, other: ResponseOrigin, what: str
) -> Fault:
    listed = [f"`{holder.record}` of test `{holder.test}`" for holder in (source, other)]
    return severity(source.role, *messages.twice(listed[0], what, listed[1]))


def _use_the_same(source: ResponseOrigin, other: ResponseOrigin) -> bool:
    """Whether two tests use a common part of a record: bands that meet, and tones if they have."""
    low, high = (max(source.band_hz[0], other.band_hz[0]), min(source.band_hz[1], other.band_hz[1]))
    tones = not (source.tones_hz and other.tones_hz) or set(source.tones_hz) & set(other.tones_hz)
    return low < high and bool(tones)


def _shared(source: ResponseOrigin, other: ResponseOrigin) -> float:
    """Share of the shorter of two parts of a record that the other holds as well."""
    if not _use_the_same(source, other):
        return 0.0
    (first, last), (begin, end) = source.span_s, other.span_s
    shorter = min(last - first, end - begin)
    return max(0.0, min(last, end) - max(first, begin)) / shorter if shorter > 0 else 0.0
