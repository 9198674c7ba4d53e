"""A first campaign file from what lies in a folder, with comments and every guess marked."""

import re
import tomllib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np

from jbw.campaign.document import commented, toml
from jbw.campaign.settings import Identify
from jbw.campaign.tables import Head, TestSpec
from jbw.errors import ConfigError, DataError, JbwError, RunError
from jbw.measurement.files.assemble import Wanted
from jbw.measurement.files.paths import select
from jbw.measurement.files.read import READERS, channels_of, opened, records
from jbw.measurement.files.tree import RATE, Leaf, load
from jbw.measurement.kinds import KINDS
from jbw.measurement.records import INPUTS, QUANTITIES, RESPONSES, ROLES, si_of
from jbw.measurement.response_checks import band_about_peak
from jbw.units import quantity_of, si_unit

HEAD = """\
# Campaign file of jbw. Lines marked CHECK hold what the records do not say.
# See what jbw makes of it: jbw check campaign.toml
# Channels are paths, such as group.name: [3] is the fourth item, counted from zero; (4)
# and {4} are it counted from one, as in MATLAB; [:] takes all; 'a - b' is a difference.

[campaign]"""
FURTHER = "# Further keys of a [[test]], to be written below its line `kind`:"
NAMED = "campaign.toml"
LISTED = 12  # channels named in a comment
MOST_GROUPS = 500  # names of files that are not repeats of one another
MOST_BLOCKS = 40  # tests drafted from one file
# Keys of a test that are offered in a comment.
OPTIONAL = ("level", "band", "delay", "assembly", "run", "exclude", "span")
# A channel's name to its role, most telling first.
HINTS = (
    (r"^t$|time|zeit", "time"),
    (r"restoring|friction", "restoring_force"),
    (r"^freq|^f_?hz$", "frequency"),
    (r"phase|^phi$", "phase"),
    (r"vel|laser|vib|^v$|ldv", "velocity"),
    (r"acc", "acceleration"),
    (r"dis[pl]|lvdt|^[yx]$|pos", "displacement"),
    (r"force|load|^f$", "force"),
    (r"input|shaker|volt|drive|source|amp|^u$|^v1$", "input"),
)
KIND_HINTS = dict(step="stepped", tone="tones", hammer="decay", impact="decay", msine="multisine",
                  sinesw="sweep")  # fmt: skip
Assume = Callable[[str], None]
Leaves = Mapping[str, Leaf]
Reach = tuple[float, float]  # lowest and highest frequency [Hz]
FEW_COLUMNS = 16  # a table of more is no record of a few channels


@dataclass(frozen=True)
class Draft:
    """A campaign file not yet written."""

    text: str  # TOML
    assumed: tuple[str, ...]  # what the records did not say, one line each


