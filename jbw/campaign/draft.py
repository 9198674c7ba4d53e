"""The draft of a first campaign file from the files in a folder; every guess is marked."""

import re
import tomllib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jbw.campaign.asked import Named
from jbw.campaign.content import controlled_kind, course_of, falls, model_files, structure_lines
from jbw.campaign.document import NAMED, commented, toml
from jbw.campaign.roles import (
    MOST_SAMPLES,
    Channel,
    Leaves,
    channels_by_role,
    is_complex,
    last_name,
    with_roles,
)
from jbw.campaign.settings import Identify
from jbw.campaign.tables import Head, TestSpec
from jbw.errors import ConfigError, DataError, JbwError, RunError
from jbw.measurement.channels import strength_ranks
from jbw.measurement.faults.responses import band_about_peak, height_within
from jbw.measurement.files.assemble import Wanted
from jbw.measurement.files.clocks import SECONDS, coarse_rate, sampling_frequency, time_unit
from jbw.measurement.files.paths import select
from jbw.measurement.files.read import READERS, opened, records
from jbw.measurement.files.tree import RATE, Contents, Leaf, load, names
from jbw.measurement.kinds import KINDS, Kind
from jbw.measurement.recorders.recorder import is_time
from jbw.measurement.records import (
    BASE,
    CLOCKS,
    INPUTS,
    RESPONSES,
    SENSITIVITIES,
    SOURCES,
    Record,
    si_of,
)
from jbw.measurement.resampled import proposed_rate
from jbw.measurement.spectra import strongest_line
from jbw.report.messages import draft as messages
from jbw.report.messages.reading import EXPORTS
from jbw.units import decibels, plain

LISTED = 12  # largest number of channels that a comment lists
MOST_GROUPS = 500  # If there are more groups of repeats than this, files are not grouped by name.
# number of bytes at a file's start that show whether it may contain a response curve
BEGINNING = 1 << 14
BAND = "\nband = ["
CHANNELS = "\nchannels = "
TORQUE = re.compile(
    r"(?i)(\d+(?:[.,p]\d+)?)[\s_-]?(N[\s_-]?m|kgf?[\s_-]?cm|(?:ft|in)[\s_-]?lbf?)(?![a-z])"
)
NEWTON_METRES = {
    "n": 1.0,
    "k": 0.0980665,
    "f": 1.3558179,
    "i": 0.1129848,
}  # units by their first letter
SENSORS = "# sensitivity = "
# Two bands lie around the same spectral line if the ratio of their centres is smaller than this.
SAME_LINE = 1.25
# smallest height, relative to the strongest line, of a line that can be seen in a decay
LEAST_HEIGHT = 0.02
FOLLOWING = 0.7  # Force and displacement form a loop if their correlation is larger than this.
MOST_LEVELLED = 100  # largest number of files for which the levels of the source are determined
FILES = "# files"  # placeholder for the line with the files, which depends on their levels
MOST_BLOCKS = 40  # largest number of tests drafted from a single file
# keys of a test that a draft offers in a comment
OPTIONAL = ("level", "band", "delay", "assembly", "run", "exclude", "span")
KIND_HINTS = dict(step="stepped", tone="tones", hammer="decay", impact="decay", tap="decay",
                  pluck="decay", ringdown="decay", msine="multisine", sinesw="sweep",
                  chirp="sweep", random="noise", hyster="loop", cyclic="loop")  # fmt: skip
Assume = Callable[[str], None]
NOBODY = Channel("...", "", "")
Reach = tuple[float, float]  # lowest and highest frequency [Hz] of response curves
FEW_COLUMNS = 16  # The columns of a table with more columns than this are not taken as channels.


@dataclass(frozen=True)
class Looked:
    """The content of a measurement file, as seen when it is opened."""

    leaves: Leaves  # all arrays of the file
    series: Leaves  # arrays of the file that may be channels
    fs: float | None  # sampling frequency of the whole file [Hz]; None if not stated
    recorder: str
    doubts: tuple[str, ...] = ()  # content of the file that the reader cannot use


@dataclass(frozen=True)
class Draft:
    """A drafted campaign file that is not yet written."""

    text: str  # text of the campaign file (TOML)
    assumed: tuple[str, ...]  # assumptions that the records do not confirm, one line each


