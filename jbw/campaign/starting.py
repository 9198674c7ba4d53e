"""A first campaign file from what lies in a folder, with comments and every guess marked."""

import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from jbw.campaign.keys import CAMPAIGN, IDENTIFY, KINDS, RESPONSES, SOURCES, TEST, Key
from jbw.errors import ConfigError, DataError, JbwError
from jbw.measurement.files.door import channels_of
from jbw.measurement.files.opening import READERS
from jbw.measurement.files.tree import Leaf
from jbw.measurement.roles import QUANTITIES, ROLES, si_of
from jbw.units import si_unit

# A channel's name to its role, most telling first.
HINTS = (
    (r"^t$|time|zeit", "time"),
    (r"restoring|friction", "restoring_force"),
    (r"vel|laser|vib|^v$|ldv", "velocity"),
    (r"acc", "acceleration"),
    (r"dis[pl]|lvdt|^[yx]$|pos", "displacement"),
    (r"force|load|^f$", "force"),
    (r"input|shaker|volt|drive|source|amp|^u$|^v1$", "input"),
)
KIND_HINTS = {"step": "stepped", "tone": "tones", "hammer": "decay", "impact": "decay"}
NAMED = "campaign.toml"
LISTED = 12  # channels named in a comment


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
    blocks = [_block(files, assumed) for files in _groups(folder)]
    if not any(block.startswith("[[test]]") for block in blocks):
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


def _block(files: Sequence[Path], assumed: list[str]) -> str:
    """One [[test]] table, or a comment where the files cannot be a test."""
    first = files[0]
    try:
        leaves = {name: leaf for name, leaf in channels_of(first).items() if _is_series(leaf)}
    except JbwError as error:
        assumed.append(error.what)
        return "".join(f"# {line}\n" for line in error.what.splitlines())
    roles = _roles(leaves)
    if not RESPONSES & set(roles):
        assumed.append(f"{first.name}: no channel is named like a response.")
        return f"# {_toml(first.name)}: name the channels by hand, from {_listed(leaves)}.\n"
    kind, known = _kind(first, roles)
    notes = [] if known else [f"{first.name}: kind {kind!r} is a guess."]
    lines = [
        "[[test]]",
        f"kind = {_toml(kind)}" + ("" if known else "  # CHECK"),
        f"files = {_toml(_pattern(files))}  # {len(files)} file(s), one repeat each",
        f"channels = {_inline(roles)}",
    ]
    lines += _units(first, roles, leaves, notes)
    lines += _sampling(first, roles, leaves, notes)
    if kind in ("tones", "stepped"):
        lines += ["tones = [1.0]  # CHECK: frequencies [Hz]"]
        notes.append(f"{first.name}: tones must be given.")
        lines += ["dwell = 1.0  # CHECK: duration of each step [s]"] if kind == "stepped" else []
    others = [name for name in leaves if name not in roles.values()]
    lines += [f"# not used: {_listed(others)}"] if others else []
    assumed += notes
    optional = ("level", "band", "delay", "assembly", "run", "exclude", "span")
    return "\n".join([*lines, *_commented(TEST, optional)]) + "\n"


def _is_series(leaf: Leaf) -> bool:
    return sum(length > 1 for length in leaf.shape) == 1


def _roles(leaves: Mapping[str, Leaf]) -> dict[str, str]:
    """Role to channel, by the channels' names, and by their units where the file gives them."""
    roles: dict[str, str] = {}
    for name, leaf in leaves.items():
        role = _role(name, leaf.unit)
        if role and role not in roles:
            roles[role] = name
    return roles


def _role(name: str, unit: str) -> str:
    last = re.split(r"[./]", name)[-1].lower()
    by_name = [last] if last in ROLES else []
    by_name += [role for pattern, role in HINTS if re.search(pattern, last)]
    return next((role for role in by_name if _agrees(role, unit)), "")


def _agrees(role: str, unit: str) -> bool:
    if not unit:
        return True
    try:
        si_of(role, unit)
    except ConfigError:
        return False
    return True


def _kind(path: Path, roles: Mapping[str, str]) -> tuple[str, bool]:
    """Kind of a test by its file's name, and whether the name says so."""
    name = path.stem.lower()
    driven = bool(SOURCES & set(roles))
    fitting = {"decay": True, "loop": "restoring_force" in roles, "frf": "phase" in roles}
    for hint, kind in {**{kind: kind for kind in KINDS}, **KIND_HINTS}.items():
        if hint in name and fitting.get(kind, driven):
            return kind, True
    return ("sweep" if driven else "decay"), False


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
    path: Path, roles: Mapping[str, str], leaves: Mapping[str, Leaf], notes: list[str]
) -> list[str]:
    if "time" in roles or any(leaves[name].fs for name in roles.values()):
        return []
    scalar = next((n for n in _scalars(path) if n.lower().strip("_") in ("fs", "fs_hz")), "")
    if scalar:
        return [f"fs = {_toml(scalar)}  # the scalar of that name in the file"]
    notes.append(f"{path.name}: the sampling frequency fs must be given.")
    return ["# fs = 1024.0  # CHECK: sampling frequency [Hz], not in the file"]


def _scalars(path: Path) -> list[str]:
    return [name for name, leaf in channels_of(path).items() if all(n == 1 for n in leaf.shape)]


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


def _inline(table: Mapping[str, str]) -> str:
    return "{ " + ", ".join(f"{key} = {_toml(value)}" for key, value in table.items()) + " }"


def _toml(value: object) -> str:
    """A TOML value; JSON's strings and lists of strings are valid TOML."""
    return json.dumps(value, ensure_ascii=False)