def start_campaign(folder: str | Path) -> Draft:
    """Look at the measurement files of a folder and draft its campaign file.

    Files whose names differ only in their last number are repeats of one test.

    Raises:
        DataError: No such folder, or no measurement file in it that can be read.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise DataError(f"Folder `{folder}` does not exist.", remedy="Name the folder of records.")
    visible = sorted(_measurement_files(folder), key=_stem)
    assumed: list[tuple[str, str]] = []  # file and what was assumed of it
    blocks = []
    groups = [sorted(repeats) for _, repeats in groupby(visible, key=_stem)]
    if len(groups) > MOST_GROUPS:
        raise DataError(
            f"Folder `{folder}` holds {len(visible)} measurement files of {len(groups)} names, "
            f"more than a campaign of {MOST_GROUPS} tests.",
            why="Files whose names differ only in their last number are repeats of one test.",
            remedy="Put the records of one joint into a folder of its own, or number its repeats: "
            f"sweep_1{visible[0].suffix}, sweep_2{visible[0].suffix}.",
        )
    curves = _frequencies_of_curves(groups)
    for repeats in groups:
        blocks += _blocks(repeats, assumed, curves)
    if not any("[[test]]" in block for block in blocks):
        raise DataError(
            f"Folder `{folder}` has no measurement file that can be read.",
            remedy=" ".join(["Suffixes: " + ", ".join(READERS) + ".", *_once(assumed)]),
        )
    name = f"name = {toml(folder.resolve().name or 'campaign')}"
    head = [HEAD, name, *commented(Head, ("modal_mass", "gain")), ""]
    drafted = any("\nband = " in block for block in blocks)
    further = commented(TestSpec, [key for key in OPTIONAL if not (drafted and key == "band")])
    foot = [FURTHER, *further, "", "# [identify]", *commented(Identify, Identify.model_fields), ""]
    return Draft("\n".join([*head, *blocks, *foot]), tuple(_once(assumed)))


def _once(assumed: Sequence[tuple[str, str]]) -> Iterator[str]:
    """Every assumption in one line with all the files that it concerns."""
    files: dict[str, list[str]] = {}
    for name, what in assumed:
        files.setdefault(what, []).append(name)
    for what, names in files.items():
        shown = [name for name in names[:LISTED] if name]
        more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
        yield f"{', '.join(shown)}{more}: {what}" if shown else what


def _measurement_files(folder: Path) -> list[Path]:
    """Files of a folder that a reader knows by their suffix, but for hidden ones."""
    try:
        named = [p for p in folder.iterdir() if p.suffix.lower() in READERS]
        return [p for p in named if not p.name.startswith(".") and p.is_file()]
    except OSError as error:
        raise DataError(
            f"Folder `{folder}` cannot be read: {error.strerror or error}.",
            remedy="Give yourself the right to read it, or copy the records to a folder of yours.",
        ) from error


def write_campaign(draft: Draft, folder: str | Path) -> Path:
    """Write a draft as `campaign.toml`; a ConfigError where there is one already."""
    path = Path(folder) / NAMED
    try:
        with path.open("xb") as file:
            file.write(draft.text.encode())
    except FileExistsError:
        raise ConfigError(
            f"`{path}` exists already, and is not overwritten.",
            remedy="See the draft with: jbw init --print FOLDER",
        ) from None
    except OSError as error:
        path.unlink(missing_ok=True)  # what a full disk left of it
        raise RunError(
            f"`{path}` cannot be written: {error.strerror or error}.",
            remedy="Free some space, or make the folder writable; or keep the draft elsewhere: "
            f"jbw init --print {folder} > campaign.toml",
        ) from error
    return path


def _stem(path: Path) -> tuple[str, str]:
    """What the repeats of a test share: the name but for its last number, and the suffix."""
    return re.sub(r"\d+$", "", path.stem), path.suffix.lower()


def _frequencies_of_curves(groups: Sequence[Sequence[Path]]) -> Reach | None:
    """Lowest and highest frequency of response curves [Hz], among which the joint's mode lies."""
    found: list[float] = []
    for files in groups:
        with suppress(JbwError):
            series = _series_in(channels_of(files[0]))
            roles = _roles_of(series)
            if not {"frequency", "phase"} <= set(roles):
                continue
            with opened(files[0]) as contents:
                leaf = select(contents.root, roles["frequency"])
                if isinstance(leaf, Leaf):
                    hz = load(leaf) * si_of("frequency", leaf.unit or "Hz")[0]
                    found += [float(np.nanmin(hz)), float(np.nanmax(hz))]
    return (min(found), max(found)) if found else None


def _blocks(
    files: Sequence[Path], assumed: list[tuple[str, str]], curves: Reach | None
) -> list[str]:
    """The [[test]] tables of some files, or a comment where they cannot be a test."""
    try:
        leaves = channels_of(files[0])
    except JbwError as error:
        assumed.append(("", error.what))
        return ["".join(f"# {line}\n" for line in error.what.splitlines())]
    found = _records_in(_series_in(leaves))
    blocks = [_block(files, series, leaves, assumed, curves) for series in found[:MOST_BLOCKS]]
    if len(found) > MOST_BLOCKS:
        blocks.append(f"# {len(found) - MOST_BLOCKS} more groups like these are in the file.\n")
    return blocks


