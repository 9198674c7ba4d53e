"""Campaign lines that shorten records or leave them out, by a span of time or by file names."""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from glob import escape
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from jbw.measurement.channels import Reals
from jbw.measurement.kinds import Kind
from jbw.measurement.records import RESPONSES, Record
from jbw.measurement.spectra import strongest_line
from jbw.report.messages import reading as messages
from jbw.report.messages import remedies

# number of digits to which the ends of a proposed span are rounded, counted from the first digit of
# the span's length
DIGITS = 6
LEAST = 0.05  # share of a record below which a part is not worth keeping
MOST = 0.1  # share of the response's energy below which a part is not worth keeping
SPAN = "span"  # key of a record's provenance
LONG = 60_000  # number of samples from which a fit takes minutes
DRIFTS = 8  # smallest number of cycles in a record; a motion with fewer cycles is a drift
STILL = 0.005  # Below this fraction of the largest response a structure counts as at rest.
SPARED = 0.1  # A proposal must save at least this fraction of the samples.
PER_CYCLE = 64  # sufficient number of samples per cycle of the strongest frequency


def span_words(span: tuple[float, float]) -> str:
    """Return a span as text, in the form in which the provenance of a record contains it."""
    return f"{span[0]:.9g}-{span[1]:.9g} s"


def start_of(record: Record) -> float:
    """Return the time within its file at which a record begins, from the span that was read [s]."""
    stated = re.match(r"(\d+(?:\.\d+)?(?:e[-+]\d+)?)-", record.provenance.get(SPAN, ""))
    return float(stated[1]) if stated else 0.0


def span_line(start: float, stop: float, begins: float = 0.0) -> str:
    """Return the campaign line that keeps a part of a record, rounded inwards.

    Times count from the record's first sample, which is at `begins` in the file; all in seconds.
    """
    unit = 10.0 ** (np.floor(np.log10(stop - start)) + 1 - DIGITS)
    # Round-off must not change a time that is already whole.
    first = np.ceil((begins + start) / unit - 1e-6) * unit
    last = np.floor((begins + stop) / unit + 1e-6) * unit
    return f"{remedies.PUT} {remedies.span(_written(first), _written(last))}"


def _written(seconds: float) -> float:
    return abs(float(f"{seconds:.9g}"))  # `abs` also removes the sign of -0.0.


def rows_of_span(time: Reals, span: tuple[float, float]) -> slice:
    """Return the samples in a span [s] from the first sample, for unevenly spaced times."""
    half = 0.5 * float(np.nanmedian(np.diff(time))) if len(time) > 1 else 0.0
    since = time - time[0]
    after = np.flatnonzero(since >= span[0] - half)
    first = int(after[0]) if len(after) else len(time)
    beyond = np.flatnonzero(since[first:] >= span[1] - half)
    return slice(first, first + int(beyond[0]) if len(beyond) else len(time))


def unbroken_line(
    time: Reals, breaks: Int[np.ndarray, " break"], begins: float = 0.0, least: float = LEAST
) -> str:
    """Return the campaign line that keeps a part of a record whose times have no break.

    It is the first part at least half as long as the longest; empty if that part contains less than
    a share `least` of the times.
    """
    usual = float(np.median(np.diff(time)))
    starts, stops = np.append(0, breaks + 1), np.append(breaks + 1, len(time))
    # If times jump back, the next part begins after the latest time before the jump.
    latest = np.append(-np.inf, np.maximum.accumulate(time))[starts] + usual / 2
    starts = starts + [
        int(np.searchsorted(time[first:stop], before))
        for first, stop, before in zip(starts, stops, latest, strict=True)
    ]
    lengths = stops - starts
    at = int(np.argmax(2 * lengths >= lengths.max()))
    if lengths[at] < max(2, least * len(time)):
        return ""
    ends = time[starts[at]] - time[0], time[stops[at] - 1] - time[0] + usual / 2
    return span_line(float(ends[0]), float(ends[1]), begins)


