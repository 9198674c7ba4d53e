"""One process a folder: a lock that the system lets go of when its process ends, however."""

import errno
import json
import os
import platform
import sys
from pathlib import Path
from typing import IO

from jbw.errors import RunError

UNSUPPORTED = {errno.ENOTSUP, errno.ENOLCK, errno.ENOSYS}  # some network folders know no locks


class FolderLock:
    """The right to write to a run's folder, held until `release` or the end of the process.

    Args:
        path: The lock file; made when absent, and left where it is.

    Raises:
        RunError: If another process holds it.
    """

    def __init__(self, path: Path) -> None:
        self._stream = path.open("a+", encoding="utf-8")
        try:
            _lock(self._stream)
        except OSError as error:
            if error.errno not in UNSUPPORTED:
                holder = _holder(self._stream)
                self._stream.close()
                raise RunError(
                    f"Another process{holder} is writing to {path.parent.parent}.",
                    why="Results of two runs must not be mixed.",
                    remedy="Wait until it ends, or choose another folder.",
                ) from error
        self._stream.truncate(0)
        self._stream.write(json.dumps({"pid": os.getpid(), "host": platform.node()}))
        self._stream.flush()

    def release(self) -> None:
        """Let another process write."""
        self._stream.close()


def _holder(stream: IO[str]) -> str:
    """Who holds the lock, as far as it is written there."""
    stream.seek(0)
    try:
        found = json.loads(stream.read())
        return f" (number {found['pid']} on {found['host']})"
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return ""


def _lock(stream: IO[str]) -> None:
    if sys.platform == "win32":
        import msvcrt

        # Beyond the text, which others must be able to read.
        stream.seek(2**20)
        msvcrt.locking(stream.fileno(), msvcrt.LK_NBLCK, 1)
        stream.seek(0)
    else:
        import fcntl

        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
