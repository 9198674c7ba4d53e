"""Checks of every channel after a file is read: each finds one fault and states its remedy.

The thresholds for values held for several samples and for drop-outs are calibrated on records of
`benchmarks/outside`: none of 1,600 sound records of four kinds is accused, and nine of ten
drop-outs that exceed the noise are detected.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from jbw.measurement.channels import OF_NORMAL, Reals
from jbw.measurement.faults.clipping import LEVELS_FROM, clipped
from jbw.measurement.faults.fault import Fault, doubt, refusal
from jbw.measurement.records import INPUTS, RESPONSES, Record
from jbw.measurement.spans import exclude_line, kept_part, span_line, start_of
from jbw.report.messages import record_faults as messages
from jbw.report.messages.message import first_of

# No vibration test reaches this value in SI units; a flipped bit in a float does.
LARGEST = 1e12
# smallest and largest stated delay that accounts for repeated values, divided by the lag that the
# repetition causes
LAGS = 0.5, 2.5
# largest number of reversals of the frequency along a folded response curve; with more reversals,
# lines are out of order
FOLDS = 4
# smallest number of successive equal samples in a changing signal that count as filled in by the
# recorder
HELD_RUN = 4
CHANCE = 1e-6  # probability of mistaking equal samples of a coarse converter for filled-in samples
# Between neighbouring samples, a slow signal changes by fewer converter steps than this.
FALL = 8.0
# Multiple of the other samples' range; a logger's code for lost samples lies at least this far
# away.
FAR = 10.0
FEWEST_LEVELS = 256  # smallest number of distinct values of a response: 8 bits
# A source with fewer distinct values is a pulse train, not a clipped signal.
FEW_SOURCE_LEVELS = 16
PLAUSIBLE = {"displacement": 0.5, "velocity": 20.0, "acceleration": 2e4}  # [m], [m/s], [m/s^2]
GUESS = {"displacement": "mm or um", "velocity": "mm/s or um/s", "acceleration": "mm/s^2"}
# Smallest number of changes of a signal's value from which a repetition of samples is inferred.
# Chance places 24 changes all at even samples with a probability of only 2^-24.
CHANGES = 24
ORDER = 8  # number of samples from which the next one is predicted
MANY = 2**16  # largest number of samples to which the prediction is fitted
FITS = 4  # number of fits of the prediction, each without the outliers of the previous fit
# Samples beyond this number of robust standard deviations are excluded from the prediction's fit.
OUTLYING = 5.0
FAR_OFF = 12.0  # A prediction error beyond this number of robust standard deviations is not noise.
INWARD = 0.45  # largest size of a sample in a drop-out, relative to its predicted value
STRETCHES = 32  # number of segments of a record, each with a separate standard deviation
# smallest number of drop-outs, and their smallest fraction among all outliers
FEWEST, MOST = 5, 0.6


def inspect(
    record: Record, *, masked: bool = False, is_curve: bool = True, delay_s: float = 0.0
) -> tuple[Fault, ...]:
    """Return all faults that the checks find in a record, errors before warnings.

    Args:
        record: A record of any kind.
        masked: Whether samples may be NaN.
        is_curve: Whether a frequency channel contains the frequencies of a response curve.
        delay_s: Stated lag of the response [s], which accounts for values that are held.
    """
    faults, lengths = [], {role: len(x) for role, x in record.channels.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"`{role}` has {n}" for role, n in lengths.items())
        faults.append(refusal(next(iter(lengths)), *messages.unequal_lengths(listed)))
    if is_curve and "frequency" in record.channels:
        faults += _ordered(record)
    for role in record.channels:
        faults += _channel(record, role, masked, delay_s)
    return tuple(sorted(faults, key=lambda fault: fault.severity))


def _channel(record: Record, role: str, masked: bool, delay_s: float) -> Iterator[Fault]:
    """Yield the faults of one channel; stop after a fault that makes the numbers meaningless."""
    x = record.channels[role]
    # `min` and `max` return NaN if any sample is NaN, and need no copy of a long record.
    if len(x) and not np.isfinite([x.min(), x.max()]).all():
        finite = np.isfinite(x)
        bad = np.flatnonzero(~finite)
        if not (masked and len(bad) < len(x) / 2):
            first = ", ".join(str(i) for i in bad[:5])
            leaves_some = not np.isfinite(record.fs) and len(bad) < len(x) / 2
            remedy = (
                messages.masked_or_left_out(exclude_line(record))
                if leaves_some
                else kept_part(record, ~finite)
            )
            yield refusal(role, *messages.not_finite(len(bad), len(x), first, remedy))
            return
        yield doubt(role, *messages.masked(len(bad), len(x)))
        x = x[finite]
    if not len(x):
        yield refusal(role, "The channel is empty.", remedy="Export the record again.")
    elif (largest := max(-x.min(), x.max())) > LARGEST:
        yield refusal(role, *messages.beyond_measurement(int(np.abs(x).argmax()), largest))
    elif np.isfinite(record.fs):
        yield from _signal(record, role, delay_s)


def _ordered(record: Record) -> Iterator[Fault]:
    freq = record.channels["frequency"]
    freq = freq[np.isfinite(freq)]
    steps = np.diff(freq)
    if not (np.all(freq > 0) and (np.all(steps > 0) or np.all(steps < 0))):
        turns = np.count_nonzero(np.diff(np.sign(steps)))
        back = min(np.count_nonzero(steps < 0), np.count_nonzero(steps > 0))
        # A single step backwards is one line out of place, not a folded curve.
        is_curve = np.all(freq > 0) and turns <= FOLDS and back > 1
        is_folded = is_curve and "force" in record.channels
        yield refusal("frequency", *(messages.FOLDED if is_folded else messages.UNORDERED))


def _signal(record: Record, role: str, delay_s: float = 0.0) -> Iterator[Fault]:
    x = record.channels[role]
    levels = np.unique(x[:LEVELS_FROM])
    span, largest = np.ptp(x), max(-x.min(), x.max())
    # A source may switch between two values, but one that only toggles its last bit is dead.
    toggles = len(levels) <= 2 < len(x) and (role in RESPONSES or span <= 1e-3 * largest)
    if span == 0 or toggles:
        leave_out = exclude_line(record)
        yield refusal(role, *messages.constant(x[0], leave_out, toggles=bool(span > 0)))
        return
    if words := list(_lost(record, role)):
        yield from words
        return
    is_measured = role in RESPONSES or role == "restoring_force"
    each, first = held_for(x) if is_measured else (1, 0)
    if each > 1:  # Search for other faults in a copy that contains each repeated value only once.
        lag_s, driven = (each - 1) / 2 / record.fs, set(INPUTS) & record.channels.keys()
        if not LAGS[0] * lag_s <= abs(delay_s) <= LAGS[1] * lag_s:
            line = lag_s if driven or role == "restoring_force" else None
            yield doubt(role, *messages.held(each, record.fs / each, line), excludes_others=True)
        thinned = replace(record, fs=record.fs / each, channels={role: x[first::each]})
        yield from _signal(thinned, role)
        return
    if role in RESPONSES and (lost := drop_outs(x)):
        yield doubt(
            role, *messages.dropped_out(len(lost), lost[0] / record.fs), excludes_others=True
        )
    elif is_measured:
        yield from _filled(record, role, float(np.diff(levels).min()))
    if role in RESPONSES or len(levels) > FEW_SOURCE_LEVELS:
        yield from clipped(record, role, levels)
    if len(levels) < FEWEST_LEVELS and len(x) >= 4 * FEWEST_LEVELS and role in RESPONSES:
        yield doubt(role, *messages.few_levels(len(levels), FEWEST_LEVELS))
    if largest > PLAUSIBLE.get(role, np.inf):
        yield doubt(role, *messages.implausible(role, largest, GUESS[role]))


def _lost(record: Record, role: str) -> Iterator[Fault]:
    """Yield an error for samples at one value far from all others, such as a logger's -9999."""
    x = record.channels[role]
    ends = float(x.min()), float(x.max())
    others = x[(x > ends[0]) & (x < ends[1])]
    if 2 * len(others) < len(x) or not np.ptp(others) > 0:
        return
    low, high = float(others.min()), float(others.max())
    for end, away in zip(ends, (low - ends[0], ends[1] - high), strict=True):
        at = np.flatnonzero(x == end)
        # In a source, a single sample far from all others may be a pulse.
        if away > FAR * (high - low) and (len(at) > 1 or role in RESPONSES):
            first, remedy = at[0] / record.fs, kept_part(record, x == end)
            fault_text = messages.lost_samples(len(at), len(x), end, first, (low, high), remedy)
            yield refusal(role, *fault_text)


