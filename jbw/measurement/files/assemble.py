"""From the arrays of an open file to records: repeats, sampling frequency, units, provenance."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from jbw.errors import ConfigError, DataError, naming
from jbw.measurement.channels import Reals
from jbw.measurement.files.paths import select
from jbw.measurement.files.sampling import (
    Repeats,
    Wanted,
    on_even_grid,
    rows_of,
    sampling_of,
)
from jbw.measurement.files.tree import WHOLE, Contents, Leaf, names
from jbw.measurement.records import INPUTS, QUANTITIES, RESPONSES, ROLES, Record, si_of
from jbw.measurement.spans import SPAN, span_words, toml_table
from jbw.measurement.steady_lines import lines_removed, without_lines
from jbw.report.messages import reading as messages
from jbw.units import TORSION, decibels, plain, si_unit

LARGEST_GAIN = 30.0  # exponent: 1e13, beyond what any converter resolves
TURNING = {si_unit(quantity) for quantity in TORSION}
CENTRED = (*INPUTS, *RESPONSES, "restoring_force")  # roles whose mean may be taken out


def records_of(contents: Contents, path: Path, request: Wanted, digest: str) -> tuple[Record, ...]:
    """Records of an open file in SI, one a repeat; what was done to them is in the provenance."""
    sources = _sources(contents, request)
    fs, rate_source, part = (
        (request.resample, messages.resampled_to(request.resample), WHOLE)
        if request.resample and "frequency" not in sources
        else sampling_of(contents, sources, request)
    )
    first = round(request.span[0] * fs) if request.span and np.isfinite(fs) else 0
    provenance = {"path": str(path), "sha256": digest, "reader": contents.reader, "fs": rate_source}
    provenance |= contents.notes
    channels: dict[str, Repeats] = {}
    units: dict[str, str] = {}
    for role, items in sources.items():
        if role == "time":
            continue
        unit, against = _unit(role, items[0].unit, request)
        reference, unit = decibels(unit) or (0.0, unit)
        factor, units[role], source = si_of(role, unit)
        factor *= _calibration(role, contents.reader, request)
        is_curve = "frequency" in sources and role in RESPONSES
        read = WHOLE if request.resample else part
        rows = [row for item in items for row in rows_of(item, role, request, read, curve=is_curve)]
        if request.resample and "frequency" not in sources:
            rows, done = on_even_grid(rows, items[0], contents, sources, request)
            provenance[f"resampled {role}"] = done
        if reference:
            rows = [reference * 10 ** (_of_amplitudes(row, role, is_curve) / 20) for row in rows]
            provenance[f"decibels of {role}"] = f"0 dB is {reference:g} {unit}"
        # Most files are in SI already: no copy of a long record then.
        rows = rows if factor == 1.0 else [row * factor for row in rows]
        if items[0].start_s is not None:
            provenance[f"start of {role}"] = f"{items[0].start_s:.9g} s"
        provenance[f"channel of {role}"] = (request.channels or {}).get(role, role)
        unit_words = unit if factor == 1.0 else f"{unit}, times {factor:.10g}"
        if against:
            unit_words = messages.against_file(unit_words, against)
        provenance[f"unit of {role}"] = unit_words
        rows, removed = _cleared(rows, role, fs, first, request)
        provenance |= removed
        channels[role] = rows
        _require_one_motion(units)
        if is_curve and source:
            if any(role in sources for role in INPUTS):
                raise DataError(
                    f"the response is per unit of excitation, but `{source}` is given too.",
                    remedy="Leave the excitation out, or name the response's amplitude and its "
                    "unit.",
                )
            # The response is per unit of the source, whose amplitude is then 1.
            channels[source] = [np.ones(len(next(iter(channels.values()))[0]))]
            units[source] = si_unit(QUANTITIES[source][0])
            provenance["ratio"] = f"response per {units[source]} of {source}"
        if any(np.iscomplexobj(row) for row in rows):
            if "phase" in sources:
                raise DataError(
                    f"role `{role}` is complex, but `phase` is given too.",
                    remedy="Leave `phase` out of the channels.",
                )
            channels["phase"] = [np.angle(row) for row in rows]
            channels[role] = [np.abs(row) for row in rows]
            units["phase"], provenance["phase"] = "rad", messages.angle_of(role)
    if request.conjugate and "phase" in channels:
        channels["phase"] = [-row for row in channels["phase"]]
        provenance["conjugate"] = messages.CONJUGATED
    if request.span:
        provenance[SPAN] = span_words(request.span)
    if request.resample and "frequency" not in sources:
        channels = _of_one_length(channels)
    return _repeats(channels, Record(fs, {}, units, path.name, provenance))


def _cleared(
    rows: Repeats, role: str, fs: float, first: int, request: Wanted
) -> tuple[Repeats, dict[str, str]]:
    """Rows without their means, an analyser's window and steady lines, as asked; and what that was.

    The rows begin with sample `first` of their record.
    """
    removed = {}
    if request.remove_mean and role in CENTRED:
        means = [float(row.mean()) for row in rows]
        rows = [row - mean for row, mean in zip(rows, means, strict=True)]
        removed[f"mean of {role} removed"] = ", ".join(f"{mean:.6g}" for mean in means)
    if request.window_s and role in RESPONSES:
        rows = [unwindowed(row, request.window_s * fs, first) for row in rows]
        removed[f"window of {role} removed"] = f"exp(-t / {request.window_s:g} s)"
    if request.lines_hz and role in RESPONSES:
        parts = [without_lines(row, fs, request.lines_hz) for row in rows]
        rows = [row for row, _ in parts]
        removed[f"lines of {role} removed"] = "; ".join(lines_removed(lines) for _, lines in parts)
    return rows, removed


def _of_one_length(channels: Mapping[str, Repeats]) -> dict[str, Repeats]:
    """Resampled channels without what some have beyond the end of others."""
    size = min(len(row) for rows in channels.values() for row in rows)
    return {role: [row[:size] for row in rows] for role, rows in channels.items()}


def _of_amplitudes(row: Reals, role: str, is_curve: bool) -> Reals:
    if not is_curve or np.iscomplexobj(row):
        raise DataError(
            f"role `{role}` is in decibels, which only the real amplitudes of a measured FRF are.",
            remedy="Export its linear values.",
        )
    return row


def _require_one_motion(units: Mapping[str, str]) -> None:
    """Refuse a rotation beside a force, or a displacement beside a torque."""
    turning = {role for role, unit in units.items() if unit in TURNING}
    straight = {role for role, unit in units.items() if role in CENTRED} - turning
    straight -= {role for role in straight if role == "input"}
    if turning & set(CENTRED) and straight:
        angular, linear = sorted(turning & set(CENTRED))[0], sorted(straight)[0]
        raise ConfigError(
            f"role `{angular}` is in `{units[angular]}`, of torsion, but `{linear}` is in "
            f"`{units[linear]}`.",
            why="Torsion has angles and torques alone: metres, newtons and kilograms stand there "
            "for radians, newton metres and kg m^2.",
            remedy="Correct the units, or name channels of one motion.",
        )


def unwindowed(x: Reals, tau: float, first: int) -> Reals:
    r"""Samples without the exponential window of an analyser, $x(t) e^{t / \tau}$.

    The window counts from the record's first sample, of which `x` begins `first` samples later;
    `tau` is its time constant in samples.
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
    """One record a repeat; a channel given once is shared by all repeats."""
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
    """The unit of a role, and the one that the file states where the caller's counts instead.

    The caller's must not contradict the file's, unless he says that his are right.
    """
    stated_unit = request.units.get(role, "")
    if not (stated_unit or stated):
        raise ConfigError(
            f"the unit of role `{role}` is missing.",
            why="A wrong unit gives a wrong joint without any sign of it.",
            remedy=f"Put under [[test]]: `units = {toml_table(request.units, **{role: 'UNIT'})}`, "
            f'where UNIT is such as "{si_unit(QUANTITIES[role][0])}".',
        )
    bare = decibels(stated_unit) is None
    if stated_unit and bare:
        si_of(role, stated_unit)  # an unknown unit is the first thing to say
    contradicts = bool(stated_unit and stated) and plain(stated_unit) != plain(stated)
    if contradicts and request.units_are == "mine":
        return stated_unit, stated
    # Of decibels the file says that they are such, and the campaign what 0 dB stands for.
    if contradicts and not (plain(stated).lower() == "db" and not bare):
        raise DataError(
            f"role `{role}` is in `{stated_unit}` by the campaign but in `{stated}` by the file.",
            remedy=messages.MINE,
        )
    return stated_unit or stated, ""