def start_campaign(
    folder: str | Path,
    named: Named = lambda path, channels: {},
    files: Sequence[Path] | None = None,
    mass: float | None = None,
) -> Draft:
    """Draft a campaign file for the measurement files of a folder.

    Files whose names differ only in their last number are repeats of one test.

    Args:
        folder: Folder of the records.
        named: Function that is called with a file and its channels if none of them is named like a
            response; it returns the channel of each role.
        files: Files of the folder to draft; when None, all measurement files in it.
        mass: Modal mass to state in the draft [kg].

    Raises:
        ConfigError: The mass is not positive.
        DataError: The folder does not exist, or contains no readable measurement file.
    """
    folder = Path(folder)
    if mass is not None and not 0.0 < mass < float("inf"):
        raise ConfigError(f"The modal mass must be above zero [kg], but is {mass:g}.")
    if not folder.is_dir():
        raise DataError(f"Folder `{folder}` does not exist.", remedy="Name the folder of records.")
    records_of = set(measurement_files(folder) if files is None else files)
    there = sorted(folder.iterdir() if files is None else files)
    matrices, of_model = model_files(there) or ("", ())
    names_of_model = [path.name for path in of_model]
    visible = sorted(records_of - set(of_model), key=_stem)
    if of_model and not visible:
        what, why, remedy = messages.matrices_alone(str(folder), names_of_model)
        raise DataError(what, why=why, remedy=remedy)
    # pairs of a file's name and an assumption about the file
    assumed = [(path.name, messages.to_export(EXPORTS[path.suffix.lower()]))
               for path in there if path.suffix.lower() in EXPORTS]  # fmt: skip
    groups = [sorted(repeats) for _, repeats in groupby(visible, key=_stem)]
    if len(groups) > MOST_GROUPS:
        raise DataError(
            f"Folder `{folder}` contains {len(visible)} measurement files of {len(groups)} "
            f"names, more than a campaign of {MOST_GROUPS} tests.",
            why="Files whose names differ only in their last number are repeats of one test.",
            remedy="Put the records of one joint into a separate folder, or number the "
            f"repeats of a test: sweep_1{visible[0].suffix}, sweep_2{visible[0].suffix}.",
        )
    torques = {_torque_of(repeats[0]) for repeats in groups}
    blocks = _tests(groups, folder, torques, assumed, named)
    if of_model:
        assumed.append(("", messages.matrices(names_of_model)))
        blocks.append("\n".join([*structure_lines(matrices, folder), ""]))
    if not any("[[test]]" in block for block in blocks):
        raise DataError(
            f"Folder `{folder}` has no measurement file that can be read.",
            remedy=" ".join(
                ["Export the records to one of: " + ", ".join(READERS) + ".", *_once(assumed)]
            ),
        )
    title = folder.resolve().name if files is None else shared_name(visible[0])
    head = _head(title or "campaign", mass, torques)
    drafted = any("\nband = " in block for block in blocks)
    optional = commented(TestSpec, [key for key in OPTIONAL if not (drafted and key == "band")])
    foot = [
        messages.FURTHER,
        *optional,
        "",
        "# [identify]",
        *commented(Identify, Identify.model_fields),
        "",
    ]
    return Draft("\n".join([*head, *blocks, *foot]), tuple(_once(assumed)))


def _head(title: str, mass: float | None, torques: Collection[str]) -> list[str]:
    """Return the lines of [campaign], and of [assembly] if the names contain one torque."""
    name = f"name = {toml(title)}"
    offered = commented(Head, ("modal_mass", "gain")[mass is not None :])
    stated = [] if mass is None else [f"modal_mass = {toml(mass)}"]
    head = [messages.HEAD, name, *stated, *offered, ""]
    if len(torques) == 1 and any(torques):
        head += [messages.of_one_torque(toml(_in_newton_metres(*torques))), ""]
    return head


def _tests(
    groups: Sequence[Sequence[Path]],
    folder: Path,
    torques: Collection[str],
    assumed: list[tuple[str, str]],
    named: Named,
) -> list[str]:
    """Return drafted [[test]] tables of all files, with names and common bands."""
    blocks: list[str] = []
    names: list[str] = []
    curves = _frequencies_of_curves(groups)
    for repeats in groups:
        file_blocks = _blocks(repeats, assumed, curves, named)
        if len(torques) > 1 and (torque := _torque_of(repeats[0])):
            line = messages.assembly(toml(torque))
            file_blocks = [block.replace(CHANNELS, f"\n{line}{CHANNELS}") for block in file_blocks]
        name, count = shared_name(repeats[0]), len(file_blocks)
        names += [f"{name} {i}" if count > 1 else name for i in range(1, count + 1)]
        blocks += file_blocks
    if sum(map(bool, torques)) > 1:
        of_torques = [_pattern(repeats) for repeats in groups if _torque_of(repeats[0])]
        patterns = [
            " ".join(str(folder / file) for file in ([files] if isinstance(files, str) else files))
            for files in of_torques
        ]
        assumed.append(("", messages.torques(patterns)))
    return _named(_bands_together(blocks, folder, assumed), names)


def _torque_of(path: Path) -> str:
    """Return the torque in the name of a file or of its folder, as written there, or ""."""
    found = TORQUE.search(path.stem) or TORQUE.search(path.resolve().parent.name)
    return found.group(0).strip("_ -") if found else ""


