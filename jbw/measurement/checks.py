"""Checks after reading: each finds one fault of a channel and says what to do about it."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jbw.measurement.records import RESPONSES, Record

LARGEST = 1e12  # beyond any SI value of a vibration test: what a flipped bit in a float makes
CLIP_RUN = 3  # equal samples at the extreme, in a row
CLIPPED_SHARE = 1e-3  # of the samples: above it a sweep cannot be fitted
FEWEST_LEVELS = 256  # distinct values: 8 bits
FEW_SOURCE_LEVELS = 16  # a source of few levels is a pulse train, not a clipped signal
LEVELS_FROM = 2**20  # samples looked at to count levels; sorting a huge record is slow
PLAUSIBLE = {"displacement": 0.5, "velocity": 20.0, "acceleration": 2e4}  # [m], [m/s], [m/s^2]
GUESS = {"displacement": "mm or um", "velocity": "mm/s or um/s", "acceleration": "mm/s^2"}


@dataclass(frozen=True)
class Fault:
    """One thing wrong, or doubtful, in one channel.

    Attributes:
        severity: `error` when the record cannot be used, `warning` when it is doubtful.
        channel: The role it was found in.
        what: What was found, with numbers.
        why: Why it matters.
        remedy: What to do.
    """

    severity: str
    channel: str
    what: str
    why: str = ""
    remedy: str = ""


def inspect(record: Record, *, masked: bool = False) -> tuple[Fault, ...]:
    """Everything that the checks below find in a record, errors first.

    Args:
        record: What was read.
        masked: Whether samples that are NaN are left out by their mask instead of refused.
    """
    found: list[Fault | None] = [_lengths(record)]
    for role, x in record.channels.items():
        gaps = _finite(role, x)
        if masked and gaps and np.isfinite(x).sum() > len(x) / 2:
            found.append(_masked(role, x))
            x, gaps = x[np.isfinite(x)], None
        broken = gaps or _magnitude(role, x)
        found.append(broken)
        if not broken and np.isfinite(record.fs):
            found += _signal(role, x, record.fs)
    return tuple(sorted(filter(None, found), key=lambda finding: finding.severity))


def _signal(role: str, x: NDArray[np.float64], fs: float) -> list[Fault | None]:
    """The checks of a sampled signal."""
    dead = _dead(role, x)
    if dead:
        return [dead]
    levels = np.unique(x[:LEVELS_FROM])
    return [_clipped(role, x, fs, levels), _quantised(role, x, levels), _plausible(role, x)]


def _lengths(record: Record) -> Fault | None:
    lengths = {role: len(x) for role, x in record.channels.items()}
    if len(set(lengths.values())) <= 1:
        return None
    listed = ", ".join(f"`{role}` has {n}" for role, n in lengths.items())
    return Fault(
        "error",
        next(iter(lengths)),
        f"Channels must have equal lengths, but {listed} samples.",
        "Cutting the longer one would assume that both begin together.",
        "Export the channels together, or name those that were sampled together.",
    )


def _finite(role: str, x: NDArray[np.float64]) -> Fault | None:
    # NaN passes through min and max, which need no copy of a long record.
    if np.isfinite(_extremes(x)).all():
        return None
    bad = np.flatnonzero(~np.isfinite(x))
    first = ", ".join(str(i) for i in bad[:5])
    return Fault(
        "error",
        role,
        f"Samples must be finite, but {len(bad)} of {len(x)} are not; the first at {first}.",
        "Filling gaps would invent data.",
        "Drop the repeat with exclude, or keep a clean part with span = [start, stop]; kind frf "
        'leaves such lines out with gaps = "mask".',
    )


def _masked(role: str, x: NDArray[np.float64]) -> Fault:
    bad = int((~np.isfinite(x)).sum())
    return Fault(
        "warning",
        role,
        f"{bad} of {len(x)} samples are not finite, and masked.",
        remedy="Nothing, if that is what was meant.",
    )


def _magnitude(role: str, x: NDArray[np.float64]) -> Fault | None:
    if not len(x):
        return Fault("error", role, "The channel is empty.", remedy="Export the record again.")
    largest = _largest(x)
    if largest <= LARGEST:
        return None
    return Fault(
        "error",
        role,
        f"Sample {int(np.abs(x).argmax())} is {largest:.3g} in SI units, beyond any measurement.",
        "A damaged file reads like this.",
        "Copy or export the file again, and check the unit.",
    )


def _extremes(x: NDArray[np.float64]) -> tuple[float, float]:
    return (float(x.min()), float(x.max())) if len(x) else (0.0, 0.0)


def _largest(x: NDArray[np.float64]) -> float:
    """Largest absolute value."""
    return max(map(abs, _extremes(x)))


def ordered(record: Record) -> list[Fault]:
    """Whether the lines of a curve go one way."""
    x = record.channels["frequency"]
    x = x[np.isfinite(x)]
    steps = np.diff(x)
    if np.all(x > 0) and (np.all(steps > 0) or np.all(steps < 0)):
        return []
    return [
        Fault(
            "error",
            "frequency",
            "Frequencies must be positive and go one way.",
            remedy="Sort the lines of the measured FRF and drop repeated ones and 0 Hz.",
        )
    ]


def _dead(role: str, x: NDArray[np.float64]) -> Fault | None:
    lowest, highest = _extremes(x)
    span = highest - lowest
    two_levels = len(np.unique(x[:LEVELS_FROM])) <= 2 and len(x) > 2
    # A source may switch between two values; one that toggles its last bit is dead.
    toggles = two_levels and (role in RESPONSES or span <= 1e-3 * _largest(x))
    if span > 0 and not toggles:
        return None
    return Fault(
        "error",
        role,
        f"The channel is constant at {x[0]:.6g}" + (" within one bit." if span > 0 else "."),
        "A dead sensor or an unconnected input looks like this.",
        "Name the right channel, or drop the repeat with exclude.",
    )


def _clipped(
    role: str, x: NDArray[np.float64], fs: float, levels: NDArray[np.float64]
) -> Fault | None:
    if role not in RESPONSES and len(levels) <= FEW_SOURCE_LEVELS:
        return None
    runs = clipped_runs(x, float(np.diff(levels).min()))
    if not runs:
        return None
    share = sum(stop - start for start, stop in runs) / len(x)
    listed = ", ".join(f"{start / fs:.3f}-{stop / fs:.3f} s" for start, stop in runs[:4])
    more = f" and {len(runs) - 4} more" if len(runs) > 4 else ""
    return Fault(
        "error" if share > CLIPPED_SHARE else "warning",
        role,
        f"{100 * share:.2g} % of the samples are clipped, at {listed}{more}.",
        "A clipped peak reads as softening and as harmonics.",
        "Drop the repeat with exclude, keep a clean part with span, or measure with more range.",
    )


def clipped_runs(x: NDArray[np.float64], step: float) -> list[tuple[int, int]]:
    """Stretches of at least three equal samples at the largest or smallest value, cut off flat.

    A smooth peak of few bits is flat too, but falls off it by about one step of the converter;
    a clipped one falls faster.

    Args:
        x: Samples.
        step: Smallest difference between distinct samples, the converter's step.

    Returns:
        First sample, and one past the last, of each stretch.
    """
    found = []
    for extreme in (x.max(), x.min()):
        at = np.flatnonzero(x == extreme)
        for run in np.split(at, np.flatnonzero(np.diff(at) > 1) + 1):
            start, stop = run[0], run[-1] + 1
            outside = [x[i] for i in (start - 1, stop) if 0 <= i < len(x)]
            fall = max((abs(value - extreme) for value in outside), default=0.0)
            if stop - start >= CLIP_RUN and fall > 2 * step:
                found.append((int(start), int(stop)))
    return sorted(found)


def _quantised(role: str, x: NDArray[np.float64], levels: NDArray[np.float64]) -> Fault | None:
    if len(levels) >= FEWEST_LEVELS or len(x) < 4 * FEWEST_LEVELS or role not in RESPONSES:
        return None
    return Fault(
        "warning",
        role,
        f"The channel has only {len(levels)} distinct values, fewer than {FEWEST_LEVELS}.",
        "Quantisation is then no longer like white noise.",
        "Measure with a smaller range, so that more bits are used.",
    )


def _plausible(role: str, x: NDArray[np.float64]) -> Fault | None:
    largest = _largest(x)
    if largest <= PLAUSIBLE.get(role, np.inf):
        return None
    return Fault(
        "warning",
        role,
        f"The largest {role} is {largest:.3g} in SI units, more than a bolted joint survives.",
        remedy=f"Check the unit: is the file in {GUESS[role]}?",
    )


def worst(findings: Iterable[Fault]) -> str:
    """`error`, `warning` or `ok`: the worst of the findings."""
    severities = {finding.severity for finding in findings}
    return next((s for s in ("error", "warning") if s in severities), "ok")