def _calibration(role: str, reader: str, request: Wanted) -> float:
    if reader == "WAV" and role not in request.scale:
        raise ConfigError(
            f"role `{role}` needs a calibration, since WAV keeps no scale.",
            remedy=f"Put under [[test]]: `scale = {toml_table(request.scale, **{role: 'VALUE'})}`, "
            "where VALUE is that of full scale in the channel's unit.",
        )
    scale = float(request.scale.get(role, 1.0))
    if not np.isfinite(scale) or scale == 0:
        raise ConfigError(f"`scale` of role `{role}` must be finite and not 0, but is {scale}.")
    is_rms = request.amplitudes == "rms" and role in (*RESPONSES, *INPUTS)
    return scale * np.sqrt(2) if is_rms else scale  # amplitudes are peak inside jbw


def _sources(contents: Contents, request: Wanted) -> dict[str, list[Leaf]]:
    channels = request.channels
    if channels is None:
        channel_names = [name for name, item in names(contents.root) if isinstance(item, Leaf)]
        channels = {name: name for name in channel_names if name in ROLES}
        if not channels:
            raise ConfigError(
                f"no channel is named like a role ({', '.join(ROLES)}).",
                remedy="Say which is which, as channels={'velocity': 'laser'}, from: "
                f"{', '.join(channel_names[:20])}.",
            )
    sources = {}
    for role, where in channels.items():
        with naming(f"role `{role}`"):
            picked = select(contents.root, where)
        sources[role] = picked if isinstance(picked, list) else [picked]
    return sources


def joined(parts: Sequence[Sequence[Record]]) -> tuple[Record, ...]:
    """Records whose channels lie in several files, put together repeat by repeat."""
    heads = [part[0] for part in parts]
    if len({len(part) for part in parts}) != 1:
        listed = ", ".join(f"{part[0].name} has {len(part)}" for part in parts)
        raise DataError(f"Files of one test must have equally many repeats, but {listed}.")
    for head in heads[1:]:
        if head.fs != heads[0].fs and not (np.isnan(head.fs) and np.isnan(heads[0].fs)):
            raise DataError(
                f"Channels of one record must have one sampling frequency, but {heads[0].name} has "
                f"{heads[0].fs:.7g} Hz and {head.name} has {head.fs:.7g} Hz.",
                remedy="Resample them to one rate where they were measured.",
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