def _filled(record: Record, role: str, step: float) -> Iterator[Fault]:
    """Yield faults for runs of equal samples in a moving response: blocks that the recorder lost.

    A constant force, such as that of a slider, is not a lost block.
    """
    x, fs = record.channels[role], record.fs
    # index at which each run of equal samples begins, except the first run of the record
    changes = np.flatnonzero(np.diff(x)) + 1
    starts, stops = changes, np.append(changes[1:], len(x))
    # By chance, n p^(length - 1) of n runs have at least this length, where p is the fraction of
    # runs longer than one sample.
    chance_of_repeat = min(np.mean(stops - starts > 1), 1 - 1e-9)
    by_chance = 1 + np.log(CHANCE / len(x)) / np.log(max(chance_of_repeat, CHANCE))
    long = stops - starts >= max(HELD_RUN, by_chance)
    gaps = []
    for start, stop in zip(starts[long].tolist(), stops[long].tolist(), strict=True):
        if x[start] in (x.max(), x.min()):  # clipped samples are reported elsewhere
            continue
        before = abs(x[start] - x[start - 1])
        after = abs(x[stop] - x[start]) if stop < len(x) else before
        around = x[max(0, start - max(stop - start, 2 * HELD_RUN)) : start]
        # A block of zeros jumps at both ends, a block that repeats the last value only at one end.
        if min(before, after) > FALL * step or (
            role in RESPONSES
            and stop < len(x)
            and after > FALL * step
            and np.std(around) > FALL * step
        ):
            gaps.append((start, stop))
    if gaps and gaps[-1][1] == len(x):
        end = gaps.pop()[0] / fs
        yield doubt(role, *messages.stopped(end, span_line(0.0, end, start_of(record))))
    if gaps:
        standing = np.zeros(len(x), bool)
        for start, stop in gaps:
            standing[start:stop] = True
        listed = first_of([f"{start / fs:.4g}-{stop / fs:.4g} s" for start, stop in gaps])
        yield refusal(role, *messages.gaps(listed, len(gaps), kept_part(record, standing)))


