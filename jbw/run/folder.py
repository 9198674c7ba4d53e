"""The folder of a run under way: begun, gone on with, or finished, by one process at a time."""

import errno
import json
import os
import platform
import shutil
import sys
from pathlib import Path
from typing import IO

from jbw.errors import RunError
from jbw.run.checkpoints import Checkpoint, Watch, unwatched
from jbw.run.files import ROOM, ROOM_OF_RIG, require_room
from jbw.run.interruption import Interruption
from jbw.run.manifest import Manifest, read_manifest, write_manifest

HIDDEN = ".run"  # beside the results, until these are complete
MANIFEST, LOCK = "manifest.json", "lock"
UNSUPPORTED = {errno.ENOTSUP, errno.ENOLCK, errno.ENOSYS}  # some network folders know no locks


class FolderLock:
    """The right to write to a run's folder, held until `release` or the end of the process.

    The system lets go of it when the process ends, however that comes.

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


class Run:
    """A run that this process may write.

    Args:
        folder: The run's folder.
        manifest: What it was asked for.
        lock: The right to write there.
        fresh: Whether it begins here.

    Attributes:
        folder: The run's folder.
        manifest: What it was asked for, and what it read so far.
        interruption: Whether it was asked to stop.
        watch: Called with the name of a posterior and how far its chains are.
    """

    def __init__(self, folder: Path, manifest: Manifest, lock: FolderLock, *, fresh: bool) -> None:
        self.folder, self.manifest = folder, manifest
        self._lock, self._fresh = lock, fresh
        self.interruption = Interruption()
        self.watch: Watch = unwatched

    @property
    def campaign(self) -> Path:
        """The campaign file; the virtual rig's lies in the run's folder, which may be moved."""
        return self.folder / self.manifest.campaign

    def keep(self, name: str) -> Checkpoint:
        """Where the chains of a posterior outlive the process.

        Args:
            name: Name of the posterior.
        """
        return Checkpoint(self.folder / HIDDEN, name, self.interruption, self.watch)

    def note(self, manifest: Manifest) -> None:
        """Write down what became known.

        Args:
            manifest: In place of the one before.
        """
        if manifest != self.manifest:
            write_manifest(self.folder / HIDDEN / MANIFEST, manifest)
        self.manifest = manifest

    def finish(self) -> None:
        """Remove what only an unfinished run needs."""
        (self.folder / HIDDEN / MANIFEST).unlink(missing_ok=True)
        shutil.rmtree(self.folder / HIDDEN, ignore_errors=True)

    def discard(self) -> None:
        """Leave no trace of a run that has just begun and has nothing to go on from."""
        if not self._fresh or list((self.folder / HIDDEN).glob("*.checkpoint")):
            return
        if [path.name for path in self.folder.iterdir()] == [HIDDEN]:
            self.finish()
            self.folder.rmdir()

    def close(self) -> None:
        """Let another process write to the folder."""
        self._lock.release()


def begin(folder: Path, manifest: Manifest) -> Run:
    """Begin a run in a new or empty folder.

    Args:
        folder: The run's folder.
        manifest: What is asked for.

    Returns:
        The run, which holds the folder's lock.

    Raises:
        RunError: If the folder holds something or an unfinished run, cannot be written, has no
            room, or another process writes there.
    """
    unfinished = folder / HIDDEN / MANIFEST
    if not unfinished.exists():
        _require_empty(folder)
    lock = _locked(folder)
    try:
        if unfinished.exists():
            raise RunError(
                f"The folder {folder} holds a run that was interrupted.",
                why="Results of two runs must not be mixed.",
                remedy=f"Go on with it: jbw resume {folder}. Or choose another with --out.",
            )
        _require_empty(folder)  # another process may have been here before the lock
        require_room(folder, ROOM if manifest.preset is None else ROOM_OF_RIG)
        write_manifest(folder / HIDDEN / MANIFEST, manifest)
    except BaseException:
        lock.release()
        raise
    return Run(folder, manifest, lock, fresh=True)


def reopen(folder: Path) -> Run | None:
    """Go on with a run that was interrupted.

    Args:
        folder: The run's folder.

    Returns:
        The run, which holds the folder's lock; None where it is finished.

    Raises:
        RunError: If there is no run, its manifest is damaged, or another process writes there.
    """
    if not (folder / HIDDEN / MANIFEST).exists():
        if (folder / "summary.json").exists():
            shutil.rmtree(folder / HIDDEN, ignore_errors=True)  # a kill came in its removal
            return None
        raise RunError(
            f"The folder {folder} holds no run to go on with.",
            remedy=f"Begin one: jbw identify CAMPAIGN --out {folder}.",
        )
    lock = _locked(folder)
    try:
        manifest = read_manifest(folder / HIDDEN / MANIFEST)
        require_room(folder)
        for part in folder.glob(".part-*"):
            shutil.rmtree(part, ignore_errors=True)
    except BaseException:
        lock.release()
        raise
    return Run(folder, manifest, lock, fresh=False)


def _require_empty(folder: Path) -> None:
    """Refuse a folder that holds anything."""
    try:
        names = sorted(path.name for path in folder.iterdir()) if folder.exists() else []
    except OSError as error:
        raise _unwritable(folder, error) from error
    if others := [name for name in names if name != HIDDEN]:
        raise RunError(
            f"The output folder {folder} must be new or empty, but it holds {others[0]}.",
            why="Results of two runs must not be mixed.",
            remedy="Choose another with --out, or empty it.",
        )


def _locked(folder: Path) -> FolderLock:
    try:
        (folder / HIDDEN).mkdir(parents=True, exist_ok=True)
        return FolderLock(folder / HIDDEN / LOCK)
    except OSError as error:
        raise _unwritable(folder, error) from error


def _unwritable(folder: Path, error: OSError) -> RunError:
    return RunError(
        f"The output folder {folder} cannot be written: {error.strerror or error}.",
        remedy="Choose another with --out, or make it writable.",
    )
