"""Decays that do not begin with free motion: recorded before the blow, or still driven."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from jbw.errors import DataError
from jbw.measurement.channels import Reals, whole_up
from jbw.measurement.demodulation import band_filter, demodulate
from jbw.measurement.faults.fault import Fault, refusal
from jbw.measurement.records import Record, is_sampled
from jbw.measurement.spans import SPAN, span_words, start_of
from jbw.report.messages import decay_faults as messages

# limits relative to the largest response: upper limit before a blow, lower limit within a period
# after it
QUIET, LOUD = 0.1, 0.5
FLAT = 0.05  # largest change of log |X| while a shaker drives the motion steadily
# smallest change of log |X| in the time after the steady part; both times are equally long
FALLS = 0.3
# Smallest ratio of the change of log |X| after the steady part to that within it. At the top of a
# beat this ratio is 8.
TIMES_FLAT = 12.0
FEWEST_VALUES = 16  # smallest number of independent envelope values


class _Beginning(NamedTuple):
    """The envelope of a record in its band: log |X|, and its times [s].

    A sudden change is spread over `across` values; the filter extends `half_s` to either side.
    """

    size: Reals
    time: Reals
    half_s: float
    across: int
    centre_hz: float


BLOW = "blow"  # key of the provenance under which the time of a blow is stored


def after_its_blow(record: Record, band_hz: tuple[float, float] | None) -> Record:
    """Cut a record to start one period after its blow, if it was quiet before the blow.

    The quiet time that a trigger keeps before the blow is no free decay. The provenance states the
    time of the blow and the remaining span. Nothing is cut if no motion follows.
    """
    x = record.channels[record.response]
    if band_hz is None or not (is_sampled(record) and np.isfinite(x).all() and np.any(x)):
        return record
    course = _course(record, band_hz, 0.0)
    onset = None if course is None else late_blow(record, course)
    if course is None or onset is None:
        return record
    first = whole_up((onset + 1 / course.centre_hz) * record.fs)
    after = np.abs(x[first : 2 * first - round(onset * record.fs)])
    # If the motion falls below this limit within a period, its maximum is a single bad sample, or a
    # hard blow without free motion.
    if not after.size or after.max() < QUIET * np.abs(x).max():
        return record
    begins = start_of(record)
    span = begins + first / record.fs, begins + record.num_samples / record.fs
    known = {BLOW: f"{begins + onset:.3g} s", SPAN: span_words(span)}
    channels = {role: values[first:] for role, values in record.channels.items()}
    return replace(record, channels=channels, provenance={**record.provenance, **known})


def blows_seen(test: str, records: Sequence[Mapping[str, str]]) -> list[str]:
    """Return a sentence on records that were cut to start after their blow, if any was cut."""
    blows = sorted((p[BLOW] for p in records if BLOW in p), key=lambda blow: float(blow.split()[0]))
    if not blows:
        return []
    return [messages.read_from_blow(test, blows[0], blows[-1], len(blows), len(records))]


def begins_late(record: Record, band_hz: tuple[float, float], settle_s: float) -> Iterator[Fault]:
    """Yield an error for a record that does not begin with free motion."""
    course = _course(record, band_hz, settle_s)
    if course is None:
        return
    onset = late_blow(record, course)
    if onset is None:
        yield from still_driven(record, course)
        return
    begins, settle = course.time[0] - course.half_s, _rounded_up(onset + 1 / course.centre_hz)
    yield refusal(record.response, *messages.late_blow(onset - begins, begins, settle))


def _course(record: Record, band_hz: tuple[float, float], settle_s: float) -> _Beginning | None:
    x = record.channels[record.response][round(settle_s * record.fs) :]
    try:
        chosen = band_filter(band_hz, record.fs)
        time, envelope = demodulate(x - np.mean(x), chosen)
    except DataError:
        return None
    time, size = time[:: chosen.step], np.abs(envelope[:: chosen.step])
    if len(time) < FEWEST_VALUES or not np.all(size > 0):
        return None
    across = -(-chosen.half // chosen.step)
    half_s = chosen.half / record.fs
    return _Beginning(np.log(size), settle_s + time, half_s, across, chosen.centre_hz)


def late_blow(record: Record, course: _Beginning) -> float | None:
    """Return the time of the blow [s] if the record begins before this blow; otherwise None."""
    begins = course.time[0] - course.half_s
    onset = _onset(record.channels[record.response], record.fs, begins, course.centre_hz)
    if onset is not None:
        return onset
    size = course.size
    peak = int(np.argmax(size))
    # A beat of two modes also rises, but not from a quiet state within the length of the filter.
    before = size[: max(peak - course.across, 0)]
    if len(before) <= course.across or before.max() > size[peak] + np.log(QUIET):
        return None
    return float(course.time[peak])


def _onset(x: Reals, fs: float, begins: float, centre_hz: float) -> float | None:
    """Return the time at which a quiet record becomes loud within one period [s]; None if none."""
    first, period = round(begins * fs), whole_up(fs / centre_hz)
    size = np.abs(x[first:] - np.median(x[first:]))
    size = size / size.max()
    blow = int(np.argmax(size > QUIET))
    if blow < period or size[blow : blow + period].max() < LOUD:
        return None
    return begins + blow / fs


def still_driven(record: Record, course: _Beginning) -> Iterator[Fault]:
    """Yield an error for a record that begins with driven, steady motion and decays later."""
    size = course.size
    best = None
    for held in range(course.across, (len(size) - course.across) // 2 + 1):
        steady, after = size[:held], size[held + course.across : 2 * held + course.across]
        flat = float(np.ptp(steady))
        if flat > FLAT:
            break
        fall = float(after[0] - after[-1])
        if fall > FALLS and fall > TIMES_FLAT * flat:
            best = held
    if best is None:
        return
    # The end of the longest steady part is the end of the drive.
    end = course.time[best - 1] + 2 * course.half_s
    yield refusal(record.response, *messages.still_driven(course.time[best - 1], _rounded_up(end)))


def _rounded_up(seconds: float) -> str:
    unit = 10.0 ** (np.floor(np.log10(seconds)) - 1)
    return f"{np.ceil(seconds / unit * (1 - 1e-12)) * unit:.2g}"