def _in_newton_metres(torque: str) -> float:
    """Convert the torque in a file's name to a number [N m]."""
    (number, unit) = TORQUE.findall(torque)[0]
    value = float(re.sub("[,pP]", ".", number)) * NEWTON_METRES[unit[0].lower()]
    return float(f"{value:.6g}")


def _bands_together(
    blocks: Sequence[str], folder: Path, assumed: list[tuple[str, str]]
) -> list[str]:
    """Give all drafted decays of one mode a common band around a line that all spectra contain.

    An impact may move the suspension more than the joint, so that its line is the largest in one
    test. The line of the joint stands out in every test.
    """
    sampled: dict[int, tuple[Path, Record]] = {}
    bands: dict[int, Reach] = {}
    for i, block in enumerate(blocks):
        if BAND not in block:
            continue
        (test,) = tomllib.loads(block)["test"]
        files = test["files"]
        file = folder / (files if isinstance(files, str) else files[0])
        first = file if file.is_file() else sorted(folder.glob(file.name))[0]
        with suppress(JbwError, ValueError, IndexError):
            lines = block.splitlines()
            sampled[i] = first, _first_record(first, test["channels"], lines)
            bands[i] = tuple(test["band"])
    changed = list(blocks)
    for i, band in _shared_bands(bands, {i: record for i, (_, record) in sampled.items()}).items():
        line = messages.shared_band(toml(list(band)))
        changed[i] = re.sub(r"^band = .*$", line, blocks[i], flags=re.MULTILINE)
        before, after = messages.about_strongest(*bands[i]), messages.about_shared(*band)
        name = sampled[i][0].name
        assumed[:] = [(name, after) if row == (name, before) else row for row in assumed]
    return changed


def _shared_bands(bands: Mapping[int, Reach], records: Mapping[int, Record]) -> dict[int, Reach]:
    """Return the common band of one mode's decays, around a line that all spectra contain.

    All decays of one mode are fitted in one band, which is the intersection of their bands.
    """
    centres = [sum(band) / 2 for band in bands.values()]
    if len(centres) < 2:
        return {}
    about = list(bands.values())
    if max(centres) >= SAME_LINE * min(centres):

        def least_height(band: Reach) -> float:
            return min(height_within(record, band) for record in records.values())

        shared = max(about, key=least_height)
        if least_height(shared) < LEAST_HEIGHT:
            return {}
        about = [band_about_peak(record, within=shared) for record in records.values()]
    one = max(low for low, _ in about), min(high for _, high in about)
    if not one[0] < one[1] or all(band == one for band in bands.values()):
        return {}
    return dict.fromkeys(bands, one)


def shared_name(path: Path) -> str:
    """Return a file's name without the number of the repeat."""
    return _stem(path)[0].rstrip(" _-.(") or path.stem


def _named(blocks: Sequence[str], names: Sequence[str]) -> list[str]:
    """Return drafted tests with names from their files; equal names are numbered."""
    is_test = [block.startswith("[[test]]\n") for block in blocks]
    if sum(is_test) < 2:
        return list(blocks)
    renamed, used_names = [], set()
    for block, name, has_name in zip(blocks, names, is_test, strict=True):
        if not has_name:
            renamed.append(block)
            continue
        tries = (name if n == 1 else f"{name} ({n})" for n in range(1, len(blocks) + 2))
        free = next(candidate for candidate in tries if candidate not in used_names)
        used_names.add(free)
        head, kind, rest = block.split("\n", 2)
        renamed.append(f"{head}\n{kind}\nname = {toml(free)}\n{rest}")
    return renamed


def looked_at(contents: Contents) -> Looked:
    """Return the arrays and channels of an open file, its sampling rate and its recorder."""
    leaves = {name: item for name, item in names(contents.root) if isinstance(item, Leaf)}
    series = _series_in(leaves) if contents.series is None else dict(contents.series)
    return Looked(leaves, series, contents.fs, contents.recorder, contents.doubts)


def _once(assumed: Sequence[tuple[str, str]]) -> Iterator[str]:
    """Yield each assumption once, with all files that it concerns."""
    files: dict[str, list[str]] = {}
    for name, what in assumed:
        files.setdefault(what, []).append(name)
    for what, concerned in files.items():
        shown = [name for name in concerned[:LISTED] if name]
        more = f" and {len(concerned) - LISTED} more" if len(concerned) > LISTED else ""
        yield f"{', '.join(shown)}{more}: {what}" if shown else what


def measurement_files(folder: Path) -> list[Path]:
    """Return the files of a folder that can be read as measurements, except hidden files."""
    try:
        named = [p for p in folder.iterdir() if p.suffix.lower() in READERS]
        return [p for p in named if not p.name.startswith(".") and p.is_file()]
    except OSError as error:
        raise DataError(
            f"Folder `{folder}` cannot be read: {error.strerror or error}.",
            remedy="Change the permissions of the folder, or copy the records to another folder.",
        ) from error


