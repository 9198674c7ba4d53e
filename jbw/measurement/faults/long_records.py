"""Records that are longer or finer than needed, and what cutting or decimating would save."""

from collections.abc import Iterator

import numpy as np

from jbw.measurement.kinds import Kind
from jbw.measurement.records import Record
from jbw.measurement.spans import span_line, start_of
from jbw.measurement.spectra import strongest_line
from jbw.report.messages import reading as messages

LONG = 60_000  # number of samples from which a fit takes minutes
DRIFTS = 8  # smallest number of cycles in a record; a motion with fewer cycles is a drift
STILL = 0.005  # Below this fraction of the largest response a structure counts as at rest.
SPARED = 0.1  # A proposal must save at least this fraction of the samples.
PER_CYCLE = 64  # sufficient number of samples per cycle of the strongest frequency


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
