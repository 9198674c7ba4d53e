"""From the arrays of an open file to records: repeats, sampling frequency, units, provenance."""

from collections.abc import Mapping, Sequence
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
    assembly = Assembly(contents, path, wanted)
    for role in assembly.sources:
        if role != "time":
            assembly.take(role)
    provenance = {"path": str(path), "sha256": digest, "reader": contents.reader}
    provenance |= {"fs": assembly.sampling.said, **contents.notes, **assembly.said}
    if wanted.span:
        provenance["span"] = f"{wanted.span[0]:g}-{wanted.span[1]:g} s"
    return assembly.records(provenance)


class Assembly:
    """The channels of one file as they are put together, in SI, and what was done to them.

    Args:
        contents: The open file.
        path: Where it lies.
        wanted: What to take from it.
    """

    def __init__(self, contents: Contents, path: Path, wanted: Wanted) -> None:
        self.path, self.wanted, self.reader = path, wanted, contents.reader
        self.sources = _sources(contents, path, wanted)
        self.is_curve = "frequency" in self.sources
        self.sampling = sampling_of(contents, self.sources, path, wanted)
        self.limits = cut(self.sampling, wanted.span, path)
        self.channels: dict[str, Repeats] = {}
        self.units: dict[str, str] = {}
        self.said: dict[str, str] = {}

    def take(self, role: str) -> None:
        """Read a channel, convert it to SI and say so."""
        wanted, unit = self.wanted, self._unit(role)
        factor, self.units[role] = self._factor(role, unit)
        curve = self.is_curve and role in RESPONSES
        rows = [
            row
            for item in self.sources[role]
            for row in rows_of(item, role, self.path, wanted, *self.limits, curve=curve)
        ]
        # Most files are in SI already: no copy of a long record then.
        self.channels[role] = rows if factor == 1.0 else [row * factor for row in rows]
        self.said[f"channel of {role}"] = (wanted.channels or {}).get(role, role)
        self.said[f"unit of {role}"] = unit if factor == 1.0 else f"{unit}, times {factor:.10g}"
        if wanted.remove_mean and role in CENTRED:
            self._centre(role)
        ratio = ratio_of(role, unit) if curve else None
        if ratio is not None:
            self._add_unit_source(ratio[1])
        if any(np.iscomplexobj(row) for row in rows):
            self._split(role)

    def records(self, provenance: Mapping[str, str]) -> tuple[Record, ...]:
        """One record a repeat; a channel given once is shared by all repeats."""
        counts = {role: len(rows) for role, rows in self.channels.items()}
        number = max(counts.values(), default=0)
        if any(count not in (1, number) for count in counts.values()):
            listed = ", ".join(f"`{role}` has {count}" for role, count in counts.items())
            raise DataError(
                f"{self.path.name}: channels must have equally many repeats, but {listed}.",
                remedy="Name channels that were recorded together.",
            )
        found = []
        for i in range(number):
            taken = {role: rows[i % len(rows)] for role, rows in self.channels.items()}
            name = self.path.name if number == 1 else f"{self.path.name}[{i}]"
            found.append(Record(self.sampling.fs, taken, self.units, name, provenance))
        return tuple(found)

    def _unit(self, role: str) -> str:
        """The unit that the caller gives, which must not contradict the file."""
        given, own = self.wanted.units.get(role, ""), self.sources[role][0].unit
        if not (given or own):
            raise ConfigError(
                f"{self.path.name}: the unit of role `{role}` is missing.",
                why="A wrong unit gives a wrong joint without any sign of it.",
                remedy=f'Say it: units = {{ {role} = "..." }}.',
            )
        if given and ratio_of(role, given) is None:
            si_of(role, given)  # an unknown unit is the first thing to say
        if given and own and plain(given) != plain(own):
            raise DataError(
                f"{self.path.name}: role `{role}` is in `{given}` by the campaign "
                f"but in `{own}` by the file.",
                remedy="Correct whichever is wrong; the file's own unit needs no mention.",
            )
        return given or own

    def _factor(self, role: str, unit: str) -> tuple[float, str]:
        """What to multiply a channel by, and the SI unit that it has then."""
        ratio = ratio_of(role, unit)
        factor, si = (
            si_of(role, unit) if ratio is None else (ratio[0], si_unit(QUANTITIES[role][0]))
        )
        factor *= self._calibration(role)
        if self.wanted.amplitudes == "rms" and role in (*RESPONSES, *INPUTS):
            factor *= np.sqrt(2)  # amplitudes are peak inside jbw
        return factor, si

    def _calibration(self, role: str) -> float:
        if self.reader == "WAV" and role not in self.wanted.scale:
            raise ConfigError(
                f"{self.path.name}: role `{role}` needs a calibration, since WAV keeps no scale.",
                remedy=f"Give the value at full scale: scale = {{ {role} = ... }}.",
            )
        factor = float(self.wanted.scale.get(role, 1.0))
        if not np.isfinite(factor) or factor == 0:
            raise ConfigError(
                f"`scale` of role `{role}` must be finite and not 0, but is {factor}."
            )
        return factor

    def _centre(self, role: str) -> None:
        """Take the mean out of a channel, and say so."""
        rows = self.channels[role]
        means = [float(row.mean()) for row in rows]
        self.channels[role] = [row - mean for row, mean in zip(rows, means, strict=True)]
        self.said[f"mean of {role} removed"] = ", ".join(f"{mean:.6g}" for mean in means)

    def _add_unit_source(self, source: str) -> None:
        """Excitation of amplitude 1 for a response that is given per unit of it, and say so."""
        if any(role in self.sources for role in INPUTS):
            raise DataError(
                f"{self.path.name}: the response is per unit of excitation, but `{source}` is "
                "given too.",
                remedy="Leave the excitation out, or name the response's amplitude and its unit.",
            )
        first = next(row for rows in self.channels.values() for row in rows)
        self.channels[source] = [np.ones(len(first))]
        self.units[source] = si_unit(QUANTITIES[source][0])
        self.said["ratio"] = f"response per {self.units[source]} of {source}"

    def _split(self, role: str) -> None:
        """Make amplitude and phase of a complex response, and say so."""
        if "phase" in self.sources:
            raise DataError(
                f"{self.path.name}: role `{role}` is complex, but `phase` is given too.",
                remedy="Leave `phase` out of the channels.",
            )
        self.channels["phase"] = [np.angle(row) for row in self.channels[role]]
        self.channels[role] = [np.abs(row) for row in self.channels[role]]
        self.units["phase"], self.said["phase"] = "rad", f"angle of the complex {role}"


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