def folders_of_records(folder: Path) -> list[Path]:
    """Return the folders with records or a campaign file in a folder that has neither itself."""
    if not folder.is_dir() or any(folder.glob("*.toml")) or measurement_files(folder):
        return []
    inside = [path for path in sorted(folder.iterdir()) if path.is_dir()]
    return [path for path in inside if any(path.glob("*.toml")) or measurement_files(path)]


def write_campaign(draft: Draft, folder: str | Path, name: str = NAMED) -> Path:
    """Write a draft to a new campaign file; raise a ConfigError if the file exists."""
    path = Path(folder) / name
    try:
        with path.open("xb") as file:
            file.write(draft.text.encode())
    except FileExistsError:
        raise already_written(path) from None
    except OSError as error:
        path.unlink(missing_ok=True)  # The disk was full after this part of the file was written.
        raise RunError(
            f"`{path}` cannot be written: {error.strerror or error}.",
            remedy="Free some space, or make the folder writable; or keep the draft elsewhere: "
            f"jbw init --print {folder} > campaign.toml",
        ) from error
    return path


def already_written(path: Path) -> ConfigError:
    """Return the error for a campaign file that already exists."""
    return ConfigError(
        f"`{path}` exists already, and is not overwritten.",
        remedy="See the draft with: jbw init --print FOLDER",
    )


def _stem(path: Path) -> tuple[str, str]:
    """Return a file's name without its final number, which counts repeats, and its suffix."""
    return re.sub(r"\d+$", "", path.stem), path.suffix.lower()


def _frequencies_of_curves(groups: Sequence[Sequence[Path]]) -> Reach | None:
    """Return the lowest and highest frequency [Hz] of all response curves; None without curves."""
    ends_hz: list[float] = []
    for files in groups:
        if not _may_hold_a_curve(files[0]):
            continue
        with suppress(JbwError), opened(files[0]) as contents:
            roles = channels_by_role(looked_at(contents).series)
            if not {"frequency", "phase"} <= set(roles):
                continue
            frequency = roles["frequency"]
            leaf = select(contents.root, frequency.path)
            if isinstance(leaf, Leaf):
                hz = load(leaf) * si_of("frequency", frequency.unit or "Hz")[0]
                ends_hz += [float(np.nanmin(hz)), float(np.nanmax(hz))]
    return (min(ends_hz), max(ends_hz)) if ends_hz else None


def _may_hold_a_curve(path: Path) -> bool:
    """Return whether a file may contain a response curve; a text must mention frequencies."""
    with suppress(OSError), path.open("rb") as stream:
        head = stream.read(BEGINNING)
        is_text = READERS.get(path.suffix.lower(), "").endswith(".csv") and b"\0" not in head
        return not is_text or re.search(rb"fre[qk]|hz|phase|rpm", head.lower()) is not None
    return False


def _blocks(
    files: Sequence[Path], assumed: list[tuple[str, str]], curves: Reach | None, named: Named
) -> list[str]:
    """Return the [[test]] tables of several files, or a comment if they cannot form a test."""
    try:
        with opened(files[0]) as contents:
            looked = looked_at(contents)
            by_record = _records_in(looked.series)
            blocks = [
                block
                for series in by_record[:MOST_BLOCKS]
                for block in _block(files, replace(looked, series=series), assumed, curves, named)
            ]
    except JbwError as error:
        said = [error.what, error.remedy] if error.remedy else [error.what]
        assumed.append(("", " ".join(said)))
        return ["".join(f"# {line}\n" for text in said for line in text.splitlines())]
    if len(by_record) > MOST_BLOCKS:
        blocks.append(messages.more_groups(len(by_record) - MOST_BLOCKS))
    return blocks


