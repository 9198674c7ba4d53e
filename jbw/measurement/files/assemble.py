"""Conversion of an open file's arrays to records: repeats, rate, units and provenance."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import prod
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jbw.errors import ConfigError, DataError, naming
from jbw.measurement.channels import Reals
from jbw.measurement.files.paths import select
from jbw.measurement.files.sampling import (
    SAME_RATE,
    Repeats,
    Wanted,
    on_even_grid,
    rows_of,
    sampling_of,
)
from jbw.measurement.files.tree import WHOLE, Contents, Leaf, names
from jbw.measurement.records import (
    BASE,
    INPUTS,
    QUANTITIES,
    RESPONSES,
    ROLES,
    SENSITIVITIES,
    Record,
    sensitivity_of,
    si_of,
)
from jbw.measurement.spans import SPAN, span_words, toml_table
from jbw.measurement.steady_lines import lines_removed, without_lines
from jbw.memory import MAX_BYTES, VALUE, Admit, admit_all
from jbw.report.messages import reading as messages
from jbw.units import TORSION, decibels, factor_of, is_voltage, plain, si_unit

# largest exponent of a removed window: a gain of 1e13, beyond any converter's resolution
LARGEST_GAIN = 30.0
TURNING = {si_unit(quantity) for quantity in TORSION}
# roles of channels whose mean may be removed
CENTRED = (*INPUTS, BASE, *RESPONSES, "restoring_force")


class _Channels(NamedTuple):
    """Channels by role, as read from a file.

    Attributes:
        rows: Repeats of each channel in SI units.
        units: SI unit of each channel.
        done: Changes made to each channel, for the provenance.
    """

    rows: Mapping[str, Repeats]
    units: Mapping[str, str]
    done: Mapping[str, str]

    def beside(self, other: "_Channels") -> "_Channels":
        """Return these channels together with other channels, which take precedence."""
        return _Channels(
            {**self.rows, **other.rows}, {**self.units, **other.units}, {**self.done, **other.done}
        )


def records_of(
    contents: Contents, path: Path, request: Wanted, digest: str, admit: Admit = admit_all
) -> tuple[Record, ...]:
    """Return an open file's records in SI, one per repeat; the provenance lists all changes."""
    sources = _sources(contents, request)
    is_resampled = _is_resampled(sources, request)
    fs, rate_source, part = (
        (request.resample, messages.resampled_to(request.resample), WHOLE)
        if request.resample and is_resampled
        else sampling_of(contents, sources, request)
    )
    samples, channels = _size(contents, sources, request, fs, part)
    if samples * VALUE <= MAX_BYTES:  # longer channels are rejected by name when they are read
        admit(samples, channels, path.name)
    whole = {"path": str(path), "sha256": digest, "reader": contents.reader, "fs": rate_source}
    read = _Channels({}, {}, {**whole, **contents.notes})
    for role in sources:
        if role == "time":
            continue
        channel, source = _channel(role, contents, sources, request, fs, part)
        read = read.beside(channel)
        _require_one_motion(read.units)
        if source and _is_curve(role, sources):
            read = read.beside(_unit_source(source, sources, read))
        if any(np.iscomplexobj(row) for row in read.rows[role]):
            read = read.beside(_parted(role, sources, read.rows[role]))
    if request.conjugate and "phase" in read.rows:
        turned = [-row for row in read.rows["phase"]]
        done = {"conjugate": messages.CONJUGATED}
        read = read.beside(_Channels({"phase": turned}, {}, done))
    if request.span:
        read = read.beside(_Channels({}, {}, {SPAN: span_words(request.span)}))
    rows = _of_one_length(read.rows) if is_resampled else read.rows
    if "frequency" in rows and all(row[0] == 0 for row in rows["frequency"]):
        # Analysers export the mean as a line at 0 Hz, at which no response is measured.
        rows = {role: [row[1:] for row in each] for role, each in rows.items()}
        read = read.beside(_Channels({}, {}, {"line at 0 Hz": "left out"}))
    return _repeats(rows, Record(fs, {}, dict(read.units), path.name, dict(read.done)))


def _is_resampled(sources: Mapping[str, list[Leaf]], request: Wanted) -> bool:
    return bool(request.resample) and "frequency" not in sources


