"""From the arrays of an open file to records: repeats, sampling frequency, units, provenance."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from jbw.errors import ConfigError, DataError
from jbw.measurement.files.tree import Contents, Leaf, load, names, select
from jbw.measurement.records import Record
from jbw.measurement.roles import ROLES, si_of
from jbw.measurement.timing import sampling_frequency, snapped
from jbw.units import plain

Repeats = list[NDArray[np.float64]]


@dataclass(frozen=True)
class Wanted:
    """What to take from a file; see `jbw.measurement.files.door.read`."""

    channels: Mapping[str, str] | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    fs: float | str | None = None
    scale: Mapping[str, float] = field(default_factory=dict)
    repeats: str = "files"
    span: tuple[float, float] | None = None


@dataclass(frozen=True)
class Sampling:
    """Sampling frequency [Hz], NaN for a measured FRF, and where it came from."""

    fs: float
    said: str


def records_of(contents: Contents, path: Path, wanted: Wanted, digest: str) -> tuple[Record, ...]:
    """Records of an open file, one a repeat.

    Raises:
        DataError: A channel is missing, ragged or of the wrong shape; no sampling frequency.
        ConfigError: A unit is missing or unknown, or no calibration is given where one is needed.
    """
    sources = _sources(contents, path, wanted)
    sampling = _sampling(contents, sources, path, wanted)
    start, stop = _cut(sampling, wanted.span, path)
    channels, units, said = {}, {}, {}
    for role, items in sources.items():
        if role == "time":
            continue
        unit = _unit(role, items[0], path, wanted)
        factor, units[role] = si_of(role, unit)
        factor *= _calibration(role, contents, path, wanted)
        rows = [row for item in items for row in _rows(item, role, path, wanted, start, stop)]
        # Most files are in SI already: no copy of a long record then.
        channels[role] = rows if factor == 1.0 else [row * factor for row in rows]
        said[f"unit of {role}"] = unit if factor == 1.0 else f"{unit}, times {factor:.10g}"
    provenance = {"path": str(path), "sha256": digest, "reader": contents.reader}
    provenance |= {"fs": sampling.said, **contents.notes, **said}
    if wanted.span:
        provenance["span"] = f"{wanted.span[0]:g}-{wanted.span[1]:g} s"
    return _repeats(channels, units, sampling.fs, path, provenance)


def _repeats(
    channels: Mapping[str, Repeats],
    units: Mapping[str, str],
    fs: float,
    path: Path,
    provenance: Mapping[str, str],
) -> tuple[Record, ...]:
    """One record a repeat; a channel given once is shared by all repeats."""
    counts = {role: len(rows) for role, rows in channels.items()}
    number = max(counts.values(), default=0)
    if any(count not in (1, number) for count in counts.values()):
        listed = ", ".join(f"`{role}` has {count}" for role, count in counts.items())
        raise DataError(
            f"{path.name}: channels must have equally many repeats, but {listed}.",
            remedy="Name channels that were recorded together.",
        )
    records = []
    for i in range(number):
        taken = {role: rows[i % len(rows)] for role, rows in channels.items()}
        name = path.name if number == 1 else f"{path.name}[{i}]"
        records.append(Record(fs, taken, units, name, provenance))
    return tuple(records)


def _sources(contents: Contents, path: Path, wanted: Wanted) -> dict[str, list[Leaf]]:
    """Role to the arrays that its path selects."""
    channels = wanted.channels
    if channels is None:
        found = [name for name, item in names(contents.root) if isinstance(item, Leaf)]
        channels = {name: name for name in found if name in ROLES}
        if not channels:
            raise ConfigError(
                f"{path.name}: no channel is named like a role ({', '.join(ROLES)}).",
                remedy='Say which is which, channels = { velocity = "laser" }, from: '
                f"{', '.join(found[:20])}.",
            )
    sources = {}
    for role, where in channels.items():
        try:
            picked = select(contents.root, where)
        except DataError as error:
            what = f"{path.name}, role `{role}`: {error.what}"
            raise DataError(what, why=error.why, remedy=error.remedy) from None
        sources[role] = picked if isinstance(picked, list) else [picked]
    return sources


def _sampling(
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
        for row in _rows(item, "time", path, wanted, 0, None, exact=False):
            name = (wanted.channels or {}).get("time", "time")
            fs, before = sampling_frequency(row if factor == 1.0 else row * factor, name)
            said = f"`{name}`" if fs == before else f"`{name}` (snapped from {before:.10g} Hz)"
            timed[said] = fs
    return timed


def _cut(
    sampling: Sampling, span: tuple[float, float] | None, path: Path
) -> tuple[int, int | None]:
    """First sample, and one past the last, of a span in seconds."""
    if span is None:
        return 0, None
    if not np.isfinite(sampling.fs):
        raise ConfigError(f"{path.name}: `span` is for time records, not for a measured FRF.")
    return round(span[0] * sampling.fs), round(span[1] * sampling.fs)


def _unit(role: str, item: Leaf, path: Path, wanted: Wanted) -> str:
    """The unit that the caller gives, which must not contradict the file."""
    given = wanted.units.get(role, "")
    if not (given or item.unit):
        raise ConfigError(
            f"{path.name}: the unit of role `{role}` is missing.",
            why="A wrong unit gives a wrong joint without any sign of it.",
            remedy=f'Say it: units = {{ {role} = "..." }}.',
        )
    if given and item.unit and plain(given) != plain(item.unit):
        raise DataError(
            f"{path.name}: role `{role}` is in `{given}` by the campaign "
            f"but in `{item.unit}` by the file.",
            remedy="Correct whichever is wrong; the file's own unit needs no mention.",
        )
    return given or item.unit


def _calibration(role: str, contents: Contents, path: Path, wanted: Wanted) -> float:
    if contents.reader == "WAV" and role not in wanted.scale:
        raise ConfigError(
            f"{path.name}: role `{role}` needs a calibration, since WAV keeps no scale.",
            remedy=f"Give the value at full scale: scale = {{ {role} = ... }}.",
        )
    factor = float(wanted.scale.get(role, 1.0))
    if not np.isfinite(factor) or factor == 0:
        raise ConfigError(f"`scale` of role `{role}` must be finite and not 0, but is {factor}.")
    return factor


def _rows(
    item: Leaf,
    role: str,
    path: Path,
    wanted: Wanted,
    start: int,
    stop: int | None,
    *,
    exact: bool = True,
) -> Repeats:
    """The repeats of one array: itself, or its rows.

    `exact` asks for float64; a time column keeps its own type, whose last bit is its resolution.
    """
    loaded = load(item, start, stop)
    where = (wanted.channels or {}).get(role, role)
    if loaded.ndim > (2 if wanted.repeats == "rows" else 1):
        raise DataError(
            f"{path.name}: channel `{where}` must be one series, but has shape {loaded.shape}.",
            remedy=f"Take one with `{where}[0]` or `{where}[:, 0]`, or set repeats = 'rows'.",
        )
    if np.iscomplexobj(loaded):
        raise DataError(
            f"{path.name}: channel `{where}` is complex.",
            remedy="Give amplitude and phase as two real channels.",
        )
    if exact:
        loaded = loaded.astype(np.float64, copy=False)
    return list(np.atleast_2d(loaded))