def _block(
    files: Sequence[Path],
    looked: Looked,
    assumed: list[tuple[str, str]],
    curves: Reach | None,
    named: Named,
) -> list[str]:
    """Draft one [[test]] table per level, or a comment if no channel is known to be a response."""

    def assume(what: str) -> None:
        assumed.append((files[0].name, what))

    for doubt in looked.doubts:
        assume(doubt)
    series = looked.series
    channels = _channels(files[0], series, named)
    if channels.keys().isdisjoint(RESPONSES):
        assume(messages.NO_RESPONSE)
        return [_skeleton(files, looked, channels)]
    timed = looked.fs is not None or "time" in channels or bool(_scalar_rate(looked.leaves))
    kind, is_sure = _kind_of(files[0], channels, series, is_timed=timed)
    traits = KINDS[kind]
    if traits.is_prescribed and "restoring_force" not in channels:
        channels = {"restoring_force" if r == "force" else r: c for r, c in channels.items()}
    clock = _clock(channels, looked, traits)
    channels = {role: c for role, c in channels.items() if role not in clock.unused}
    roles = {role: channel.path for role, channel in channels.items()}
    if not is_sure:
        assume(messages.guessed_kind(kind))
    lines = [
        *(messages.doubtful(doubt) for doubt in looked.doubts),
        "[[test]]",
        f"kind = {toml(kind)}" + ("" if is_sure else messages.GUESS),
        FILES,
        f"channels = {toml(roles)}{_checks(channels, assume)}",
        *_units(channels, looked, assume),
        *([messages.RELATIVE] if BASE in channels and "acceleration" not in channels else []),
        *clock.lines,
    ]
    for line in clock.assumed:
        assume(line)
    if not (clock.is_known or traits.is_prescribed):
        lines.append(_sampling(looked.leaves, assume, clock.columns))
    if traits.is_free:
        lines.append(_band(files[0], roles, lines, assume, curves))
    if traits.is_steady:
        lines.append(_tones(files[0], roles, lines, assume))
    if traits.is_stepped:
        lines.append(messages.DWELL)
    unused = [name for name in series if name not in roles.values() and name not in clock.columns]
    if unused:
        lines.append(messages.not_used(_listed(unused)))
    is_levelled = traits.is_driven and not traits.is_curve
    levels = _levels(files, roles, lines) if is_levelled else []
    at = lines.index(FILES)
    return [
        "\n".join([*lines[:at], messages.files(toml(_pattern(some)), len(some)), *level,
                   *lines[at + 1 :], ""])
        for some, level in levels or [(files, [])]
    ]  # fmt: skip


def _channels(file: Path, series: Leaves, named: Named) -> dict[str, Channel]:
    """Return the channel of each quantity; ask the user if no channel is known to be a response."""
    channels = channels_by_role(series)
    if not channels.keys().isdisjoint(RESPONSES):
        return channels
    paths = {channel.path for channel in channels.values()}
    unknown = [path for path in series if path not in paths]
    return with_roles(channels, named(file, unknown), series)


def _checks(channels: Mapping[str, Channel], assume: Assume) -> str:
    """Return the comment on channels whose quantity or axis is a guess; report each guess."""
    guessed = [r for r, c in channels.items() if c.guessed or "ampl" in last_name(c.path)]
    for role in guessed:
        assume(messages.guessed_role(role, channels[role].path))
    several = {role: _listed(c.axes) for role, c in channels.items() if c.axes}
    for role, listed in several.items():
        assume(messages.one_of_axes(role, listed))
    if guessed:
        return messages.check_roles(guessed)
    return "".join(messages.check_axes(*item) for item in several.items())


def _levels(
    files: Sequence[Path], roles: Mapping[str, str], lines: Sequence[str]
) -> list[tuple[list[Path], list[str]]]:
    """Divide files by the level of their source; return an empty list if the levels are unclear.

    Repeats of one level are nearly equal, whereas a test programme doubles or halves the level.
    """
    source = next((role for role in SOURCES if role in roles), "")
    if not source or len(files) > MOST_LEVELLED:
        return []
    peaks: dict[Path, float] = {}
    # standard deviation of the source in each file; not usable as a level if the source is constant
    spread: dict[Path, float] = {}
    with suppress(JbwError, ValueError, IndexError):
        for path in files:
            u = _first_record(path, roles, lines).channels[source]
            u = u[np.isfinite(u)]
            peaks[path], spread[path] = float(np.abs(u).max()), float(np.std(u))
    if len(peaks) < len(files) or not min(spread.values()) > 0:
        return []
    ranks = strength_ranks([spread[path] for path in files])
    parts = [sorted(np.array(files)[ranks == rank].tolist()) for rank in np.unique(ranks)[::-1]]
    weakest = [min(part, key=lambda path: spread[path]) for part in parts]
    levels = [float(f"{peaks[path]:.2g}") for path in weakest]
    return [
        (part, [messages.level(toml(level), source)])
        for part, level in zip(parts, levels, strict=True)
    ]


class DraftedClock(NamedTuple):
    """How a drafted test is sampled."""

    is_known: bool  # whether the sampling rate is known from the file
    unused: tuple[str, ...] = ()  # quantities whose channels are left out of the draft
    columns: tuple[str, ...] = ()  # channels that contain only times
    lines: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()