def held_for(x: Reals) -> tuple[int, int]:
    """Return the number of samples for which each value repeats, and the first new value's index.

    The number is the greatest common divisor of the distances between changes; 1 if no value
    is repeated.
    """
    changes = np.flatnonzero(np.diff(x)) + 1
    if len(changes) < CHANGES:
        return 1, 0
    each = int(np.gcd.reduce(np.diff(changes)))
    return each, int(changes[0]) % each


def drop_outs(x: Reals) -> list[int]:
    r"""Return the samples at which a signal drops almost to zero, against its linear prediction.

    $$x_k = \sum_i a_i x_{k-i} + e_k, \qquad |x_k| < 0.45\,|x_k - e_k|, \qquad
      e_k^2 > 12^2 \Bigl(s_k^2 + \tfrac{q^2}{12} \bigl(1 + \sum_i a_i^2\bigr)\Bigr)$$

    where s is the robust scale of e in the segment about k and q the smallest difference of two
    values. The second term is the variance that rounding to q adds; where most samples are rounded
    to zero, s is zero. Impacts push outward as often as inward: if at most 60 % of such samples
    fall inward, the list is empty.
    """
    if len(x) < 16 * ORDER or not np.ptp(x) > 0:
        return []
    unit = x / np.abs(x).max()
    rows = np.lib.stride_tricks.sliding_window_view(unit, ORDER + 1)
    some = rows[:: len(rows) // MANY + 1]
    kept, filtered = np.ones(len(some), bool), np.zeros(ORDER)
    for _ in range(FITS):
        past, now = some[kept, :-1], some[kept, -1]
        ridge = 1e-12 * np.trace(past.T @ past) * np.eye(ORDER)
        filtered = np.linalg.solve(past.T @ past + ridge, past.T @ now)
        error = some[:, -1] - some[:, :-1] @ filtered
        kept = np.abs(error) <= OUTLYING * _scales(error)
    error = rows[:, -1] - rows[:, :-1] @ filtered
    rounding = float(np.min(np.diff(np.unique(unit)))) ** 2 / 12 * (1 + filtered @ filtered)
    far = np.flatnonzero(np.abs(error) > FAR_OFF * np.sqrt(_scales(error) ** 2 + rounding))
    # Samples after a faulty one are predicted from it and do not count.
    first = far[np.diff(far, prepend=-ORDER - 1) > ORDER]
    predicted = rows[first, -1] - error[first]
    inward = np.abs(rows[first, -1]) < INWARD * np.abs(predicted)
    found = (first[inward] + ORDER).tolist()
    return found if len(found) >= max(FEWEST, MOST * len(first)) else []


def _scales(error: Reals) -> Reals:
    """Return, for each sample, the robust standard deviation of the errors in its segment."""
    parts = np.array_split(np.abs(error), min(STRETCHES, max(len(error) // 64, 1)))
    return np.concatenate(
        [np.full(len(part), np.median(part) / OF_NORMAL + 1e-300) for part in parts]
    )
