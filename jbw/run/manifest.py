"""The request and the inputs of a run: enough to resume it, and to refuse if they changed."""

import hashlib
import json
import os
import platform
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from itertools import zip_longest
from pathlib import Path
from typing import Any, TypedDict

from jbw.errors import ConfigError, DataError, RunError
from jbw.report.messages.run import RESTORE
from jbw.run.files import hash_of, write_whole
from jbw.sources import sources_of

FORMAT = 1
VERSIONED = ("jbw", "jax", "jaxlib", "numpyro", "blackjax", "diffrax", "optimistix", "numpy")


def versions() -> dict[str, str]:
    """Return versions of what decides the draws; of jbw with the digest of its sources."""
    here = {name: version(name) for name in VERSIONED}
    return {**here, "jbw": f"{here['jbw']} (sources {sources_of('jbw')})"}


class Machine(TypedDict):
    """The computer of a run."""

    name: str
    processors: str


def machine() -> Machine:
    """Return machine facts that may affect the last bit of a draw."""
    return {"name": platform.node(), "processors": str(os.cpu_count())}


def command_line() -> str:
    """Return the typed command for the manifest."""
    return " ".join(["jbw", *sys.argv[1:]])


@dataclass(frozen=True)
class Manifest:
    """A run as it was asked for."""

    command: str  # what was typed
    campaign: str  # its file; relative to the run's folder where it lies in there
    seed: int | None = None  # given on the command line
    preset: str | None = None  # of the virtual rig that makes the campaign first
    allow_outside: bool = False  # whether files may lie outside the campaign's folder
    quick: bool = False  # whether a first answer is all that was asked for
    final: bool = False  # whether all tests are to be fitted for use in the end
    figures: tuple[str, ...] = ()  # formats of the files that figures go to
    text: str | None = None  # content of the campaign file, once it was read
    # Hash of every data file by its path, relative to the campaign's folder where it lies below.
    inputs: dict[str, str] | None = None
    versions: dict[str, str] = field(default_factory=versions)
    machine: Machine = field(default_factory=machine)


def write_manifest(path: Path, manifest: Manifest) -> None:
    """Write a manifest, with the hash of its content."""
    content = {"format": FORMAT, **asdict(manifest)}
    text = json.dumps({"sha256": _digest(content), **content}, indent=1, ensure_ascii=False)
    write_whole(path, text.encode())


def read_manifest(path: Path) -> Manifest:
    """Read an unfinished run's manifest; refuse a changed one or another format."""
    from pydantic import TypeAdapter  # a tenth of a second

    try:
        text = path.read_text(encoding="utf-8")
        content = json.loads(text)
        intact = content.pop("sha256") == _digest(content) and content.pop("format") == FORMAT
        if intact and "\\u0000" not in text:  # which no path may hold
            Manifest(**content)  # refuses other keys
            return TypeAdapter(Manifest).validate_json(json.dumps(content), strict=True)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        pass
    raise RunError(
        f"{path} is damaged, or was written by another version of jbw.",
        why="It states the settings of the run.",
        remedy="Begin the run again in another folder: jbw identify CAMPAIGN --out DIR.",
    )


def _digest(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def with_inputs(manifest: Manifest, campaign: Path, inputs: Mapping[str, str]) -> Manifest:
    """Return the manifest once its campaign was read; refused where it was read before and changed.

    With the hash of every data file by its path, as it was read.
    """
    folder = campaign.resolve().parent
    digests = {}
    for name, digest in inputs.items():
        path = Path(name).resolve()
        below = path.is_relative_to(folder)
        digests[path.relative_to(folder).as_posix() if below else str(path)] = digest
    recorded = digests if manifest.inputs is None else manifest.inputs
    for name in sorted(digests | recorded):
        if name not in recorded:
            raise _other_data(f"{name} is among the campaign's files, but was not before.")
        if name not in digests:
            raise _other_data(f"{name} is no more among the campaign's files.")
        _require_same(name, recorded[name], digests[name])
    return replace(manifest, inputs=digests)


def _require_same(name: str, was: str, now: str) -> None:
    if was != now:
        raise _other_data(f"{name} changed since the run began.")


def _other_data(what: str) -> DataError:
    return DataError(
        f"The data file {what}", why="Its chains would continue with other data.", remedy=RESTORE
    )


def require_unchanged(manifest: Manifest, campaign: Path) -> None:
    """Refuse to go on with another campaign, other data or other versions than at the start."""
    here = versions()
    other = [
        f"{name} {was}, not {here.get(name)}"
        for name, was in manifest.versions.items()
        if here.get(name) != was
    ]
    if other:
        raise RunError(
            f"The run was begun with {'; '.join(other)}.",
            why="Its draws would not be those of an uninterrupted run.",
            remedy="Install the versions that it began with, or begin a new run in another folder.",
        )
    if manifest.text is not None:
        _require_same_text(manifest.text, campaign)
    folder = campaign.resolve().parent
    for name, digest in (manifest.inputs or {}).items():
        if not (manifest.allow_outside or (folder / name).resolve().is_relative_to(folder)):
            raise ConfigError(
                f"The data file {name} must lie in the campaign's folder {folder}, but does not.",
                why="A run's manifest may come from elsewhere.",
                remedy="If you trust these files, allow them: jbw resume DIR --allow-outside.",
            )
        try:
            now = hash_of(folder / name)
        except OSError as error:
            raise _other_data(f"{name} cannot be read: {error.strerror or error}.") from error
        _require_same(name, digest, now)


def _require_same_text(text: str, campaign: Path) -> None:
    try:
        now = campaign.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(
            f"The campaign file {campaign} cannot be read any more: {error}.", remedy=RESTORE
        ) from error
    pairs = enumerate(zip_longest(text.splitlines(), now.splitlines(), fillvalue=""), start=1)
    for number, (was, is_) in pairs:
        if was != is_:
            raise ConfigError(
                f"The campaign file {campaign} changed since the run began: line {number} was "
                f"{was.strip()!r} and is {is_.strip()!r}.",
                why="Its chains would go on with another configuration.",
                remedy=RESTORE,
            )