def _size(
    contents: Contents,
    sources: Mapping[str, list[Leaf]],
    request: Wanted,
    fs: float,
    part: slice,
) -> tuple[int, int]:
    """Return the number of samples per record and of channels, from the shapes in the file.

    Channels that are resampled from an unknown rate count with zero samples.
    """
    samples, channels = 0, 0
    for item in (item for role, items in sources.items() if role != "time" for item in items):
        length = (item.shape or (1,))[-1] if request.repeats == "rows" else max(item.shape or (1,))
        kept = len(range(*part.indices(length)))
        if _is_resampled(sources, request):
            rate = item.fs or contents.fs or request.fs
            kept = int(kept * fs / rate) if rate and not isinstance(rate, str) else 0
            if request.span:
                kept = min(kept, int(np.diff(request.span)[0] * fs))
        samples, channels = max(samples, kept), channels + prod(item.shape) // max(length, 1)
    return samples, channels


def _is_curve(role: str, sources: Mapping[str, list[Leaf]]) -> bool:
    return "frequency" in sources and role in RESPONSES


def _channel(
    role: str,
    contents: Contents,
    sources: Mapping[str, list[Leaf]],
    request: Wanted,
    fs: float,
    part: slice,
) -> tuple[_Channels, str]:
    """Return a role's repeats in SI, and the source by which a response is divided, if any."""
    items, is_curve, done = sources[role], _is_curve(role, sources), {}
    unit, against = _unit(role, items[0].unit, request)
    reference, unit = decibels(unit) or (0.0, unit)
    if is_voltage(unit) and role in SENSITIVITIES:
        line = toml_table({**request.sensitivity, role: SENSITIVITIES[role]})
        raise ConfigError(
            f"role `{role}` has the unit `{unit}` in the file: the channel is a sensor's voltage.",
            remedy=messages.of_sensor(line),
        )
    factor, si, source = si_of(role, unit)
    factor *= _calibration(role, contents.reader, request) / _volts_per_unit(
        role, items[0], request
    )
    part = WHOLE if request.resample else part
    rows = [row for item in items for row in rows_of(item, role, request, part, curve=is_curve)]
    if _is_resampled(sources, request):
        rows, done[f"resampled {role}"] = on_even_grid(rows, items[0], contents, sources, request)
    if reference:
        rows = [reference * 10 ** (_of_amplitudes(row, role, is_curve) / 20) for row in rows]
        done[f"decibels of {role}"] = f"0 dB is {reference:g} {unit}"
    # Most files are in SI units already, so that no copy of a long record is made.
    rows = rows if factor == 1.0 else [row * factor for row in rows]
    if items[0].start_s is not None:
        done[f"start of {role}"] = f"{items[0].start_s:.9g} s"
    done[f"channel of {role}"] = (request.channels or {}).get(role, role)
    unit_words = unit if factor == 1.0 else f"{unit}, times {factor:.10g}"
    if role in request.sensitivity:
        done[f"sensitivity of {role}"] = request.sensitivity[role]
    done[f"unit of {role}"] = messages.against_file(unit_words, against) if against else unit_words
    rows, removed = _cleared(rows, role, fs, request)
    return _Channels({role: rows}, {role: si}, done | removed), source


def _unit_source(source: str, sources: Mapping[str, list[Leaf]], read: _Channels) -> _Channels:
    """Return a source of constant amplitude 1, for a response stated per unit of the source."""
    if any(role in sources for role in INPUTS):
        raise DataError(
            f"the response is per unit of excitation, but `{source}` is given too.",
            remedy="Leave the excitation out, or name amplitude and unit of the response.",
        )
    unit = si_unit(QUANTITIES[source][0])
    ones = [np.ones(len(next(iter(read.rows.values()))[0]))]
    return _Channels({source: ones}, {source: unit}, {"ratio": f"response per {unit} of {source}"})


def _parted(role: str, sources: Mapping[str, list[Leaf]], rows: Repeats) -> _Channels:
    """Split complex repeats into magnitude and phase."""
    if "phase" in sources:
        raise DataError(
            f"role `{role}` is complex, but `phase` is given too.",
            remedy="Leave `phase` out of the channels.",
        )
    parts = {"phase": [np.angle(row) for row in rows], role: [np.abs(row) for row in rows]}
    return _Channels(parts, {"phase": "rad"}, {"phase": messages.angle_of(role)})


