"""Checks of every channel after reading: each finds one fault and says how to remedy it."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from jbw.measurement.channels import Reals, noise_of
from jbw.measurement.checks.faults import Fault, doubt, refusal
from jbw.measurement.checks.samples import drop_outs, held_for
from jbw.measurement.records import RESPONSES, Record
from jbw.measurement.spans import exclude_line, kept_part, span_line, start_of
from jbw.report.messages import record_faults as messages

# Beyond any SI value of a vibration test: a flipped bit in a float makes such values.
LARGEST = 1e12
FOLDS = 4  # turns of the frequency along a curve; more turns mean that lines are out of order
CLIP_RUN = 3  # consecutive equal samples at the extreme
BEYOND_NOISE = 4.0  # standard deviations of the noise that a flat peak does not fall by chance
FLATTENED = 2.0  # standard deviations of the noise by which a flattened crest may be higher
NO_CHANCE = 6  # equal samples of a flat peak that noise does not produce
# Converter steps below an extreme, where peaks of an unclipped signal would also lie.
NEAR_TOP = 8.0
SAME = 1e-9  # relative to the range: closer values differ only by round-off
MORE_OFTEN = 2.0  # number of samples at both extremes over the number at any two levels
PILED = 3  # samples at the extremes, beyond one each and beyond the number of samples near them
HELD_RUN = 4  # consecutive equal samples in a changing signal: the recorder filled them in
CHANCE = 1e-6  # probability of mistaking equal samples of a coarse converter for filled ones
FALL = 8.0  # converter steps to a neighbouring sample, more than a slow signal makes
FAR = 10.0  # ranges of all other samples: a logger's code for a lost sample lies that far away
CLIPPED_SHARE = 1e-3  # largest share of clipped samples with which a sweep can be fitted
FEWEST_LEVELS = 256  # distinct values: 8 bits
FEW_SOURCE_LEVELS = 16  # a source of fewer levels is a pulse train, not a clipped signal
LEVELS_FROM = 2**20  # samples used to count levels, because sorting a huge record is slow
PLAUSIBLE = {"displacement": 0.5, "velocity": 20.0, "acceleration": 2e4}  # [m], [m/s], [m/s^2]
GUESS = {"displacement": "mm or um", "velocity": "mm/s or um/s", "acceleration": "mm/s^2"}


def inspect(record: Record, *, masked: bool = False, is_curve: bool = True) -> tuple[Fault, ...]:
    """Return all faults that the checks find in a record, errors first."""
    # With `masked`, samples may be NaN. `is_curve` tells whether a frequency channel holds the
    # lines of a curve.
    faults, lengths = [], {role: len(x) for role, x in record.channels.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"`{role}` has {n}" for role, n in lengths.items())
        faults.append(refusal(next(iter(lengths)), *messages.unequal_lengths(listed)))
    if is_curve and "frequency" in record.channels:
        faults += _ordered(record)
    for role in record.channels:
        faults += _channel(record, role, masked)
    return tuple(sorted(faults, key=lambda fault: fault.severity))


def _channel(record: Record, role: str, masked: bool) -> Iterator[Fault]:
    """Yield the faults of one channel; stop after a fault that makes its numbers meaningless."""
    x = record.channels[role]
    # NaN passes through min and max, which need no copy of a long record.
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
        yield from _signal(record, role)


def _ordered(record: Record) -> Iterator[Fault]:
    freq = record.channels["frequency"]
    freq = freq[np.isfinite(freq)]
    steps = np.diff(freq)
    if not (np.all(freq > 0) and (np.all(steps > 0) or np.all(steps < 0))):
        turns = np.count_nonzero(np.diff(np.sign(steps)))
        back = min(np.count_nonzero(steps < 0), np.count_nonzero(steps > 0))
        # A single step back is one line out of place, not a folded curve.
        is_curve = np.all(freq > 0) and turns <= FOLDS and back > 1
        is_folded = is_curve and "force" in record.channels
        yield refusal("frequency", *(messages.FOLDED if is_folded else messages.UNORDERED))


def _signal(record: Record, role: str) -> Iterator[Fault]:
    x = record.channels[role]
    levels = np.unique(x[:LEVELS_FROM])
    span, largest = np.ptp(x), max(-x.min(), x.max())
    # A source may switch between two values; one that toggles its last bit is dead.
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
    if each > 1:  # other faults show in the values without their repetitions
        yield doubt(role, *messages.held(each, record.fs / each))
        thinned = replace(record, fs=record.fs / each, channels={role: x[first::each]})
        yield from _signal(thinned, role)
        return
    if role in RESPONSES and (lost := drop_outs(x)):
        yield doubt(role, *messages.dropped_out(len(lost), lost[0] / record.fs))
    if is_measured:
        yield from _filled(record, role, float(np.diff(levels).min()))
    if role in RESPONSES or len(levels) > FEW_SOURCE_LEVELS:
        yield from _clipped(record, role, levels)
    if len(levels) < FEWEST_LEVELS and len(x) >= 4 * FEWEST_LEVELS and role in RESPONSES:
        yield doubt(role, *messages.few_levels(len(levels), FEWEST_LEVELS))
    if largest > PLAUSIBLE.get(role, np.inf):
        yield doubt(role, *messages.implausible(role, largest, GUESS[role]))


def _lost(record: Record, role: str) -> Iterator[Fault]:
    """Report samples at one value far from all others, as a logger's -9999 for lost samples."""
    x = record.channels[role]
    ends = float(x.min()), float(x.max())
    others = x[(x > ends[0]) & (x < ends[1])]
    if 2 * len(others) < len(x) or not np.ptp(others) > 0:
        return
    low, high = float(others.min()), float(others.max())
    for end, away in zip(ends, (low - ends[0], ends[1] - high), strict=True):
        at = np.flatnonzero(x == end)
        # A single such sample of a source may be a pulse.
        if away > FAR * (high - low) and (len(at) > 1 or role in RESPONSES):
            first, remedy = at[0] / record.fs, kept_part(record, x == end)
            fault_text = messages.lost_samples(len(at), len(x), end, first, (low, high), remedy)
            yield refusal(role, *fault_text)


