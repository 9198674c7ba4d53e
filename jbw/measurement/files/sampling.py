"""Sampling frequency of a file's channels, from all that states it, and the rows of a channel."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from jbw.errors import ConfigError, DataError
from jbw.measurement.files.paths import select
from jbw.measurement.files.tree import Contents, Leaf, load
from jbw.measurement.roles import si_of
from jbw.measurement.timing import sampling_frequency, snapped

Repeats = list[NDArray[np.float64]]


@dataclass(frozen=True)
class Wanted:
    """What to take from a file; see `jbw.measurement.files.read.read`."""

    channels: Mapping[str, str] | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    fs: float | str | None = None
    scale: Mapping[str, float] = field(default_factory=dict)
    repeats: str = "files"
    span: tuple[float, float] | None = None
    amplitudes: str = "peak"
    remove_mean: bool = False


@dataclass(frozen=True)
class Sampling:
    """Sampling frequency [Hz], NaN for a measured FRF, and where it came from."""

    fs: float
    said: str


def sampling_of(
    contents: Contents, sources: Mapping[str, list[Leaf]], path: Path, wanted: Wanted
) -> Sampling:
    """Sampling frequency: given, from the time channel, or from the file; all must agree."""
    if "frequency" in sources:
        return Sampling(float("nan"), "none: a measured FRF")
    found = {**_stated(contents, sources, wanted), **_timed(sources, path, wanted)}
    if wanted.fs is not None:
        fs, said = _given(contents, path, wanted.fs)
        found = {said: fs, **found}
    if not found:
        raise DataError(
            f"{path.name}: the sampling frequency is missing.",
            why="Nothing in the file gives it, and it cannot be guessed.",
            remedy="Give fs = <Hz>, or name a time column: channels = { time = ... }.",
        )
    (said, fs), *others = found.items()
    for other, value in others:
        if abs(value - fs) > 2e-5 * fs:
            raise DataError(
                f"{path.name}: sampling frequencies must agree, but {said} is {fs:.7g} Hz "
                f"and {other} is {value:.7g} Hz.",
                remedy="Name channels of one rate, or resample them where they were measured.",
            )
    kept = snapped(fs) if wanted.fs is None else fs
    rounded = "" if kept == fs else f", snapped from {fs:.10g} Hz"
    return Sampling(kept, f"{kept:.10g} Hz from {said}{rounded}")


def _given(contents: Contents, path: Path, fs: float | str) -> tuple[float, str]:
    """Sampling frequency as the caller gives it: a number, or the path of a scalar."""
    said = "the argument"
    if isinstance(fs, str):
        leaf = select(contents.root, fs)
        values = load(leaf).ravel() if isinstance(leaf, Leaf) else np.zeros(0)
        if values.size != 1:
            raise DataError(f"{path.name}: `fs` = {fs!r} must point at one number.")
        said, fs = f"`{fs}`", float(values[0])
    if not (np.isfinite(fs) and fs > 0):
        raise ConfigError(f"{path.name}: `fs` must be positive and finite, but is {fs}.")
    return float(fs), said


def _stated(
    contents: Contents, sources: Mapping[str, list[Leaf]], wanted: Wanted
) -> dict[str, float]:
    """Sampling frequencies that the file states, of the channels or of the whole."""
    stated = {
        f"`{(wanted.channels or {}).get(role, role)}`": item.fs
        for role, items in sources.items()
        for item in items
        if item.fs is not None
    }
    return stated or ({"the file": contents.fs} if contents.fs is not None else {})


def _timed(sources: Mapping[str, list[Leaf]], path: Path, wanted: Wanted) -> dict[str, float]:
    """Sampling frequency of each time channel, all of which must be even."""
    timed = {}
    for item in sources.get("time", ()):
        factor, _ = si_of("time", wanted.units.get("time") or item.unit or "s")
        for row in rows_of(item, "time", path, wanted, 0, None, exact=False):
            name = (wanted.channels or {}).get("time", "time")
            fs, before = sampling_frequency(row if factor == 1.0 else row * factor, name)
            said = f"`{name}`" if fs == before else f"`{name}` (snapped from {before:.10g} Hz)"
            timed[said] = fs
    return timed


def cut(sampling: Sampling, span: tuple[float, float] | None, path: Path) -> tuple[int, int | None]:
    """First sample, and one past the last, of a span in seconds."""
    if span is None:
        return 0, None
    if not np.isfinite(sampling.fs):
        raise ConfigError(f"{path.name}: `span` is for time records, not for a measured FRF.")
    return round(span[0] * sampling.fs), round(span[1] * sampling.fs)


def rows_of(
    item: Leaf,
    role: str,
    path: Path,
    wanted: Wanted,
    start: int,
    stop: int | None,
    *,
    exact: bool = True,
    curve: bool = False,
) -> Repeats:
    """The repeats of one array: itself, or its rows; complex ones only in a response curve.

    `exact` asks for float64; a time column keeps its own type, whose last bit is its resolution.
    """
    loaded = load(item, start, stop, np.float64 if exact else None)
    where = (wanted.channels or {}).get(role, role)
    if loaded.ndim > (2 if wanted.repeats == "rows" else 1):
        raise DataError(
            f"{path.name}: channel `{where}` must be one series, but has shape {loaded.shape}.",
            remedy=f"Take one with `{where}[0]` or `{where}[:, 0]`, or set repeats = 'rows'.",
        )
    if np.iscomplexobj(loaded):
        if curve:
            return list(np.atleast_2d(loaded))
        raise DataError(
            f"{path.name}: channel `{where}` is complex.",
            why="A time record is real; only the response of a measured FRF may be complex.",
            remedy="Name the real channel, or its `frequency` when it is a measured FRF.",
        )
    if exact:
        loaded = loaded.astype(np.float64, copy=False)
    return list(np.atleast_2d(loaded))
