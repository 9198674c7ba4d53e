"""A first campaign file from what lies in a folder, with comments and every guess marked."""

import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from jbw.campaign.guessing import kind_of, last_name, records_in, roles_of, series_in
from jbw.campaign.keys import CAMPAIGN, IDENTIFY, RESPONSES, SOURCES, TEST, Key
from jbw.errors import ConfigError, DataError, JbwError
from jbw.measurement.files.door import channels_of
from jbw.measurement.files.opening import READERS
from jbw.measurement.files.tree import Leaf
from jbw.measurement.roles import QUANTITIES
from jbw.units import si_unit

NAMED = "campaign.toml"
LISTED = 12  # channels named in a comment
MOST_BLOCKS = 40  # tests drafted from one file
# Keys of a test that are offered in a comment.
OPTIONAL = ("level", "band", "delay", "assembly", "run", "exclude", "span")


@dataclass(frozen=True)
class Draft:
    """A campaign file not yet written.

    Attributes:
        text: TOML.
        assumed: What the records did not say, one line each.
    """

    text: str
    assumed: tuple[str, ...]


def start_campaign(folder: str | Path) -> Draft:
    """Look at the measurement files of a folder and draft its campaign file.

    Files whose names differ only in their last number are repeats of one test.

    Raises:
        DataError: No such folder, or no measurement file in it that can be read.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise DataError(f"Folder `{folder}` does not exist.", remedy="Name the folder of records.")
    assumed: list[str] = []
    blocks = [block for files in _groups(folder) for block in _blocks(files, assumed)]
    if not any("[[test]]" in block for block in blocks):
        raise DataError(
            f"Folder `{folder}` has no measurement file that can be read.",
            remedy=" ".join(["Suffixes: " + ", ".join(READERS) + ".", *assumed]),
        )
    text = "\n".join([_head(folder), *blocks, _foot()])
    return Draft(text, tuple(assumed))


def write_campaign(draft: Draft, folder: str | Path) -> Path:
    """Write a draft as `campaign.toml`, unless there is one.

    Raises:
        ConfigError: The folder has a campaign file already.
    """
    path = Path(folder) / NAMED
    try:
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666), "wb") as file:
            file.write(draft.text.encode())
    except FileExistsError:
        raise ConfigError(
            f"`{path}` exists already, and is not overwritten.",
            remedy="See the draft with: jbw init --print FOLDER",
        ) from None
    return path


def _groups(folder: Path) -> Iterator[list[Path]]:
    """Files by test: equal names but for the last number."""
    files = [p for p in folder.iterdir() if p.is_file() and p.suffix.lower() in READERS]
    visible = sorted((p for p in files if not p.name.startswith(".")), key=_stem)
    for _, group in groupby(visible, key=_stem):
        yield sorted(group)


def _stem(path: Path) -> tuple[str, str]:
    return re.sub(r"\d+$", "", path.stem), path.suffix.lower()


def _blocks(files: Sequence[Path], assumed: list[str]) -> list[str]:
    """The [[test]] tables of some files, or a comment where they cannot be a test."""
    first = files[0]
    try:
        leaves = channels_of(first)
    except JbwError as error:
        assumed.append(error.what)
        return ["".join(f"# {line}\n" for line in error.what.splitlines())]
    found = records_in(series_in(leaves))
    blocks = [_block(files, series, leaves, assumed) for series in found[:MOST_BLOCKS]]
    if len(found) > MOST_BLOCKS:
        blocks.append(f"# {len(found) - MOST_BLOCKS} more groups like these are in the file.\n")
    return blocks


def _block(
    files: Sequence[Path],
    series: Mapping[str, Leaf],
    leaves: Mapping[str, Leaf],
    assumed: list[str],
) -> str:
    """One [[test]] table; as a comment where no channel is named like a response."""
    first, roles = files[0], roles_of(series)
    if not RESPONSES & set(roles):
        assumed.append(f"{first.name}: no channel is named like a response.")
        return _skeleton(files, series or leaves)
    kind, known = kind_of(first, roles)
    notes = [] if known else [f"{first.name}: kind {kind!r} is a guess."]
    guessed = [role for role, name in roles.items() if "ampl" in last_name(name)]
    notes += [f"{first.name}: role {role} of {roles[role]} is a guess." for role in guessed]
    lines = [
        "[[test]]",
        f"kind = {_toml(kind)}" + ("" if known else "  # CHECK: a guess"),
        f"files = {_toml(_pattern(files))}  # {len(files)} file(s), one repeat each",
        f"channels = {_inline(roles)}"
        + (f"  # CHECK: {', '.join(guessed)} is a guess" if guessed else ""),
    ]
    lines += _units(first, roles, series, notes)
    lines += [] if kind == "frf" else _sampling(first, roles, series, leaves, notes)
    if kind in ("tones", "stepped"):
        lines += ["tones = [1.0]  # CHECK: frequencies [Hz]"]
        notes.append(f"{first.name}: tones must be given.")
        lines += ["dwell = 1.0  # CHECK: duration of each step [s]"] if kind == "stepped" else []
    others = [name for name in series if name not in roles.values()]
    lines += [f"# not used: {_listed(others)}"] if others else []
    assumed += notes
    return "\n".join([*lines, *_commented(TEST, OPTIONAL)]) + "\n"


def _skeleton(files: Sequence[Path], found: Mapping[str, Leaf]) -> str:
    """A [[test]] table to be filled in by hand, commented out."""
    lines = [
        f"# CHECK: name the channels of {_toml(files[0].name)} by hand, from {_listed(found)}.",
        "# [[test]]",
        '# kind = "sweep"',
        f"# files = {_toml(_pattern(files))}",
        '# channels = { input = "...", velocity = "..." }',
        '# units = { input = "V", velocity = "m/s" }',
        "# fs = 1024.0",
    ]
    sources = {role: _pattern(files) for role in roles_of(found) if role in SOURCES}
    if sources:
        own = _inline({**sources, "velocity": "..."})
        lines.append(f"# where the response lies in files of its own: files = {own}")
    return "\n".join(lines) + "\n"


def _units(
    path: Path, roles: Mapping[str, str], leaves: Mapping[str, Leaf], notes: list[str]
) -> list[str]:
    units = {
        role: leaves[name].unit or si_unit(QUANTITIES[role][0])
        for role, name in roles.items()
        if role != "time" or leaves[name].unit  # seconds, unless the file says otherwise
    }
    guessed = [role for role in units if not leaves[roles[role]].unit]
    if not guessed:
        return [f"units = {_inline(units)}"]
    notes += [f"{path.name}: unit of {role} assumed to be {units[role]}." for role in guessed]
    return [f"units = {_inline(units)}  # CHECK: not in the file for {', '.join(guessed)}"]


def _sampling(
    path: Path,
    roles: Mapping[str, str],
    series: Mapping[str, Leaf],
    leaves: Mapping[str, Leaf],
    notes: list[str],
) -> list[str]:
    if "time" in roles or any(series[name].fs for name in roles.values()):
        return []
    scalars = [name for name, leaf in leaves.items() if all(n == 1 for n in leaf.shape)]
    scalar = next((n for n in scalars if n.lower().strip("_") in ("fs", "fs_hz")), "")
    if scalar:
        return [f"fs = {_toml(scalar)}  # the scalar of that name in the file"]
    notes.append(f"{path.name}: the sampling frequency fs must be given.")
    return ["# fs = 1024.0  # CHECK: sampling frequency [Hz], not in the file"]


def _pattern(files: Sequence[Path]) -> str | list[str]:
    if len(files) == 1:
        return files[0].name
    pattern = f"{_stem(files[0])[0]}*{files[0].suffix}"
    also = {p for p in files[0].parent.glob(pattern) if p.is_file()}
    # The pattern is only shorter to read; it must mean these files and no other.
    return pattern if also == set(files) else [path.name for path in files]


def _head(folder: Path) -> str:
    name = folder.resolve().name or "campaign"
    lines = [
        "# Campaign file of jbw. Lines marked CHECK hold what the records do not say.",
        "# See what jbw makes of it: jbw check campaign.toml",
        "# Channels are paths, such as group.name: [3] is the fourth item, counted from zero; (4)",
        "# and {4} are it counted from one, as in MATLAB; [:] takes all; 'a - b' is a difference.",
        "",
        "[campaign]",
        f"name = {_toml(name)}",
    ]
    return "\n".join([*lines, *_commented(CAMPAIGN, ("modal_mass", "gain"))]) + "\n"


def _foot() -> str:
    return "\n".join(["# [identify]", *_commented(IDENTIFY, list(IDENTIFY))]) + "\n"


def _commented(keys: Mapping[str, Key], names: Sequence[str]) -> list[str]:
    return [f"# {name} = {keys[name].example}  # {keys[name].says}" for name in names]


def _listed(found: Sequence[str] | Mapping[str, Leaf]) -> str:
    # As TOML strings: a name from a file must not end the comment's line.
    some = [_toml(name) for name in list(found)[:LISTED]]
    more = len(found) - len(some)
    return (", ".join(some) or "nothing") + (f" and {more} more" if more else "")


def _inline(table: Mapping[str, str | list[str]]) -> str:
    return "{ " + ", ".join(f"{key} = {_toml(value)}" for key, value in table.items()) + " }"


def _toml(value: object) -> str:
    """A TOML value; JSON's strings and lists of strings are valid TOML."""
    return json.dumps(value, ensure_ascii=False)
