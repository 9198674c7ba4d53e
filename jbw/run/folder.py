"""The folder of a run under way: begun, gone on with, or finished, by one process at a time."""

import errno
import json
import os
import platform
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter
from typing import IO

from jbw.errors import RunError
from jbw.run.checkpoints import Checkpoint, Interruption, Watch
from jbw.run.files import ROOM, ROOM_OF_RIG, require_room
from jbw.run.manifest import (
    Manifest,
    machine,
    read_manifest,
    require_unchanged,
    write_manifest,
)

HIDDEN = ".run"  # beside the results, until these are complete
MANIFEST, LOCK, SPENT = "manifest.json", "lock", "spent_s"
UNSUPPORTED = {errno.ENOTSUP, errno.ENOLCK, errno.ENOSYS}  # some network folders know no locks


@contextmanager
def _locked(folder: Path) -> Iterator[IO[str]]:
    """The right to write to a run's folder, given back at once where what follows fails.

    It lasts as long as the stream is open: the system lets go of it when the process ends,
    however that comes.
    """
    try:
        (folder / HIDDEN).mkdir(parents=True, exist_ok=True)
        stream = (folder / HIDDEN / LOCK).open("a+", encoding="utf-8")
        lock(stream, folder)
        stream.truncate(0)
        stream.write(json.dumps({"pid": os.getpid(), "host": platform.node()}))
        stream.flush()
    except OSError as error:
        raise _unwritable(folder, error) from error
    try:
        yield stream
    except BaseException:
        stream.close()
        raise


def _holder(stream: IO[str]) -> str:
    """Who holds the lock, as far as it is written there."""
    stream.seek(0)
    try:
        found = json.loads(stream.read())
        return f" (number {found['pid']} on {found['host']})"
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return ""


def lock(stream: IO[str], folder: Path) -> None:
    """Lock an open file for this process as long as it stays open, or say who writes there."""
    try:
        if sys.platform == "win32":
            import msvcrt

            # Beyond the text, which others must be able to read.
            stream.seek(2**20)
            msvcrt.locking(stream.fileno(), msvcrt.LK_NBLCK, 1)
            stream.seek(0)
        else:
            import fcntl

            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in UNSUPPORTED:
            return
        holder = _holder(stream)
        stream.close()
        raise RunError(
            f"Another process{holder} is writing to {folder}.",
            why="Results of two runs must not be mixed.",
            remedy="Wait until it ends, or choose another folder.",
        ) from error


class Run:
    """A run that this process may write, as long as it holds the lock; fresh where it begins here.

    The manifest says what it was asked for and what it read so far; `watch` is called with the name
    of a posterior and how far its chains are.
    """

    def __init__(self, folder: Path, manifest: Manifest, lock: IO[str], *, fresh: bool) -> None:
        self.folder, self.manifest = folder, manifest
        self._lock, self._fresh = lock, fresh
        self.interruption = Interruption()
        self.watch: Watch = lambda name, so_far: None
        self._opened = perf_counter()

    @property
    def campaign(self) -> Path:
        """The campaign file; the virtual rig's lies in the run's folder, which may be moved."""
        return self.folder / self.manifest.campaign

    def keep(self, name: str) -> Checkpoint:
        """Where the chains of the posterior of this name outlive the process."""
        return Checkpoint(self.folder / HIDDEN, name, self.interruption, self.watch)

    def note(self, manifest: Manifest) -> None:
        """Write down what became known, in place of the manifest of before."""
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

    @property
    def spent(self) -> float:
        """Time that sittings before this one took, as far as they could say so [s]."""
        try:
            return float((self.folder / HIDDEN / SPENT).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return 0.0

    def close(self) -> None:
        """Let another process write to the folder; of an unfinished run, say how long it took."""
        if (self.folder / HIDDEN / MANIFEST).exists():
            spent = self.spent + perf_counter() - self._opened
            (self.folder / HIDDEN / SPENT).write_text(f"{spent:.2f}", encoding="utf-8")
        self._lock.close()


def begin(folder: Path, manifest: Manifest) -> Run:
    """Begin a run in a new or empty folder, and hold the folder's lock."""
    unfinished = folder / HIDDEN / MANIFEST
    if not unfinished.exists():
        _require_empty(folder)
    with _locked(folder) as lock:
        if unfinished.exists():
            raise RunError(
                f"The folder {folder} holds a run that was interrupted.",
                why="Results of two runs must not be mixed.",
                remedy=f"Go on with it: jbw resume {folder}. Or choose another with --out.",
            )
        _require_empty(folder)  # another process may have been here before the lock
        require_room(folder, ROOM if manifest.preset is None else ROOM_OF_RIG)
        write_manifest(unfinished, manifest)
    return Run(folder, manifest, lock, fresh=True)


def reopen(folder: Path) -> Run | None:
    """Go on with an interrupted run, and hold its folder's lock; None where it is finished."""
    if not (folder / HIDDEN / MANIFEST).exists():
        if (folder / "summary.json").exists():
            shutil.rmtree(folder / HIDDEN, ignore_errors=True)  # a kill came in its removal
            return None
        raise RunError(
            f"The folder {folder} holds no run to go on with.",
            remedy=f"Begin one: jbw identify CAMPAIGN --out {folder}.",
        )
    with _locked(folder) as lock:
        manifest = read_manifest(folder / HIDDEN / MANIFEST)
        require_room(folder)
        for part in folder.glob(".part-*"):
            shutil.rmtree(part, ignore_errors=True)
    return Run(folder, manifest, lock, fresh=False)


def require_same(run: Run) -> str | None:
    """Refuse to go on with what changed since a run began; a warning where only the machine did."""
    if not (run.folder / "summary.json").exists():  # a result needs only its report
        require_unchanged(run.manifest, run.campaign)
    was, is_ = run.manifest.machine, machine()
    if was == is_:
        return None
    return (
        f"The run began on {was['name']} ({was['processors']} processors) and goes on "
        f"here, on {is_['name']} ({is_['processors']}): its draws may differ in the last "
        "digits, and chains whose start does begin again."
    )


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


def _unwritable(folder: Path, error: OSError) -> RunError:
    return RunError(
        f"The output folder {folder} cannot be written: {error.strerror or error}.",
        remedy="Choose another with --out, or make it writable.",
    )
