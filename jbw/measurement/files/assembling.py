"""From the arrays of an open file to records: repeats, sampling frequency, units, provenance."""

from collections.abc import Container, Mapping, Sequence
from pathlib import Path

import numpy as np

from jbw.errors import ConfigError, DataError
from jbw.measurement.files.paths import select
from jbw.measurement.files.sampling import Repeats, Wanted, cut, rows_of, sampling_of
from jbw.measurement.files.tree import Contents, Leaf, names
from jbw.measurement.records import INPUTS, RESPONSES, Record
from jbw.measurement.roles import QUANTITIES, ROLES, ratio_of, si_of
from jbw.units import plain, si_unit

CENTRED = (*INPUTS, *RESPONSES, "restoring_force")  # roles whose mean may be taken out


def records_of(contents: Contents, path: Path, wanted: Wanted, digest: str) -> tuple[Record, ...]:
    """Records of an open file, one a repeat.

    Raises:
        DataError: A channel is missing, ragged or of the wrong shape; no sampling frequency.
        ConfigError: A unit is missing or unknown, or no calibration is given where one is needed.
    """
    sources = _sources(contents, path, wanted)
    sampling = sampling_of(contents, sources, path, wanted)
    start, stop = cut(sampling, wanted.span, path)
    channels: dict[str, Repeats] = {}
    units: dict[str, str] = {}
    said: dict[str, str] = {}
    for role in (role for role in sources if role != "time"):
        unit = _unit(role, sources[role][0], path, wanted)
        factor, units[role] = _factor(role, unit, contents, path, wanted)
        curve = "frequency" in sources and role in RESPONSES
        rows = [
            row
            for item in sources[role]
            for row in rows_of(item, role, path, wanted, start, stop, curve=curve)
        ]
        # Most files are in SI already: no copy of a long record then.
        channels[role] = rows if factor == 1.0 else [row * factor for row in rows]
        said[f"channel of {role}"] = (wanted.channels or {}).get(role, role)
        said[f"unit of {role}"] = unit if factor == 1.0 else f"{unit}, times {factor:.10g}"
        if wanted.remove_mean and role in CENTRED:
            means = [float(row.mean()) for row in channels[role]]
            channels[role] = [row - m for row, m in zip(channels[role], means, strict=True)]
            said[f"mean of {role} removed"] = ", ".join(f"{mean:.6g}" for mean in means)
        ratio = ratio_of(role, unit) if curve else None
        if ratio is not None:
            said["ratio"] = _unit_source(ratio[1], sources, channels, units, path)
        if any(np.iscomplexobj(row) for row in rows):
            said["phase"] = _split(role, sources, channels, units, path)
    provenance = {"path": str(path), "sha256": digest, "reader": contents.reader}
    provenance |= {"fs": sampling.said, **contents.notes, **said}
    if wanted.span:
        provenance["span"] = f"{wanted.span[0]:g}-{wanted.span[1]:g} s"
    return _repeats(channels, units, sampling.fs, path, provenance)


def _factor(
    role: str, unit: str, contents: Contents, path: Path, wanted: Wanted
) -> tuple[float, str]:
    """What to multiply a channel by, and the SI unit that it has then."""
    ratio = ratio_of(role, unit)
    factor, si = si_of(role, unit) if ratio is None else (ratio[0], si_unit(QUANTITIES[role][0]))
    factor *= _calibration(role, contents, path, wanted)
    if wanted.amplitudes == "rms" and role in (*RESPONSES, *INPUTS):
        factor *= np.sqrt(2)  # amplitudes are peak inside jbw
    return factor, si


def _unit_source(
    source: str,
    given: Container[str],
    channels: dict[str, Repeats],
    units: dict[str, str],
    path: Path,
) -> str:
    """Excitation of amplitude 1 for a response that is given per unit of it, and say so."""
    if any(role in given for role in INPUTS):
        raise DataError(
            f"{path.name}: the response is per unit of excitation, but `{source}` is given too.",
            remedy="Leave the excitation out, or name the response's amplitude and its unit.",
        )
    channels[source] = [np.ones(len(row)) for rows in channels.values() for row in rows][:1]
    units[source] = si_unit(QUANTITIES[source][0])
    return f"response per {units[source]} of {source}"


def _split(
    role: str,
    given: Container[str],
    channels: dict[str, Repeats],
    units: dict[str, str],
    path: Path,
) -> str:
    """Make amplitude and phase of a complex response, and say so."""
    if "phase" in given:
        raise DataError(
            f"{path.name}: role `{role}` is complex, but `phase` is given too.",
            remedy="Leave `phase` out of the channels.",
        )
    channels["phase"] = [np.angle(row) for row in channels[role]]
    channels[role] = [np.abs(row) for row in channels[role]]
    units["phase"] = "rad"
    return f"angle of the complex {role}"


def joined(parts: Sequence[Sequence[Record]]) -> tuple[Record, ...]:
    """Records whose channels lie in several files, put together repeat by repeat.

    Raises:
        DataError: The files differ in sampling frequency or in the number of repeats.
    """
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
            known = provenance.get(key, value)
            provenance[key] = value if known == value else f"{known}; {value}"
    return Record(
        records[0].fs,
        {role: x for record in records for role, x in record.channels.items()},
        {role: unit for record in records for role, unit in record.units.items()},
        " + ".join(record.name for record in records),
        provenance,
    )


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


def _unit(role: str, item: Leaf, path: Path, wanted: Wanted) -> str:
    """The unit that the caller gives, which must not contradict the file."""
    given = wanted.units.get(role, "")
    if not (given or item.unit):
        raise ConfigError(
            f"{path.name}: the unit of role `{role}` is missing.",
            why="A wrong unit gives a wrong joint without any sign of it.",
            remedy=f'Say it: units = {{ {role} = "..." }}.',
        )
    if given and ratio_of(role, given) is None:
        si_of(role, given)  # an unknown unit is the first thing to say
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