def clean_part(
    spoilt: Bool[np.ndarray, " time"], power: Float[np.ndarray, " time"]
) -> tuple[slice, float]:
    """Return the segment without bad samples that constrains a mode best, and its share of power.

    The variance of a frequency or decay rate falls with a segment's energy and squared duration.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[True], spoilt, [True]]).astype(np.int8)))
    starts, stops = edges[::2], edges[1::2]
    so_far = np.concatenate([[0.0], np.cumsum(np.where(spoilt, 0.0, power))])
    held = so_far[stops] - so_far[starts]
    if not len(held):
        return slice(0, 0), 0.0
    at = int(np.argmax(held * (stops - starts) ** 2.0))
    return slice(int(starts[at]), int(stops[at])), held[at] / max(so_far[-1], 1e-300)


def kept_part(record: Record, spoilt: Bool[np.ndarray, " time"]) -> str:
    """Return the remedy for bad samples: keep a span without them, or leave out the record.

    The span is long and contains much of the response's energy, as at a resonance.
    """
    role = next(role for role in (*RESPONSES, *record.channels) if role in record.channels)
    x = record.channels[role]
    # Channels of unequal lengths are reported elsewhere; here only the lengths of segments count.
    is_like = len(x) == len(spoilt)
    finite = np.isfinite(x)
    middle = x[finite].mean() if np.any(finite) else 0.0
    power = np.where(finite, x - middle, 0.0) ** 2 if is_like else np.ones(len(spoilt))
    part, share = clean_part(spoilt, power)
    is_short = part.stop - part.start < max(2, LEAST * len(spoilt))
    if not np.isfinite(record.fs) or is_short or share < MOST:
        return f"{left_out(record)}."
    line = span_line(part.start / record.fs, part.stop / record.fs, start_of(record))
    return remedies.part_or_leave_out(line, exclude_line(record))


def in_whole_periods(remedy: str, record: Record, periods: int) -> str:
    """Return a remedy with its span cut to whole periods of a record that has several.

    The number of periods is stated beside the span. If the span is shorter than a period, the
    remedy is to leave the record out.
    """
    if periods == 1 or (match := remedies.SPAN.search(remedy)) is None:
        return remedy
    first, last = (float(end) for end in match.groups())
    period = record.num_samples / record.fs / periods
    count = int((last - first) / period + 1e-6)
    if count < 1:
        return f"{left_out(record)}."
    keeps = remedies.periods(_written(first), _written(first + count * period), count)
    return remedies.SPAN.sub(keeps, remedy)


def kept_before(record: Record, at_s: float) -> str:
    """Return the remedy for a record that is sound only before a given time [s]."""
    if at_s < LEAST * record.num_samples / record.fs:
        return left_out(record)
    return f"{span_line(0.0, at_s, start_of(record))}, or {exclude_line(record)}"


def left_out(record: Record) -> str:
    """Return the campaign line that leaves out a record."""
    return put_line(exclude_line(record))


def is_by_file(leaving_out: str) -> bool:
    """Return whether a remedy leaves out a record by naming its file."""
    return remedies.EXCLUDE.search(leaving_out) is not None


def put_line(leaving_out: str) -> str:
    """Return the sentence on how to leave out a record, with its campaign line if there is one."""
    words, _, line = leaving_out.partition(": ")
    return f"{remedies.PUT} {line}" if line else f"{words[0].upper()}{words[1:]}"


def exclude_line(record: Record) -> str:
    """Return the line that leaves out a record: by file name if the file has no other record."""
    name = record.name.partition(" + ")[0]
    if name and name in {Path(x).name for x in record.provenance.get("path", "").split("; ")}:
        return remedies.leave_out(toml_list([escape(name)]))
    return remedies.LEAVE_OUT_BY_NUMBER


def of_all(of_records: Sequence[str], count: int) -> str:
    """Return one remedy for `count` records, merged from the remedies of those with a fault.

    It keeps the span that they share and leaves out records without a common span.
    """
    spans = [match.group(1, 2) for remedy in of_records if (match := remedies.SPAN.search(remedy))]
    files = [
        file
        for remedy in of_records
        if (match := remedies.EXCLUDE.search(remedy))
        for file in json.loads(match[1])
    ]
    first = max((float(start) for start, _ in spans), default=0.0)
    last = min((float(stop) for _, stop in spans), default=0.0)
    keeps = remedies.span(first, last) if first < last and len(spans) == len(of_records) else ""
    leaves = remedies.exclude(toml_list(files)) if 0 < len(files) < count else ""
    line = keeps or leaves
    only_line = f"{remedies.PUT} {line}." if line else remedies.LEAVE_OUT_TEST
    if spans and not keeps:
        return only_line
    remedy = remedies.SPAN.sub(keeps, of_records[0])
    if not leaves:
        return remedies.ONLY_LEFT_OUT.sub(only_line, remedies.OR_LEFT_OUT.sub("", remedy))
    remedy = remedies.EXCLUDE.sub(lambda _: leaves, remedy)
    return remedy.replace("the record out:", "the records out:") if len(files) > 1 else remedy


def toml_list(names: Sequence[str | int]) -> str:
    """Return file names or repeat numbers as a TOML list."""
    return json.dumps(list(names), ensure_ascii=False)


def toml_table(values: Mapping[str, Any], **blanks: str) -> str:
    """Return values by role as a TOML table on one line, with words for missing values."""
    stated = {role: json.dumps(x, ensure_ascii=False) for role, x in values.items()}
    return (
        f"{{ {', '.join(f'{role} = {written}' for role, written in (stated | blanks).items())} }}"
    )


def long_records(name: str, traits: Kind, record: Record) -> Iterator[str]:
    """Propose a shorter span and a lower sampling frequency for a record with very many samples.

    `span` cuts samples of rest at either end; a new export lowers a rate of more than 64 samples
    per cycle of the strongest frequency. The time of a fit falls with the number of samples.
    `name` and `traits` belong to the test.
    """
    total = record.num_samples
    if total < LONG or traits.is_curve or traits.is_broadband:
        return
    response = np.nan_to_num(record.channels[record.response])
    # the level at rest, if most of the record is at rest
    response = response - np.median(response)
    size = np.abs(response)
    moving = np.flatnonzero(size > STILL * size.max())
    if not len(moving):
        return
    first, last = int(moving[0]), int(moving[-1])
    span_length = last - first + 1
    proposals = []
    if total - span_length > SPARED * total:
        # Times are rounded outwards, to a power of ten of at most a hundredth of the record.
        step = 10.0 ** np.floor(np.log10(total / record.fs / 100))
        ends = (
            float(f"{np.floor(first / record.fs / step) * step:.12g}"),
            float(f"{np.ceil((last + 1) / record.fs / step) * step:.12g}"),
        )
        part = min(1.0, (ends[1] - ends[0]) * record.fs / total)
        line = span_line(*ends, start_of(record))
        proposals.append(messages.rests(ends[0], ends[1], part, line))
    fs, hz = record.fs, strongest_line(response, record.fs, lowest=DRIFTS)
    every = int(fs / (PER_CYCLE * hz))
    if every > 1:
        proposals.append(messages.oversampled(fs / hz, hz, _ordinal(every), fs / every, every))
    if proposals:
        yield messages.long_record(name, total, proposals)


def _ordinal(number: int) -> str:
    if number < 4:
        return {2: "second", 3: "third"}.get(number, "first")
    ending = {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
    return f"{number}{'th' if 10 < number % 100 < 14 else ending}"
