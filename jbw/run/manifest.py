"""The request and inputs of a run, stored so that it can be resumed and changes are detected."""

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
from typing import Any, Literal, get_args

from jbw.errors import ConfigError, DataError, RunError
from jbw.report.messages.run import RESTORE
from jbw.run.files import hash_of, write_whole
from jbw.sources import sources_of

FORMAT = 1
Keep = Literal["report", "posterior"]
KEPT = get_args(Keep)
VERSIONED = ("jbw", "jax", "jaxlib", "numpyro", "blackjax", "diffrax", "optimistix", "numpy")


def versions() -> dict[str, str]:
    """Return the versions of jbw and of the packages that can change the posterior draws."""
    here = {name: version(name) for name in VERSIONED}
    return {**here, "jbw": f"{here['jbw']} (sources {sources_of('jbw')})"}


def machine() -> dict[str, str]:
    """Return the machine's name and number of processors, which may affect a draw's last bit."""
    return {"name": platform.node(), "processors": str(os.cpu_count())}


def command_line() -> str:
    """Return the command as the user typed it."""
    return " ".join(["jbw", *sys.argv[1:]])


@dataclass(frozen=True)
class Manifest:
    """The request and the inputs of a run."""

    command: str  # command as typed
    # campaign file, by a path relative to the run's folder if the file lies inside that folder
    campaign: str
    seed: int | None = None  # seed given on the command line
    preset: str | None = (
        None  # preset of the virtual rig that measures the campaign before it is identified
    )
    allow_outside: bool = False  # whether data files may be outside the campaign's folder
    quick: bool = False  # whether only the fit is requested, without drawing from the posterior
    final: bool = False  # whether a final fit is requested that also includes held-out tests
    figures: tuple[str, ...] = ()  # file formats of saved figures
    keep: Keep = "report"  # whether the result is kept with its report and figures
    # number of processes that were killed while they ran this among other runs, including the
    # process that runs it now
    num_killed: int = 0
    text: str | None = None  # content of the campaign file, once it has been read
    # SHA-256 of every data file by the file's path, relative to the campaign's folder if inside it
    inputs: dict[str, str] | None = None
    versions: dict[str, str] = field(default_factory=versions)
    machine: dict[str, str] = field(default_factory=machine)


def write_manifest(path: Path, manifest: Manifest) -> None:
    """Write the manifest of a run together with the hash of its content."""
    content = {"format": FORMAT, **asdict(manifest)}
    text = json.dumps({"sha256": _digest(content), **content}, indent=1, ensure_ascii=False)
    write_whole(path, text.encode())


def read_manifest(path: Path) -> Manifest:
    """Read an unfinished run's manifest; raise an error if it was changed or cannot be read."""
    # The import takes a tenth of a second and is needed only here.
    from pydantic import TypeAdapter

    try:
        text = path.read_text(encoding="utf-8")
        content = json.loads(text)
        intact = content.pop("sha256") == _digest(content) and content.pop("format") == FORMAT
        if intact and "\\u0000" not in text:  # No path may contain a null character.
            Manifest(**content)  # Unknown keys raise an error here.
            return TypeAdapter(Manifest).validate_json(json.dumps(content), strict=True)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        pass
    raise RunError(
        f"{path} is damaged, or was written by another version of jbw.",
        why="This file states the settings of the run.",
        remedy="Begin the run again in another folder: jbw identify CAMPAIGN --out DIR.",
    )


def _digest(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def with_inputs(manifest: Manifest, campaign: Path, inputs: Mapping[str, str]) -> Manifest:
    """Return the manifest with the campaign's inputs; raise an error if the inputs have changed.

    Inputs are the SHA-256 of every data file, by its path.
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
            raise _other_data(f"{name} was added to the campaign's files since the run began.")
        if name not in digests:
            raise _other_data(f"{name} is no longer among the campaign's files.")
        _require_same(name, recorded[name], digests[name])
    return replace(manifest, inputs=digests)


def _require_same(name: str, was: str, now: str) -> None:
    if was != now:
        raise _other_data(f"{name} changed since the run began.")


def _other_data(what: str) -> DataError:
    return DataError(
        f"The data file {what}",
        why="Chains must continue with the data with which the run began.",
        remedy=RESTORE,
    )


def require_unchanged(manifest: Manifest, campaign: Path) -> None:
    """Raise an error if campaign, data or package versions have changed since the run began."""
    here = versions()
    other = [
        f"{name} {was}, not {here.get(name)}"
        for name, was in manifest.versions.items()
        if here.get(name) != was
    ]
    if other:
        raise RunError(
            f"The run was begun with other package versions: {'; '.join(other)}.",
            why="The draws of a resumed run would differ from those of an uninterrupted run.",
            remedy="Install the versions with which the run was begun, or begin a new run in "
            "another folder.",
        )
    if manifest.text is not None:
        _require_same_text(manifest.text, campaign)
    folder = campaign.resolve().parent
    for name, digest in (manifest.inputs or {}).items():
        if not (manifest.allow_outside or (folder / name).resolve().is_relative_to(folder)):
            raise ConfigError(
                f"The data file {name} must be in the campaign's folder {folder}, but is not.",
                why="A manifest that comes from another person must not read your other files.",
                remedy="If you trust the data files, allow files outside of the campaign's folder: "
                "jbw resume DIR --allow-outside.",
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
                why="The chains of the run would continue with another configuration.",
                remedy=RESTORE,
            )
