"""Which files a test means: patterns resolved inside the campaign's folder, in natural order."""

import re
from collections.abc import Iterable
from pathlib import Path

from jbw.errors import ConfigError, DataError
from jbw.measurement.files.paths import closest


def found_files(
    patterns: Iterable[str], folder: Path, *, allow_outside: bool = False
) -> list[Path]:
    """Files that the patterns name, each once, in the order of the patterns.

    Args:
        patterns: File names or patterns with * and ?, relative to the folder.
        folder: The campaign file's folder.
        allow_outside: Let them lead out of the folder.

    Raises:
        ConfigError: A URL, or a path out of the folder.
        DataError: Nothing matches.
    """
    found: list[Path] = []
    for pattern in patterns:
        _refuse_url(pattern)
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