def _clipped(record: Record, role: str, levels: Reals) -> Iterator[Fault]:
    """Report samples clipped at an extreme: runs of three or more, or peaks that pile up there."""
    x, fs = record.channels[role], record.fs
    step, noise, runs = float(np.diff(levels).min()), noise_of(x), []
    shortest = 1 if role in RESPONSES and _piles_up(x, step) else CLIP_RUN
    for extreme in (x.max(), x.min()):
        at = np.flatnonzero(x == extreme)
        for run in np.split(at, np.flatnonzero(np.diff(at) > 1) + 1):
            start, stop = int(run[0]), int(run[-1]) + 1
            if stop - start >= shortest and _is_no_crest(x, start, stop, step, noise):
                runs.append((start, stop))
    if not runs:
        return
    share = sum(stop - start for start, stop in runs) / len(x)
    listed = ", ".join(f"{start / fs:.3f}-{stop / fs:.3f} s" for start, stop in sorted(runs)[:4])
    more = f" and {len(runs) - 4} more" if len(runs) > 4 else ""
    clipped = np.zeros(len(x), bool)
    for start, stop in runs:
        clipped[start:stop] = True
    yield Fault(
        "error" if share > CLIPPED_SHARE else "warning",
        role,
        *messages.clipped(share, listed, more, kept_part(record, clipped)),
    )


def _is_no_crest(x: Reals, start: int, stop: int, step: float, noise: float) -> bool:
    r"""Return whether a flat peak is too flat to be the crest of a smooth, rounded, noisy signal.

    A parabola that stays within one converter step for n samples is lower, n samples further, by at
    most $((3n - 1) / (n - 1))^2$ steps; rounding adds one step, and noise flattens a sharper crest.
    Noise larger than a step makes no six samples equal. A peak of fewer than three samples, of
    those that pile up, always counts.
    """
    size = stop - start
    by = size if size >= CLIP_RUN else 1
    outside = [x[i] for i in (start - by, stop - 1 + by) if 0 <= i < len(x)]
    fall = max((float(abs(value - x[start])) for value in outside), default=0.0)
    if size < CLIP_RUN:
        return fall > 2 * step
    if size >= NO_CHANCE and noise > step:
        return True
    of_parabola = ((3 * size - 1) / (size - 1)) ** 2
    return fall > (1 + of_parabola) * (step + FLATTENED * noise) + BEYOND_NOISE * noise


def _piles_up(x: Reals, step: float) -> bool:
    """Return whether single peaks end at the same extreme value more often than by chance.

    A steady sine has more samples near its crest than on it, and a record that repeats itself has
    equal samples at every level.
    """
    ends = beyond = 0
    for depth in (x.max() - x, x - x.min()):
        count = np.count_nonzero(depth == 0)
        near = np.count_nonzero(depth < NEAR_TOP * step) - count
        ends, beyond = ends + count, beyond + max(count - 1 - near, 0)
    if beyond < PILED:
        return False
    span, middle = np.ptp(x), (x.max() + x.min()) / 2
    # Without the quiet end of a record, which has few levels.
    some = x[np.abs(x - middle) > span / 4][:LEVELS_FROM]
    # Values that differ only by round-off count as one level.
    levels = np.unique(np.round(some / (SAME * span)))
    return bool(ends > 2 * MORE_OFTEN * len(some) / len(levels))


def _filled(record: Record, role: str, step: float) -> Iterator[Fault]:
    """Report runs of equal samples within a moving response: blocks that the recorder lost.

    A constant force, such as that of a slider, is not a lost block.
    """
    x, fs = record.channels[role], record.fs
    # First sample of each run, except of the first run of the record.
    changes = np.flatnonzero(np.diff(x)) + 1
    starts, stops = changes, np.append(changes[1:], len(x))
    # Chance makes n p^(length - 1) of n runs as long, where p is the share of runs of two or more.
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
        # A block of zeros jumps at both ends; a block that repeats the last value, at one end.
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
        listed = ", ".join(f"{start / fs:.4g}-{stop / fs:.4g} s" for start, stop in gaps[:4])
        more = f" and {len(gaps) - 4} more" if len(gaps) > 4 else ""
        yield refusal(role, *messages.gaps(listed, more, len(gaps), kept_part(record, standing)))
