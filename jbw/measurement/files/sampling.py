"""The sampling frequency of a file's channels from all its statements, and the rows to read."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from jbw.errors import ConfigError, DataError
from jbw.measurement.files.clocks import (
    are_whole_numbers,
    sampling_frequency,
    stated_rate,
    time_unit,
)
from jbw.measurement.files.paths import select
from jbw.measurement.files.tree import WHOLE, Contents, Leaf, load, names
from jbw.measurement.records import COUNTED, si_of
from jbw.measurement.resampled import at_rate, from_uneven
from jbw.measurement.spans import rows_of_span, toml_table
from jbw.report.messages import reading as messages
from jbw.report.messages.remedies import PUT
from jbw.units import TIME, plain

SLOWEST, FASTEST = 1e-6, 1e12  # range of plausible sampling frequencies of recorders [Hz]
SAME_RATE = 2e-5  # largest relative difference between the rates of one record's channels
ADRIFT = 1.0  # largest deviation of a sample's time from the even grid, in sampling intervals
Repeats = list[NDArray[np.float64]]
Sources = Mapping[str, list[Leaf]]  # the arrays that each role's path selects


@dataclass(frozen=True)
class Wanted:
    """The options for reading a file; see `jbw.measurement.files.read.read`."""

    channels: Mapping[str, str] | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    fs: float | str | None = None
    scale: Mapping[str, float] = field(default_factory=dict)
    repeats: str = "files"
    span: tuple[float, float] | None = None
    amplitudes: str = "peak"
    remove_mean: bool = False
    window_s: float | None = None
    lines_hz: tuple[float, ...] = ()
    conjugate: bool = False
    # rate [Hz] to which channels of several rates or with uneven clocks are resampled
    resample: float | None = None
    # the source of the units if file and campaign differ: "file", or "mine" (the campaign)
    units_are: str = "file"
    # Sensitivities in volts per unit, such as "100 mV/g", of sensors whose channels are in volts.
    sensitivity: Mapping[str, str] = field(default_factory=dict)
    is_timed: bool = True  # whether samples must have times; samples of a force loop need none


def sampling_of(contents: Contents, sources: Sources, request: Wanted) -> tuple[float, str, slice]:
    """Return sampling frequency [Hz] (NaN for a measured FRF), its origin, and the samples to read.

    All statements of the frequency in the file and the campaign must agree.
    """
    if "frequency" in sources:
        fs = float("nan")
        return fs, "none: a measured FRF", cut(fs, request.span)
    of_channels = {
        f"`{(request.channels or {}).get(role, role)}`": item.fs
        for role, items in sources.items()
        for item in items
        if item.fs is not None
    }
    of_file = {} if contents.fs is None else {"the file": contents.fs}
    timed, part = _timed(sources, request)
    rates = {**timed, **(of_channels or of_file)}
    if request.fs is not None:
        fs, source = _stated_fs(contents, request.fs)
        rates = {source: fs, **rates}
    if not rates and not request.is_timed:
        return 1.0, COUNTED, cut(1.0, request.span)
    if not rates:
        raise _without_rate(contents, sources, request)
    (source, fs), *others = rates.items()
    if not SLOWEST <= fs <= FASTEST:
        raise DataError(
            f"the sampling frequency must lie between {SLOWEST:g} and {FASTEST:g} Hz, but {source} "
            f"is {fs:g} Hz.",
            remedy="Correct `fs`, or the unit of the times.",
        )
    for other, value in others:
        if abs(value - fs) > SAME_RATE * fs:
            raise DataError(
                f"sampling frequencies must agree, but {source} is {fs:.7g} Hz "
                f"and {other} is {value:.7g} Hz.",
                remedy="Name channels of one rate, or put under [[test]] a rate to which all "
                f"channels are resampled: `resample = {min(rates.values()):.9g}`.",
            )
    if "time" not in sources:
        _agree_with_unused_time(contents, sources, request, fs)
    fs_used = fs if request.fs is not None else stated_rate(fs)
    rounded = "" if fs_used == fs else f", snapped from {fs:.10g} Hz"
    part = part or cut(fs_used, request.span)
    return fs_used, f"{fs_used:.10g} Hz from {source}{rounded}", part


def on_even_grid(
    rows: Repeats, item: Leaf, contents: Contents, sources: Sources, request: Wanted
) -> tuple[Repeats, str]:
    """Resample a channel's rows to the requested rate and span; describe the method."""
    fs = request.resample or 0.0
    resampled: Repeats = []
    how = ""
    for row in rows:
        channel_fs, time = _own_clock(row, item, contents, sources, request)
        part = WHOLE if time is None or request.span is None else rows_of_span(time, request.span)
        if not np.isfinite(row[part]).all():
            lost = int(np.flatnonzero(~np.isfinite(row))[0])
            raise DataError(
                f"samples that are resampled must be finite, but sample {lost} is not.",
                remedy="Export the record again, or leave the record out with `exclude`.",
            )
        if time is None:
            y, how = at_rate(row, channel_fs, fs)
            y = y[cut(fs, request.span)]
        else:
            begins = request.span[0] if request.span else 0.0
            y, how = from_uneven(row[part], time[part] - time[0], fs, begins)
        resampled.append(y)
    return resampled, how


