"""Files in the user's cache folder, each of which can be computed again."""

import os
import time
from contextlib import suppress
from functools import cache
from pathlib import Path
from tempfile import NamedTemporaryFile

import platformdirs

KEPT_DAYS = 30  # number of days after which an unused file is removed


class Programs:
    """Whether this process keeps the programs of compiled functions in the cache."""

    are_kept = False


def cached(folder: str, name: str) -> bytes | None:
    """Return the content of a file in the user's cache; None if it cannot be read."""
    path = platformdirs.user_cache_path("jbw") / folder / name
    try:
        content = path.read_bytes()
    except OSError:
        return None
    with suppress(OSError):  # The file may belong to another user.
        os.utime(path)
    return content


def keep(folder: str, name: str, content: bytes) -> None:
    """Write a file into a folder of the user's cache that only this user can read.

    If it cannot be written, the only cost is a new computation.
    """
    place = platformdirs.user_cache_path("jbw") / folder
    with suppress(OSError):
        place.mkdir(parents=True, exist_ok=True)
        place.chmod(0o700)
        _forget(place)
        with NamedTemporaryFile(dir=place, suffix=".part", delete=False) as file:
            file.write(content)
        Path(file.name).replace(place / name)


@cache
def _forget(folder: Path) -> None:
    """Remove files that no command used for a month; do so once per process."""
    oldest = time.time() - KEPT_DAYS * 86400
    for path in folder.iterdir():
        with suppress(OSError):  # Another process may have removed the file.
            if path.stat().st_mtime < oldest:
                path.unlink()