def _cleared(
    rows: Repeats, role: str, fs: float, request: Wanted
) -> tuple[Repeats, dict[str, str]]:
    """Remove mean, window and steady lines as requested; return the rows and a description."""
    removed = {}
    if request.remove_mean and role in CENTRED:
        means = [float(row.mean()) for row in rows]
        rows = [row - mean for row, mean in zip(rows, means, strict=True)]
        removed[f"mean of {role} removed"] = ", ".join(f"{mean:.6g}" for mean in means)
    if request.window_s and role in RESPONSES:
        first = round(request.span[0] * fs) if request.span and np.isfinite(fs) else 0
        rows = [unwindowed(row, request.window_s * fs, first) for row in rows]
        removed[f"window of {role} removed"] = f"exp(-t / {request.window_s:g} s)"
    if request.lines_hz and role in RESPONSES:
        parts = [without_lines(row, fs, request.lines_hz) for row in rows]
        rows = [row for row, _ in parts]
        removed[f"lines of {role} removed"] = "; ".join(lines_removed(lines) for _, lines in parts)
    return rows, removed


def _of_one_length(channels: Mapping[str, Repeats]) -> dict[str, Repeats]:
    """Cut all resampled channels to the length of the shortest one."""
    size = min(len(row) for rows in channels.values() for row in rows)
    return {role: [row[:size] for row in rows] for role, rows in channels.items()}


def _of_amplitudes(row: Reals, role: str, is_curve: bool) -> Reals:
    if not is_curve or np.iscomplexobj(row):
        raise DataError(
            f"role `{role}` is in decibels, but only the real amplitudes of a measured FRF may be "
            "in decibels.",
            remedy="Export the linear values of the channel.",
        )
    return row


def _require_one_motion(units: Mapping[str, str]) -> None:
    """Raise a ConfigError if channels of torsion and of translation are mixed."""
    turning = {role for role, unit in units.items() if unit in TURNING}
    straight = {role for role, unit in units.items() if role in CENTRED} - turning
    straight -= {role for role in straight if role == "input"}
    if turning & set(CENTRED) and straight:
        angular, linear = sorted(turning & set(CENTRED))[0], sorted(straight)[0]
        raise ConfigError(
            f"a test is either torsional or translational, but role `{angular}` is in "
            f"`{units[angular]}` and role `{linear}` in `{units[linear]}`.",
            why="A torsional test has only angles and torques; metres, newtons and kilograms in "
            "its results stand for radians, newton metres and kg m^2.",
            remedy="Correct the units, or name channels that measure the same motion.",
        )


def unwindowed(x: Reals, tau: float, first: int) -> Reals:
    r"""Remove an analyser's exponential window: $x(t) e^{t / \tau}$.

    The window starts at the record's first sample; `x` starts `first` samples later. `tau` is the
    time constant of the window in samples.
    """
    last = (first + len(x)) / tau
    if last > LARGEST_GAIN:
        raise DataError(
            f"the window falls to exp(-{last:.3g}) at the end of the record, where nothing of the "
            "response is left.",
            remedy="Correct `window_s`, or let `span` end earlier.",
        )
    return x * np.exp((first + np.arange(len(x))) / tau)


def _repeats(channels: Mapping[str, Repeats], record: Record) -> tuple[Record, ...]:
    """Return one record per repeat; a channel that occurs once is shared by all repeats."""
    counts = {role: len(rows) for role, rows in channels.items()}
    number = max(counts.values(), default=0)
    if any(count not in (1, number) for count in counts.values()):
        listed = ", ".join(f"`{role}` has {count}" for role, count in counts.items())
        raise DataError(
            f"channels must have equally many repeats, but {listed}.",
            remedy="Name channels that were recorded together.",
        )
    by_repeat = [
        {role: rows[i % len(rows)] for role, rows in channels.items()} for i in range(number)
    ]
    names = [record.name] if number == 1 else [f"{record.name}[{i}]" for i in range(number)]
    return tuple(
        replace(record, channels=channels_of_repeat, name=name)
        for channels_of_repeat, name in zip(by_repeat, names, strict=True)
    )


def _unit(role: str, stated: str, request: Wanted) -> tuple[str, str]:
    """Return a role's unit and, as a second value, the file's unit if the caller overrides that.

    The caller's unit must not contradict the file's unless `units_are` is "mine".
    """
    stated_unit = request.units.get(role, "")
    if role in request.sensitivity:
        below = sensitivity_of(role, request.sensitivity[role])[1]
        stated, stated_unit = below, stated_unit or below
    if not (stated_unit or stated):
        raise ConfigError(
            f"the unit of role `{role}` is missing.",
            why="A wrong unit gives a wrong joint without a warning.",
            remedy=f"Put under [[test]]: `units = {toml_table(request.units, **{role: 'UNIT'})}`, "
            f'where UNIT is such as "{si_unit(QUANTITIES[role][0])}".',
        )
    bare = decibels(stated_unit) is None
    if stated_unit and bare:
        si_of(role, stated_unit)  # report an unknown unit first
    contradicts = bool(stated_unit and stated) and plain(stated_unit) != plain(stated)
    if contradicts and request.units_are == "mine":
        return stated_unit, stated
    # If a file only says that values are decibels, the campaign says what 0 dB stands for.
    if contradicts and not (plain(stated).lower() == "db" and not bare):
        remedy = messages.MINE
        if is_voltage(stated) and role in SENSITIVITIES:
            # If a factor is given in addition to the unit, the factor is the calibration of one
            # volt.
            example = f"1 V/{stated_unit}" if role in request.scale else SENSITIVITIES[role]
            line = toml_table({**request.sensitivity, role: example})
            remedy = messages.of_sensor(line, is_scaled=role in request.scale)
        raise DataError(
            f"role `{role}` has the unit `{stated_unit}` in the campaign but `{stated}` in the "
            "file.",
            remedy=remedy,
        )
    return stated_unit or stated, ""