def _block(
    files: Sequence[Path],
    series: Leaves,
    leaves: Leaves,
    assumed: list[tuple[str, str]],
    curves: Reach | None,
) -> str:
    """One [[test]] table; as a comment where no channel is named like a response."""

    def assume(what: str) -> None:
        assumed.append((files[0].name, what))

    roles = _roles_of(series)
    if roles.keys().isdisjoint(RESPONSES):
        assume("no channel is named like a response.")
        return _skeleton(files, series, leaves)
    kind, known = _kind_of(files[0], roles)
    traits = KINDS[kind]
    if not known:
        assume(f"kind {kind!r} is a guess.")
    guessed = [role for role, name in roles.items() if "ampl" in _last_name(name)]
    for role in guessed:
        assume(f"role {role} of {roles[role]} is a guess.")
    lines = [
        "[[test]]",
        f"kind = {toml(kind)}" + ("" if known else "  # CHECK: a guess"),
        f"files = {toml(_pattern(files))}  # {len(files)} file(s), one repeat each",
        f"channels = {toml(roles)}"
        + (f"  # CHECK: {', '.join(guessed)} is a guess" if guessed else ""),
        _units({role: series[name] for role, name in roles.items()}, assume),
    ]
    timed = "time" in roles or any(series[name].fs for name in roles.values())
    timed = timed or _states_rate(files[0])
    if not traits.is_curve and not timed:
        lines.append(_sampling(leaves, assume))
    if traits.is_free:
        lines.append(_band(files[0], roles, lines, assume, curves))
    if traits.is_steady:
        lines.append("tones = [1.0]  # CHECK: frequencies [Hz]")
        assume("tones must be given.")
    if traits.is_stepped:
        lines.append("dwell = 1.0  # CHECK: duration of each step [s]")
    if unused := [name for name in series if name not in roles.values()]:
        lines.append(f"# not used: {_listed(unused)}")
    return "\n".join(lines) + "\n"


def _units(channels: Leaves, assume: Assume) -> str:
    units, guessed = {}, []
    for role, leaf in channels.items():
        if leaf.unit:
            units[role] = leaf.unit
        elif role != "time":  # seconds, unless the file says otherwise
            units[role] = si_unit(QUANTITIES[role][0])
            guessed.append(role)
            assume(f"unit of {role} assumed to be {units[role]}.")
    mark = f"  # CHECK: not in the file for {', '.join(guessed)}" if guessed else ""
    return f"units = {toml(units)}{mark}"


def _band(
    path: Path,
    roles: Mapping[str, str],
    lines: Sequence[str],
    assume: Assume,
    curves: Reach | None,
) -> str:
    """The band of a free decay, about the strongest line of its first record.

    Where response curves lie beside it, of those among their frequencies: a hammer excites the
    suspension as well, which moves further than the joint's mode.
    """
    try:
        stated = tomllib.loads("\n".join(lines[1:]))
        wanted = Wanted(roles, stated["units"], stated.get("fs"))
        low, high = band_about_peak(records(path, wanted)[0], within=curves)
    except (JbwError, ValueError, IndexError):  # for `jbw check` to say
        assume("band must be given.")
        return "# band = [5.0, 40.0]  # CHECK: frequencies around the one mode [Hz]"
    assume(f"band {low:g} to {high:g} Hz is about the strongest line.")
    return f"band = {toml([low, high])}  # CHECK: about the strongest line; no other mode in it"


def _states_rate(path: Path) -> bool:
    """Whether a file gives one sampling frequency for all that it holds."""
    with opened(path) as contents:
        return contents.fs is not None


def _sampling(leaves: Leaves, assume: Assume) -> str:
    for name, leaf in leaves.items():
        is_scalar = all(length == 1 for length in leaf.shape)
        if is_scalar and RATE.search(_last_name(name)):
            return f"fs = {toml(name)}  # the scalar of that name in the file"
    assume("the sampling frequency fs must be given.")
    return "# fs = 1024.0  # CHECK: sampling frequency [Hz], not in the file"


def _skeleton(files: Sequence[Path], series: Leaves, leaves: Leaves) -> str:
    """A [[test]] table to be filled in by hand, commented out, with the units of the file."""
    found = series or leaves
    known = _roles_of(found)
    # By the file's name alone: which of its channels drives is not known.
    kind, said = _kind_of(files[0], {**known, "force": "", "restoring_force": ""})
    traits = KINDS[kind] if said else None
    roles = dict(known)
    if traits is not None and traits.is_prescribed:
        roles = {"displacement": "...", "restoring_force": "...", **roles}
    else:
        driven = traits is None or traits.is_driven
        roles |= {"force": "..."} if driven and roles.keys().isdisjoint(INPUTS) else {}
        roles["acceleration"] = "..."
    units = {role: found[name].unit if name in found else "" for role, name in roles.items()}
    units = {role: unit or "..." for role, unit in units.items() if role != "time"}
    timed = "time" in known or any(leaf.fs for leaf in found.values()) or _states_rate(files[0])
    lines = [
        f"# CHECK: name the channels of {toml(files[0].name)} by hand, from {_listed(found)}.",
        "# [[test]]",
        f"# kind = {toml(kind if said else '...')}  # one of {', '.join(KINDS)}",
        f"# files = {toml(_pattern(files))}",
        f"# channels = {toml(roles)}",
        f"# units = {toml(units)}",
        *([] if timed else ["# " + _sampling(leaves, lambda _: None).lstrip("# ")]),
    ]
    if sources := {role: _pattern(files) for role in _roles_of(found) if role in INPUTS}:
        own = toml({**sources, "velocity": "..."})
        lines.append(f"# where the response lies in files of its own: files = {own}")
    return "\n".join(lines) + "\n"