def _clock(channels: Mapping[str, Channel], looked: Looked, traits: Kind) -> DraftedClock:
    """Draft how a test is sampled: one clock, two rates, uneven samples or two starting times."""
    if traits.is_curve:
        return DraftedClock(True)
    leaves = {role: looked.series[c.path] for role, c in channels.items() if role != "time"}
    rates = [leaf.fs for leaf in leaves.values() if leaf.fs]
    lines: list[str] = []
    assumed: list[str] = []
    if (delay := _delay(leaves)) and abs(delay) > 0.5 / max(rates, default=1.0):
        lines.append(messages.delay(toml(delay)))
    if len(rates) == len(leaves):
        if min(rates) < (1 - 2e-5) * max(rates):
            lines.append(messages.slowest(toml(_round(min(rates)))))
        times = tuple(p for p, leaf in looked.series.items() if is_time(leaf.label or p))
        return DraftedClock(True, ("time",), times, tuple(lines), ())
    if "time" in channels:
        channel = channels["time"]
        clock = looked.series[channel.path]
        unit, fs = _of_times(channel, looked)
        if traits.is_prescribed and np.any(np.diff(np.ravel(load(clock))) <= 0):
            # A force loop needs no times.
            return DraftedClock(True, ("time",), (), tuple(lines), ())
        if not unit:  # times without a unit that only count samples
            return DraftedClock(looked.fs is not None, ("time",), (channel.path,), tuple(lines), ())
        if fs and not rates:
            lines.append(messages.mean_rate(toml(fs)))
            assumed.append(messages.coarse_times(channel.path, fs))
            return DraftedClock(True, ("time",), (channel.path,), tuple(lines), tuple(assumed))
        if rates:  # the channels' rates are below the rate of the table's times
            lines.append(messages.slowest(toml(_round(min(rates)))))
        elif proposal := _uneven(clock, unit):
            lines.append(messages.resampled(toml(proposal)))
            assumed.append(messages.resampled_at(proposal))
        return DraftedClock(True, (), (), tuple(lines), tuple(assumed))
    return DraftedClock(bool(rates) or looked.fs is not None, (), (), tuple(lines), ())


def _of_times(channel: Channel, looked: Looked) -> tuple[str, float | None]:
    """Return the unit of times ("" for counts), and their rate [Hz] if they have too few digits."""
    printed = np.ravel(np.asarray(load(looked.series[channel.path])))
    unit = channel.unit or _unit_of_times(printed, looked.fs)[0]
    return unit, coarse_rate(printed, si_of("time", unit)[0]) if unit else None


def _delay(leaves: Mapping[str, Leaf]) -> float:
    """Return the delay of the drive's start after the response's [s]; 0 if none is stated."""
    starts = [
        next((leaves[role].start_s for role in roles if role in leaves), None)
        for roles in (INPUTS, RESPONSES)
    ]
    drive, response = starts
    return 0.0 if drive is None or response is None else float(f"{drive - response:.9g}")


def _round(fs: float) -> float:
    return float(f"{fs:.9g}")


def _uneven(leaf: Leaf, unit: str) -> float | None:
    """Return a rate [Hz] for resampling uneven times; None if they are even or run backwards."""
    with suppress(JbwError):
        seconds = np.asarray(load(leaf), np.float64) * si_of("time", unit)[0]
        if len(seconds) > MOST_SAMPLES or not np.isfinite(seconds).all():
            return None
        if np.any(np.diff(seconds) <= 0):
            return None
        try:
            sampling_frequency(seconds)
        except DataError:
            return proposed_rate(seconds)
    return None


def _units(channels: Mapping[str, Channel], looked: Looked, assume: Assume) -> list[str]:
    """Return a draft's lines on units, and on the sensors of channels in volts."""
    units, guessed, sensors = {}, [], {}
    for role, channel in channels.items():
        if channel.unit:
            units[role] = channel.unit if decibels(channel.unit) else plain(channel.unit)
        elif channel.sensitivity:
            sensors[role] = channel.sensitivity
            assume(messages.in_volts(role))
        elif role == "time":
            printed = np.ravel(np.asarray(load(looked.series[channel.path])))
            units[role], is_sure = _unit_of_times(printed, looked.fs)
            if not is_sure:
                guessed.append(role)
                assume(messages.assumed_time_unit(channel.path, units[role]))
        else:
            units[role] = channel.default
            guessed.append(role)
            assume(messages.assumed_unit(role, units[role]))
    mark = messages.check_units(", ".join(guessed)) if guessed else ""
    lines = [f"units = {toml(units)}{mark}"] if units or not sensors else []
    return [*lines, messages.sensitivity(toml(sensors))] if sensors else lines


def _agrees(printed: NDArray[np.number], unit: str, fs: float | None) -> bool:
    """Return whether times in a given unit agree with the sampling rate that their file states."""
    if fs is None or not unit:
        return False
    lasts = float(printed[-1] - printed[0]) * si_of("time", unit)[0]
    return abs(lasts * fs / (len(printed) - 1) - 1) < CLOCKS


def _unit_of_times(printed: NDArray[np.number], fs: float | None) -> tuple[str, bool]:
    """Return the likely unit of times, and whether the file's sampling rate confirms it."""
    by_rate = [(unit, True) for unit in SECONDS if _agrees(printed, unit, fs)]
    return by_rate[0] if by_rate else time_unit(printed)