def _own_clock(
    row: NDArray[np.float64], item: Leaf, contents: Contents, sources: Sources, request: Wanted
) -> tuple[float, NDArray[np.float64] | None]:
    """Return the rate of a channel [Hz], and the times of its samples if they are uneven."""
    if item.fs is not None:
        return item.fs, None
    for clock in sources.get("time", ()):
        printed = np.ravel(load(clock))
        if len(printed) != len(row):
            continue
        time = np.asarray(printed, np.float64) * _seconds_in(clock, printed, request)
        times = time if request.span is None else time[rows_of_span(time, request.span)]
        if not np.isfinite(times).all() or np.any(np.diff(times) <= 0):
            sampling_frequency(times)  # This call raises an error that says where the times fail.
        try:
            return sampling_frequency(time)[0], None
        except DataError:
            return 0.0, time
    if request.fs is not None:
        return _stated_fs(contents, request.fs)[0], None
    if contents.fs is not None:
        return contents.fs, None
    raise _without_rate(contents, sources, request)


def _without_rate(contents: Contents, sources: Sources, request: Wanted) -> DataError:
    """Return the error for an unknown sampling frequency, with columns that may be times."""
    times = [name for name, _ in _unused_times(contents, sources)]
    remedy = messages.STATE_RATE
    if times:
        remedy = messages.times_or_rate(_with_time(times[0], request))
    return DataError(
        "the sampling frequency is missing.",
        why="The file does not state the sampling frequency, and the frequency cannot be guessed.",
        remedy=remedy,
    )


def _with_time(name: str, request: Wanted) -> str:
    """Return the requested channels and a column of times, formatted for a campaign file."""
    return toml_table({"time": name, **(request.channels or {})})


def _agree_with_unused_time(
    contents: Contents, sources: Sources, request: Wanted, fs: float
) -> None:
    """Raise a DataError if an unused column of times contradicts the sampling frequency."""
    for name, item in _unused_times(contents, sources):
        # Times are in their stated unit; without one, they are taken as seconds.
        try:
            seconds = load(item) * si_of("time", item.unit or "s")[0]
            steps = np.diff(seconds) * fs
        except ConfigError:  # Times in an unknown unit do not determine a rate.
            continue
        off = np.abs((seconds - seconds[0]) * fs - np.arange(len(seconds)))
        if len(steps) < 2 or not np.all(np.isfinite(steps)) or np.median(steps) <= 0:
            continue
        # A clock in another unit, or a sample counter, differs by a power of ten and is ignored.
        if 0.5 < np.median(steps) < 2.0 and off.max() > ADRIFT:
            raise DataError(
                f"the times in `{name}` of the file contradict {fs:g} Hz: sample "
                f"{int(off.argmax())} is {off.max():.3g} intervals away from its expected time.",
                why="The rate is wrong, or the samples are not evenly spaced.",
                remedy=f"{PUT} `channels = {_with_time(name, request)}`, and take `fs` out.",
            )


def _unused_times(contents: Contents, sources: Sources) -> Iterator[tuple[str, Leaf]]:
    """Yield columns that are named like times and are as long as a channel that is read."""
    lengths = {max(item.shape, default=0) for items in sources.values() for item in items}
    for name, item in names(contents.root):
        is_time = isinstance(item, Leaf) and re.search(TIME, name.rpartition(".")[2].lower())
        if isinstance(item, Leaf) and is_time and len(item.shape) == 1 and item.shape[0] in lengths:
            if item.unit or time_unit(load(item))[0]:  # A column without a unit counts samples.
                yield name, item