def _pattern(files: Sequence[Path]) -> str | list[str]:
    if len(files) == 1:
        return files[0].name
    pattern = f"{_stem(files[0])[0]}*{files[0].suffix}"
    also = {p for p in files[0].parent.glob(pattern) if p.is_file()}
    # The pattern is only shorter to read; it must mean these files and no other.
    return pattern if also == set(files) else [path.name for path in files]


def _listed(found: Collection[str]) -> str:
    # As TOML strings: a name from a file must not end the comment's line.
    some = [toml(name) for name in list(found)[:LISTED]]
    more = len(found) - len(some)
    return (", ".join(some) or "nothing") + (f" and {more} more" if more else "")


def _series_in(leaves: Leaves) -> dict[str, Leaf]:
    """The arrays that are one series, and the rows or columns of narrow tables, by their paths."""
    found: dict[str, Leaf] = {}
    for name, leaf in leaves.items():
        long = [length for length in leaf.shape if length > 1]
        if len(long) == 1:
            found[name] = leaf
        elif len(leaf.shape) == 2 and min(long, default=0) <= FEW_COLUMNS < max(long, default=0):
            before = "" if leaf.shape[0] < leaf.shape[1] else ":, "
            found |= {f"{name}[{before}{i}]": leaf for i in range(min(long))}
    return found


def _records_in(series: Leaves) -> list[dict[str, Leaf]]:
    """Series by the struct or group that they lie in, where several hold the same names."""
    groups: dict[str, dict[str, Leaf]] = {}
    for name, leaf in series.items():
        groups.setdefault(name.rpartition(".")[0], {})[name] = leaf
    alike = len(groups) > 1 and len({frozenset(map(_last_name, g)) for g in groups.values()}) == 1
    return list(groups.values()) if alike else [dict(series)]


def _last_name(path: str) -> str:
    """The last name of a path, without what follows in brackets."""
    return re.split(r"[./]", re.sub(r"\[[^\]]*\]", "", path))[-1].lower()


def _roles_of(series: Leaves) -> dict[str, str]:
    """Role to channel, by the channels' names, and by their units where the file gives them."""
    roles: dict[str, str] = {}
    for name, leaf in series.items():
        if (role := _role(name, leaf.unit)) and role not in roles:
            roles[role] = name
    unanswered = roles.keys().isdisjoint(RESPONSES)
    if unanswered and {"frequency", "phase", "force", "input"} <= set(roles):
        # Beside a force and a phase, an amplitude is that of the response.
        roles["acceleration"] = roles.pop("input")
    return roles


def _role(name: str, unit: str) -> str:
    """What a channel is by its name, unless its unit says otherwise; nothing where unknown."""
    last = _last_name(name)
    by_name = [last] if last in ROLES else []
    by_name += [role for pattern, role in HINTS if re.search(pattern, last)]
    for role in by_name:
        with suppress(ConfigError):  # another unit than the role's
            if unit:
                quantity_of(unit, QUANTITIES[role])
            return role
    return ""


def _kind_of(path: Path, roles: Mapping[str, str]) -> tuple[str, bool]:
    """Kind of a test by its file's name and channels, and whether these say so."""
    if {"frequency", "phase"} <= set(roles):
        return "frf", True
    name = path.stem.lower()
    driven = not roles.keys().isdisjoint(INPUTS)
    fitting = {"decay": True, "loop": "restoring_force" in roles, "frf": False}
    for hint, kind in {**{kind: kind for kind in KINDS}, **KIND_HINTS}.items():
        if hint in name and fitting.get(kind, driven):
            return kind, True
    if not driven and {"restoring_force", "displacement"} <= set(roles):
        return "loop", False
    return ("sweep" if driven else "decay"), False