def _band(
    path: Path,
    roles: Mapping[str, str],
    lines: Sequence[str],
    assume: Assume,
    curves: Reach | None,
) -> str:
    """Draft a free decay's band, around the strongest spectral line of its first record.

    If there are response curves, the line is searched within their frequencies: a hammer also
    excites the suspension, which moves further than the joint's mode.
    """
    try:
        low, high = band_about_peak(_first_record(path, roles, lines), within=curves)
    except (JbwError, ValueError, IndexError):  # `jbw check` reports the cause.
        assume(messages.NO_BAND)
        return messages.EXAMPLE_BAND
    assume(messages.about_strongest(low, high))
    return messages.band(toml([low, high]))


def _first_record(path: Path, roles: Mapping[str, str], lines: Sequence[str]) -> Record:
    """Return the first record of a file, read as the drafted lines describe it."""
    stated = tomllib.loads("\n".join(lines[1:]))
    # The sensitivity of a sensor is not needed here, because it does not change the band.
    sensors = [role for line in lines if line.startswith(SENSORS)
               for role in tomllib.loads(line.lstrip("# "))["sensitivity"]]  # fmt: skip
    selection = Wanted(
        roles, stated.get("units", {}), stated.get("fs"), resample=stated.get("resample"),
        sensitivity={role: SENSITIVITIES[role] for role in sensors},
    )  # fmt: skip
    return records(path, selection)[0]


def _tones(path: Path, roles: Mapping[str, str], lines: Sequence[str], assume: Assume) -> str:
    """Draft the tone of a test: the strongest spectral line, if its source is one steady tone."""
    with suppress(JbwError, ValueError, IndexError):
        record = _first_record(path, roles, lines)
        source = record.channels[record.source]
        if course_of(source) == "tones":
            hz = float(f"{strongest_line(source, record.fs):.6g}")
            assume(messages.about_tone(hz))
            return messages.tone(toml([hz]))
    assume(messages.NO_TONES)
    return messages.EXAMPLE_TONES


def _sampling(leaves: Leaves, assume: Assume, counts: Sequence[str] = ()) -> str:
    if name := _scalar_rate(leaves):
        return messages.scalar_rate(toml(name))
    assume(messages.counts_samples(counts[0]) if counts else messages.NO_RATE)
    return messages.EXAMPLE_RATE


def _scalar_rate(leaves: Leaves) -> str:
    """Return the path of a number that is named like a sampling frequency; "" if there is none."""
    scalars = (n for n, leaf in leaves.items() if all(length == 1 for length in leaf.shape))
    return next((name for name in scalars if RATE.search(last_name(name))), "")


def _skeleton(files: Sequence[Path], looked: Looked, channels: Mapping[str, Channel]) -> str:
    """Draft a [[test]] table as a comment, which the user must complete."""
    leaves = looked.series or looked.leaves
    paths = {role: channel.path for role, channel in channels.items()}
    # The kind is taken from the file's name alone, because the drive channel is unknown.
    kind, is_sure = _kind_of(files[0], {**channels, "force": NOBODY, "restoring_force": NOBODY}, {})
    if "frequency" in paths and "force" not in paths and any(map(is_complex, leaves.values())):
        kind, is_sure = "frf", True
    traits = KINDS[kind] if is_sure else None
    roles = dict(paths)
    if traits is not None and traits.is_prescribed:
        roles = {"displacement": "...", "restoring_force": "...", **roles}
    else:
        driven = traits is None or (traits.is_driven and not traits.is_curve)
        roles |= {"force": "..."} if driven and roles.keys().isdisjoint(INPUTS) else {}
        roles["acceleration"] = "..."
    units = {role: channels[role].unit if role in channels else "" for role in roles}
    units = {role: unit or "..." for role, unit in units.items() if role != "time"}
    rate = ""
    if "time" in paths:
        unit, fs = _of_times(channels["time"], looked)
        rate = (
            "" if unit and not fs else messages.mean_rate(toml(fs)) if fs else messages.EXAMPLE_RATE
        )
        if rate:
            del paths["time"], roles["time"]
        elif not channels["time"].unit:
            units["time"] = unit
    timed = "time" in paths or any(leaf.fs for leaf in leaves.values()) or looked.fs is not None
    timed = timed or (traits is not None and traits.is_curve)
    lines = [
        *(messages.doubtful(doubt) for doubt in looked.doubts),
        messages.name_channels(toml(files[0].name), _listed(leaves)),
        "# [[test]]",
        messages.kind(toml(kind if is_sure else "..."), ", ".join(KINDS)),
        f"# files = {toml(_pattern(files))}",
        f"# channels = {toml(roles)}",
        f"# units = {toml(units)}",
        *(
            []
            if timed
            else ["# " + (rate or _sampling(looked.leaves, lambda _: None)).lstrip("# ")]
        ),
    ]
    if sources := {role: _pattern(files) for role in paths if role in INPUTS}:
        separate_files = toml({**sources, "velocity": "..."})
        lines.append(messages.separate_files(separate_files))
    return "\n".join(lines) + "\n"