def _volts_per_unit(role: str, item: Leaf, request: Wanted) -> float:
    """Return the sensitivity of a role's sensor in the file's unit of voltage; 1 if not given."""
    if role not in request.sensitivity:
        return 1.0
    if item.unit and not is_voltage(item.unit):
        raise ConfigError(
            f"`sensitivity` of role `{role}` is for a channel in volts, but the file states "
            f"`{item.unit}`.",
            remedy=f"Leave out the sensitivity of role `{role}`; the unit in the file is used.",
        )
    volts = sensitivity_of(role, request.sensitivity[role])[0]
    return volts / factor_of(item.unit or "V", "voltage")


def _calibration(role: str, reader: str, request: Wanted) -> float:
    if reader == "WAV" and role not in request.scale:
        raise ConfigError(
            f"role `{role}` needs a calibration, since WAV keeps no scale.",
            remedy=f"Put under [[test]]: `scale = {toml_table(request.scale, **{role: 'VALUE'})}`, "
            "where VALUE is the full-scale value in the channel's unit.",
        )
    scale = float(request.scale.get(role, 1.0))
    if not np.isfinite(scale) or scale == 0:
        raise ConfigError(f"`scale` of role `{role}` must be finite and not 0, but is {scale}.")
    is_rms = request.amplitudes == "rms" and role in (*RESPONSES, *INPUTS)
    return scale * np.sqrt(2) if is_rms else scale  # amplitudes are peak values inside jbw


def _sources(contents: Contents, request: Wanted) -> dict[str, list[Leaf]]:
    channels = request.channels
    if channels is None:
        channel_names = [name for name, item in names(contents.root) if isinstance(item, Leaf)]
        channels = {name: name for name in channel_names if name in ROLES}
        if not channels:
            raise ConfigError(
                f"no channel has the name of a role ({', '.join(ROLES)}).",
                remedy="State the channel of each role, for example "
                "channels={'velocity': 'laser'}. "
                f"Found: {', '.join(channel_names[:20])}.",
            )
    sources = {}
    for role, where in channels.items():
        with naming(f"role `{role}`"):
            picked = select(contents.root, where)
        sources[role] = picked if isinstance(picked, list) else [picked]
    return sources


def joined(parts: Sequence[Sequence[Record]]) -> tuple[Record, ...]:
    """Return records whose channels come from several files, merged repeat by repeat."""
    heads = [part[0] for part in parts]
    if len({len(part) for part in parts}) != 1:
        listed = ", ".join(f"{part[0].name} has {len(part)}" for part in parts)
        raise DataError(f"Files of one test must have equally many repeats, but {listed}.")
    for head in heads[1:]:
        same = abs(head.fs - heads[0].fs) <= SAME_RATE * heads[0].fs
        if not same and not (np.isnan(head.fs) and np.isnan(heads[0].fs)):
            raise DataError(
                f"Channels of one record must have one sampling frequency, but {heads[0].name} has "
                f"{heads[0].fs:.7g} Hz and {head.name} has {head.fs:.7g} Hz.",
                remedy="Resample the channels to one rate in the program that recorded them.",
            )
    return tuple(_merged(records) for records in zip(*parts, strict=True))


def _merged(records: Sequence[Record]) -> Record:
    provenance: dict[str, str] = {}
    for record in records:
        for key, value in record.provenance.items():
            merged_value = provenance.get(key, value)
            provenance[key] = value if merged_value == value else f"{merged_value}; {value}"
    return Record(
        records[0].fs,
        {role: x for record in records for role, x in record.channels.items()},
        {role: unit for record in records for role, unit in record.units.items()},
        " + ".join(record.name for record in records),
        provenance,
    )
