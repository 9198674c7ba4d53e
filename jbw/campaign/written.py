"""Checks that a file written by a user exists and can be read; they do not import JAX."""

import shlex
from pathlib import Path

from jbw.errors import ConfigError

NAMED = "campaign.toml"
CAMPAIGN = "Campaign file", "Write a campaign file with: jbw init FOLDER"


def is_campaign(path: Path) -> bool:
    """Return whether a path has the name of a campaign file."""
    return path.suffix.lower() == ".toml" and not path.is_dir()


def campaign_in(folder: Path) -> Path | None:
    """Return the campaign file of a folder: `campaign.toml`, or its only TOML campaign file."""
    inside = sorted(folder.glob("*.toml"))
    usual = [path for path in inside if path.name == NAMED] or inside
    return usual[0] if len(usual) == 1 else None


def require_file(path: Path, what: str, remedy: str) -> None:
    """Raise a ConfigError unless a path is a readable file; see `text_of` for the arguments."""
    try:
        is_folder, is_file = path.is_dir(), path.is_file()
        if is_file:
            path.open("rb").close()
    except PermissionError:
        raise ConfigError(
            f"{what} `{path}` must be readable, but permission is denied.",
            remedy="Ask its owner for permission to read the file and its folder.",
        ) from None
    if is_folder:
        inside = sorted(path.glob("*.toml"))
        raise ConfigError(
            f"{what} `{path}` must be a file, but it is a folder.",
            remedy=f"Name the file in this folder: {shlex.quote(str(inside[0]))}"
            if inside
            else remedy.replace("FOLDER", shlex.quote(str(path))),
        )
    if not is_file:
        raise ConfigError(f"{what} `{path}` does not exist.", remedy=remedy)