def _pattern(files: Sequence[Path]) -> str | list[str]:
    if len(files) == 1:
        return files[0].name
    pattern = f"{_stem(files[0])[0]}*{files[0].suffix}"
    also = {p for p in files[0].parent.glob(pattern) if p.is_file()}
    # A pattern is shorter than a list of names, but must match the listed files and no others.
    return pattern if also == set(files) else [path.name for path in files]


def _listed(series_names: Collection[str]) -> str:
    # The names are in TOML quotes, so that they cannot end the comment, whatever they contain.
    some = [toml(name) for name in list(series_names)[:LISTED]]
    more = len(series_names) - len(some)
    return (", ".join(some) or "nothing") + (f" and {more} more" if more else "")


def _series_in(leaves: Leaves) -> dict[str, Leaf]:
    """Return the series in a file by their paths: vectors, and the columns of narrow tables."""
    series: dict[str, Leaf] = {}
    for name, leaf in leaves.items():
        long = [length for length in leaf.shape if length > 1]
        if len(long) == 1:
            series[name] = leaf
        elif len(leaf.shape) == 2 and min(long, default=0) <= FEW_COLUMNS < max(long, default=0):
            before = "" if leaf.shape[0] < leaf.shape[1] else ":, "
            series |= {f"{name}[{before}{i}]": leaf for i in range(min(long))}
    return series


def _records_in(series: Leaves) -> list[dict[str, Leaf]]:
    """Divide a file's series by the struct that contains them, if all structs are alike."""
    groups: dict[str, dict[str, Leaf]] = {}
    for name, leaf in series.items():
        groups.setdefault(name.rpartition(".")[0], {})[name] = leaf
    named = {frozenset((last_name(n), x.label) for n, x in g.items()) for g in groups.values()}
    same_names = len(groups) > 1 and len(named) == 1
    return list(groups.values()) if same_names else [dict(series)]


def _kind_of(
    path: Path, roles: Mapping[str, Channel], series: Leaves, *, is_timed: bool = True
) -> tuple[str, bool]:
    """Return the likely kind of a test from file name and channels, and whether it is certain."""
    if kind := controlled_kind(roles, series):
        return kind, True
    if {"frequency", "phase"} <= set(roles):
        return "frf", True
    response = next((r for r in RESPONSES if r in roles), "")
    if response and "frequency" in roles:
        leaf = series.get(roles[response].path)
        if leaf is not None and is_complex(leaf):
            return "frf", True
    name = path.stem.lower()
    driven = not roles.keys().isdisjoint(SOURCES)
    looped = "restoring_force" in roles or {"force", "displacement"} <= set(roles)
    fitting = {"decay": True, "loop": looped, "frf": False}
    for hint, kind in {**{kind: kind for kind in KINDS}, **KIND_HINTS}.items():
        if hint in name and fitting.get(kind, driven):
            return kind, True
    if not driven and {"restoring_force", "displacement"} <= set(roles):
        return "loop", True
    if driven and {"force", "displacement"} <= set(roles):
        # A cyclic test needs no times, but a forced motion does.
        clocked = is_timed or any(series[roles[r].path].fs for r in ("force", "displacement"))
        if not clocked or _follows(roles, series):
            return "loop", False
    if not driven:
        samples = _samples_of(series, roles[response].path) if response else None
        return "decay", samples is not None and falls(samples)
    source = next(role for role in SOURCES if role in roles)
    samples = _samples_of(series, roles[source].path)
    course = None if samples is None else course_of(samples)
    return course or "sweep", course is not None


def _samples_of(series: Leaves, path: str) -> NDArray[np.float64] | None:
    """Return a channel's samples if they are one series of real numbers of moderate length."""
    leaf = series.get(path)
    if leaf is None or len(leaf.shape) != 1 or leaf.shape[0] > MOST_SAMPLES or is_complex(leaf):
        return None
    with suppress(ValueError, TypeError):
        return np.asarray(load(leaf), np.float64)
    return None


def _follows(roles: Mapping[str, Channel], series: Leaves) -> bool:
    """Return whether force and displacement form a loop, and are not a drive and its response.

    A driving force is a quarter period apart from the displacement near a resonance, and opposite
    to it far above.
    """
    pair = [series[roles[role].path] for role in ("force", "displacement")]
    if pair[0].shape != pair[1].shape or max(pair[0].shape) > MOST_SAMPLES:
        return False
    force, displacement = (np.asarray(load(leaf), np.float64) for leaf in pair)
    finite = np.isfinite(force) & np.isfinite(displacement)
    if finite.sum() < 3 or not (np.ptp(force[finite]) and np.ptp(displacement[finite])):
        return False
    force, displacement = force[finite], displacement[finite]
    # On a wide loop, force and displacement are also a quarter period apart, but they rise and fall
    # together.
    steps = np.diff(force) * np.diff(displacement)
    together = float(steps.sum() / max(float(np.abs(steps).sum()), 1e-300))
    return max(float(np.corrcoef(force, displacement)[0, 1]), together) > FOLLOWING
