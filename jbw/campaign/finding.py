"""Which files a test means: patterns resolved inside the campaign's folder, in natural order."""

import os
import re
from collections.abc import Iterable
from pathlib import Path

from jbw.errors import ConfigError, DataError
from jbw.measurement.files.paths import closest

DATA_FOLDER = "$JBW_DATA"


def found_files(
    patterns: Iterable[str], folder: Path, *, allow_outside: bool = False
) -> list[Path]:
    """Files that the patterns name, each once, in the order of the patterns.

    Args:
        patterns: File names or patterns with * and ?, relative to the folder; $JBW_DATA at their
            beginning is the folder of that environment variable.
        folder: The campaign file's folder.
        allow_outside: Let them lead out of the folder.

    Raises:
        ConfigError: A URL, a path out of the folder, or $JBW_DATA where it is not set.
        DataError: Nothing matches.
    """
    found: list[Path] = []
    for written in patterns:
        _refuse_url(written)
        pattern = _with_data_folder(written)
        # First the pattern itself, so that nothing outside is even looked at; then the links.
        _stay_inside(folder / pattern, pattern, folder, allow_outside)
        for file in _matching(pattern, folder):
            _stay_inside(file, pattern, folder, allow_outside)
            if file not in found:
                found.append(file)
    return found


def _stay_inside(path: Path, pattern: str, folder: Path, allow_outside: bool) -> None:
    if not allow_outside and not path.resolve().is_relative_to(folder.resolve()):
        raise ConfigError(
            f"`files` = {pattern!r} leads out of the campaign's folder `{folder}`.",
            why="A campaign file from elsewhere must not read your other files.",
            remedy="Move the data beside the campaign file, or pass --allow-outside.",
        )


def _with_data_folder(pattern: str) -> str:
    """The pattern with the data folder of this machine in the place of $JBW_DATA."""
    if not pattern.startswith(DATA_FOLDER):
        return pattern
    folder = os.environ.get(DATA_FOLDER[1:])
    if not folder:
        raise ConfigError(
            f"`files` = {pattern!r} begins with {DATA_FOLDER}, which is not set.",
            remedy=f"Set the environment variable {DATA_FOLDER[1:]} to the folder of your data.",
        )
    return str(Path(folder).absolute()) + pattern[len(DATA_FOLDER) :]


def _refuse_url(pattern: str) -> None:
    if re.match(r"[A-Za-z][A-Za-z0-9+.-]*://", pattern):
        raise ConfigError(
            f"`files` = {pattern!r} is a URL, and jbw never fetches anything.",
            remedy="Download the file first and name it here.",
        )


def _matching(pattern: str, folder: Path) -> list[Path]:
    literal = folder / pattern
    if literal.is_file() or not re.search(r"[*?\[]", pattern):
        matches = [literal] if literal.is_file() else []
    elif Path(pattern).is_absolute():
        anchor = Path(Path(pattern).anchor)
        matches = [*anchor.glob(str(Path(pattern).relative_to(anchor)))]
    else:
        matches = [*folder.glob(pattern)]
    files = sorted((p for p in matches if p.is_file()), key=_natural)
    if not files:
        raise _nothing(pattern, folder)
    return files


def _natural(path: Path) -> list[tuple[int, int | str]]:
    """Sorting key with numbers by value, so that run_2 comes before run_10."""
    parts = re.split(r"(\d+)", path.name)
    return [(1, int(part)) if part.isdecimal() else (0, part) for part in parts]


def _nothing(pattern: str, folder: Path) -> DataError:
    found = sorted(str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file())
    nearest = closest(pattern, found)
    guess = f"Did you mean `{nearest}`? " if nearest else ""
    more = f" and {len(found) - 10} more" if len(found) > 10 else ""
    return DataError(
        f"`files` = {pattern!r} matches nothing in `{folder}`.",
        remedy=f"{guess}Found: {', '.join(found[:10]) or 'nothing'}{more}.",
    )