def _stated_fs(contents: Contents, fs: float | str) -> tuple[float, str]:
    """Return the stated sampling frequency and its source: the argument or a scalar in the file."""
    source = "the argument"
    if isinstance(fs, str):
        leaf = select(contents.root, fs)
        values = load(leaf).ravel() if isinstance(leaf, Leaf) else np.zeros(0)
        if values.size != 1:
            raise DataError(f"`fs` = {fs!r} must be the path of one number in the file.")
        source, fs = f"`{fs}`", float(values[0])
    if not (np.isfinite(fs) and fs > 0):
        raise ConfigError(f"`fs` must be positive and finite, but is {fs}.")
    return float(fs), source


def _timed(sources: Sources, request: Wanted) -> tuple[dict[str, float], slice | None]:
    """Return the sampling frequency of each time channel, and the range of samples to read or None.

    A clock that is even only within the span determines the samples of the span as well.
    """
    timed: dict[str, float] = {}
    part: slice | None = None
    for item in sources.get("time", ()):
        rows = rows_of(item, "time", request, exact=False)
        for row in rows:
            name = (request.channels or {}).get("time", "time")
            factor = _seconds_in(item, row, request)
            try:
                fs, before = sampling_frequency(row, name, factor=factor)
            except DataError:
                if request.span is None or len(rows) > 1:
                    raise
                part = rows_of_span(np.asarray(row, np.float64) * factor, request.span)
                begins = request.span[0]
                fs, before = sampling_frequency(row[part], name, begins=begins, factor=factor)
            source = f"`{name}`" if fs == before else f"`{name}` (snapped from {before:.10g} Hz)"
            timed[source] = fs
    return timed, part


def _seconds_in(item: Leaf, printed: NDArray[np.number], request: Wanted) -> float:
    """Return the number of seconds per unit of a channel of times.

    Whole numbers without a unit are refused: they may be counts, or times in a small unit.
    """
    unit = request.units.get("time", "")
    if unit and item.unit and plain(unit) != plain(item.unit) and request.units_are != "mine":
        raise DataError(
            f"role `time` has the unit `{unit}` in the campaign but `{item.unit}` in the file.",
            why="The sampling frequency depends on the unit of the times.",
            remedy=messages.MINE,
        )
    if not (unit or item.unit) and request.is_timed and are_whole_numbers(printed):
        name, guess = (request.channels or {}).get("time", "time"), time_unit(printed)[0]
        what, why, remedy = messages.time_without_unit(name, printed[:4].tolist(), guess)
        raise ConfigError(what, why=why, remedy=remedy)
    return si_of("time", unit or item.unit or "s")[0]


def cut(fs: float, span: tuple[float, float] | None) -> slice:
    """Return the samples in a span of seconds as a slice."""
    if span is None:
        return WHOLE
    if not np.isfinite(fs):
        raise ConfigError("`span` is for time records, not for a measured FRF.")
    return slice(round(span[0] * fs), round(span[1] * fs))


def rows_of(
    item: Leaf,
    role: str,
    request: Wanted,
    part: slice = WHOLE,
    *,
    exact: bool = True,
    curve: bool = False,
) -> Repeats:
    """Return an array's repeats: itself, or its rows; complex values only for a response curve."""
    # A column of times is not converted to float64, because the last bit of its type is its
    # resolution.
    loaded = load(item, part, np.float64 if exact else None)
    where = (request.channels or {}).get(role, role)
    if loaded.ndim > (2 if request.repeats == "rows" else 1):
        raise DataError(
            f"channel `{where}` must be one series, but has shape {loaded.shape}.",
            remedy=f"Take one series with `{where}[0]` or `{where}[:, 0]`, or set repeats = "
            "'rows'.",
        )
    if np.iscomplexobj(loaded) and not curve:
        raise DataError(
            f"channel `{where}` is complex.",
            why="A time record is real; only the response of a measured FRF may be complex.",
            remedy="Name the real channel or, for a measured FRF, also the channel `frequency`.",
        )
    return list(np.atleast_2d(loaded))
