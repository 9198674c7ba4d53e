"""Checks whether times are evenly spaced; rates to the precision of the printed digits.

A time that is printed to a quantum q lies within q / 2 of its true instant, or of that instant
less q / 2 if digits are cut off. A column is evenly spaced if one line $t_0 + n / f_s$ passes
within that distance of every time.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from jbw.errors import DataError, JbwError
from jbw.measurement.channels import Reals
from jbw.measurement.files.tree import Leaf
from jbw.measurement.resampled import proposed_rate, resample_line
from jbw.measurement.spans import unbroken_line
from jbw.report.messages import reading as messages
from jbw.report.messages.remedies import PUT
from jbw.units import factor_of

REGULARITY = 1e-3  # largest deviation of a sample from the even grid, in sampling intervals
# A record's rate is rounded if the rounding shifts all times by fewer sampling intervals than this.
ROUND = 1e-6
# Largest resolution of printed times, in sampling intervals, that may explain uneven times. A lost
# sample shifts later times by half an interval from every straight line, and must not be hidden.
COARSEST = 0.4
# numbers of decimals that are tried for times, in the unit in which the times are printed
DECIMALS = range(-3, 13)
SIGNIFICANT = range(3, 10)  # numbers of significant digits that are tried for times
# An interval with at least this number of digits may be rounded, because universal files print six
# digits.
STATED = 6
SLOPES = 60  # number of slopes tried for a line through all times
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
EPOCH = (9.4e8, 4.2e9)  # range of seconds since 1970 for the years 2000 to 2100
# slowest plausible sampling rates [Hz] if times have no unit: for times with decimals, as in
# quasi-static records, and for times in whole numbers
SLOWEST, SLOWEST_COUNTED = 1.0, 20.0
# A part between gaps that exceeds this fraction of a record is kept, rather than resampled.
MOST = 0.5


def stated_rate(fs: float) -> float:
    """Return the round rate whose interval has the printed digits, or else the given rate.

    A file that states 0.000976562 s means 1024 Hz, and 1e-5 s is 100 kHz apart from round-off. An
    interval of fewer than six digits is exact: 0.0004096 s is 2441.40625 Hz.
    """
    interval = float(f"{1 / fs:.15g}")
    mantissa, _, exponent = f"{interval:.14e}".partition("e")
    digits = len(mantissa.replace(".", "").rstrip("0"))
    half = 0.5 * 10.0 ** (int(exponent) + 1 - (digits if digits >= STATED else 15))
    same = (near for near in _round_rates(fs) if abs(1 / near - interval) <= half * (1 + ROUND))
    return next(same, fs)


def sampling_frequency(
    time: NDArray[np.number], name: str = "time", *, begins: float = 0.0, factor: float = 1.0
) -> tuple[float, float]:
    """Return the sampling frequency of evenly spaced times [Hz], rounded and unrounded.

    The rounded rate is the nearest multiple of 1 Hz, or else of 0.1 Hz, if it agrees with every
    printed digit. Otherwise it is the rate of the least-squares line through all times if this line
    is within half of the last digit of every time, or else that of the nearest line that is.

    Args:
        time: Times of one axis, in their printed unit.
        name: Name of the times in the file, for messages.
        begins: Start of the times in their file, for remedies of uneven times [s].
        factor: Factor from the unit of the times to seconds.

    Raises:
        DataError: Times are lost, fall, pause or jitter, or have too few digits.
    """
    if time.ndim != 1 or len(time) < 2:
        raise DataError(
            f"Time channel `{name}` must contain at least two samples on one axis, but its shape "
            f"is {time.shape}.",
            remedy="Name the channel that contains the times, or export the times as one column.",
        )
    seconds = np.asarray(time, np.float64) * factor
    every_quanta = [quanta * factor for quanta in _quanta(time)]
    if fs := _coarse_rate(seconds, every_quanta):
        raise DataError(
            f"Time channel `{name}` has too few digits to distinguish samples that are "
            f"{1 / fs:.3g} s apart.",
            why="In times with too few digits, a lost sample cannot be detected.",
            remedy=messages.coarse_times(fs),
        )
    _require_steps(seconds, name, begins)
    mean_rate = float((len(seconds) - 1) / (seconds[-1] - seconds[0]))
    bit = 4 * np.spacing(np.abs(seconds).max())
    exact = np.full(len(seconds), bit)
    if _line_within(seconds, exact + ROUND / mean_rate, 1 / mean_rate, slopes=1):
        # The printed times are exact, so an interval of 0.033 s is not a rounded 1 / 30.3 s.
        distances = [exact]
    else:
        distances = [np.where(q * mean_rate > COARSEST, 0.0, q / 2) + bit for q in every_quanta]
    for near in _round_rates(mean_rate):
        for within in distances:
            if _line_within(seconds, within + ROUND / near, 1 / near, slopes=1):
                return near, mean_rate
    # All times together determine the rate better than the rounded first and last times.
    if len(distances) > 1:
        n = np.arange(len(seconds)) - (len(seconds) - 1) / 2
        mean_rate = float(np.sum(n**2) / np.sum(n * (seconds - seconds.mean())))
    for within in distances:
        interval = _line_within(seconds, within + REGULARITY / mean_rate, 1 / mean_rate)
        if interval is not None:
            fs = mean_rate if interval == 1 / mean_rate else 1 / interval
            return fs, fs
    off = np.abs((seconds - seconds[0]) * mean_rate - np.arange(len(seconds)))
    i = int(np.argmax(off > REGULARITY + np.max(distances, axis=0) * mean_rate))
    raise DataError(
        f"Time channel `{name}` must be evenly spaced within {REGULARITY:g} of an interval at "
        f"{mean_rate:.6g} Hz, but sample {i} is {off[i]:.3g} off and the worst {off.max():.3g}.",
        why=messages.EVEN,
        remedy="A sampling frequency `fs` would be wrong for these times: put under [[test]] "
        f"`resample = {proposed_rate(seconds):.9g}`; jbw then states the error of the resampling.",
    )


def coarse_rate(time: NDArray[np.number], factor: float = 1.0) -> float | None:
    """Return the mean rate [Hz] of times with too few digits to distinguish samples; else None.

    Such times repeat or skip a quantum, but lie within half a quantum of a line. The rate is
    rounded to the digits that the times support.
    """
    return _coarse_rate(
        np.asarray(time, np.float64) * factor, [quanta * factor for quanta in _quanta(time)]
    )


def _coarse_rate(seconds: Reals, every_quanta: Sequence[Reals]) -> float | None:
    lasts = float(np.ptp(seconds))
    if len(seconds) < 3 or not (np.isfinite(lasts) and lasts > 0) or _is_exact(seconds):
        return None
    interval = lasts / (len(seconds) - 1)
    for quanta in every_quanta:
        quantum, within = float(quanta.max()), quanta / 2 + REGULARITY * interval
        if COARSEST * interval < quantum < lasts / 2 and _line_within(seconds, within, interval):
            return float(f"{1 / interval:.{max(1, int(np.log10(lasts / quantum)))}g}")
    return None


def _is_exact(seconds: Reals) -> bool:
    """Return whether all time steps are equal within round-off."""
    steps = np.diff(seconds)
    return float(np.ptp(steps)) <= REGULARITY * abs(float(np.median(steps)))


def on_clock(item: Leaf, time: NDArray[np.number], unit: str) -> Leaf:
    """Return a channel with the rate and start of its own column of evenly spaced times.

    Uneven times, an unknown unit, and whole numbers without a unit leave the channel unchanged.
    """
    if not unit and are_whole_numbers(time):
        return item
    try:
        factor = factor_of(unit or "s", "time")
        fs, _ = sampling_frequency(time, factor=factor)
    except JbwError:
        return item
    return replace(item, fs=fs, start_s=float(time[0]) * factor)


def are_whole_numbers(time: NDArray[np.number]) -> bool:
    """Return whether all times are whole numbers, as in counters or small units."""
    values = np.asarray(time, np.float64)
    return bool(len(values) > 2 and np.isfinite(values).all() and np.all(values == np.rint(values)))


def time_unit(time: NDArray[np.number]) -> tuple[str, bool]:
    """Return the likeliest unit of times without a unit ("" for counts), and whether it is certain.

    It is the largest unit that gives the rate of a recorder. For times of a computer's clock it is,
    with certainty, the unit in which they lie in this century.
    """
    values = np.asarray(time, np.float64)
    steps = np.diff(values[np.isfinite(values)])
    is_whole = are_whole_numbers(time)
    if not len(steps) or (is_whole and np.all(steps == 1)):
        return "" if is_whole else "s", False
    of_computer = [unit for unit in SECONDS if EPOCH[0] < values[0] * SECONDS[unit] < EPOCH[1]]
    if of_computer:
        return of_computer[0], True
    usual, least = float(np.mean(np.abs(steps))), SLOWEST_COUNTED if is_whole else SLOWEST
    return next((unit for unit, s in SECONDS.items() if usual * s * least <= 1), "ns"), False


def _round_rates(fs: float) -> tuple[float, ...]:
    """Return the multiples of 1 Hz and of 0.1 Hz nearest to a rate."""
    # Division by 10 is used instead of multiplication by 0.1, because it keeps 51.2 exactly 51.2.
    return tuple(near for near in (float(round(fs)), round(10 * fs) / 10) if near > 0)


def _line_within(time: Reals, within: Reals, interval: float, slopes: int = SLOPES) -> float | None:
    """Return the step of an even grid that stays within given distances of all times; else None.

    The excess over the distances is convex in the interval, so that Newton's steps towards its zero
    never pass beyond it.
    """
    n, before, round_off = np.arange(len(time)), 0, 4 * np.spacing(np.abs(time).max())
    for _ in range(slopes):
        late = time - n * interval
        above, below = int(np.argmax(late - within)), int(np.argmin(late + within))
        excess = (late - within)[above] - (late + within)[below]
        slope = below - above
        if excess <= round_off:
            return interval
        if slope == 0 or slope * before < 0:
            return None
        interval, before = interval - float(excess) / slope, slope
    return None


def _quanta(time: NDArray[np.number]) -> tuple[Reals, Reals]:
    """Return the size of each time's last printed digit, for fixed decimals and for fixed digits.

    `%.6f` writes the same number of decimals everywhere; `%.7g` writes 9.876953 and 10.00195, so
    that later times are rounded more. Times of a binary file have the resolution of their type.
    """
    exact = np.asarray(time, np.float64)
    if not np.isfinite(exact).all():
        return np.zeros(len(exact)), np.zeros(len(exact))
    is_float = np.issubdtype(time.dtype, np.floating)
    bit = float(np.spacing(np.abs(time).max())) if is_float else 0.0
    size = np.abs(exact)
    magnitude = np.power(10.0, np.floor(np.log10(np.where(size > 0, size, 1.0))) + 1)
    significant = (np.where(size > 0, magnitude / 10.0**digits, 0.0) for digits in SIGNIFICANT)
    decimal = (np.full(len(exact), 10.0**-decimals) for decimals in DECIMALS)
    none = np.zeros(len(exact))
    of_digits, of_decimals = (
        next((q for q in family if _are_whole(exact, q, bit)), none)
        for family in (significant, decimal)
    )
    return np.maximum(of_decimals, bit), np.maximum(of_digits, bit)


def _are_whole(values: Reals, quanta: Reals, error: float) -> bool:
    """Return whether values are multiples of their quanta, within their error."""
    # Some of the values suffice to reject most of the tried resolutions quickly.
    some = slice(None, None, 1 + len(values) // 1000)
    for part in (some, slice(None)):
        x, q = values[part], quanta[part]
        steps = np.divide(x, q, out=np.zeros(len(x)), where=q > 0)
        room = 1e-6 + np.divide(error, q, out=np.zeros(len(x)), where=q > 0)
        nearest = np.round(steps)
        # Times that are all much smaller than a resolution do not count as multiples of that
        # resolution.
        if np.any(np.abs(steps - nearest) > np.minimum(room, 1e-3)) or not nearest.any():
            return False
    return True


def _require_steps(time: Reals, name: str, begins: float) -> None:
    if not np.isfinite(time).all():
        first = int(np.flatnonzero(~np.isfinite(time))[0])
        raise DataError(f"Time channel `{name}` must be finite, but sample {first} is not.")
    steps = np.diff(time)
    backward = np.flatnonzero(steps <= 0)
    if len(backward):
        i = int(backward[0]) + 1
        line = unbroken_line(time, backward, begins)
        raise DataError(
            f"Time channel `{name}` must increase, but sample {i} ({time[i]:.9g} s) "
            f"follows {time[i - 1]:.9g} s.",
            why="Sorting or dropping samples silently could hide a damaged file.",
            remedy=f"Export the record again, or keep a part. {line}." if line else messages.EXPORT,
        )
    usual = float(np.median(steps))
    gaps = np.flatnonzero(steps > 1.5 * usual)
    if len(gaps):
        listed = ", ".join(f"{time[i]:.6g}-{time[i + 1]:.6g} s" for i in gaps[:5])
        line = unbroken_line(time, gaps, begins)
        resample = resample_line(time)
        remedy = f"{line}, or {resample}." if line else f"{PUT} {resample}."
        if line and not unbroken_line(time, gaps, begins, least=MOST):
            remedy = messages.resample_or_part(resample, line.partition(": ")[2])
        raise DataError(
            f"Time channel `{name}` must be evenly spaced, but has {len(gaps)} gap(s): {listed}.",
            why=messages.EVEN,
            remedy=remedy,
        )
