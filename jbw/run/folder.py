"""The folder of an unfinished run; only one process at a time may begin or resume the run."""

import errno
import json
import os
import platform
import shlex
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

from jbw.errors import RunError
from jbw.report.messages import run as messages
from jbw.run.checkpoints import Checkpoint, Interruption, Watch
from jbw.run.files import ROOM, ROOM_OF_RIG, require_room
from jbw.run.manifest import (
    Manifest,
    machine,
    read_manifest,
    require_unchanged,
    write_manifest,
)

if TYPE_CHECKING:
    from filelock import BaseFileLock

HIDDEN = ".run"  # subfolder for unfinished work
MANIFEST, LOCK, SPENT = "manifest.json", "lock", "spent_s"
RESULT = {
    "posterior.nc", "summary.json", "figures", "report.html", "interactive.html", "brief.pdf"
}  # fmt: skip
OF_RIG = "campaign/campaign.toml"  # campaign file of the virtual rig, below the run's folder
HOLDER = ".holder"  # suffix of the file that states which process has the lock
UNSUPPORTED = {errno.ENOTSUP, errno.ENOLCK, errno.ENOSYS}  # Some network folders support no locks.


def lock(file: Path, folder: Path) -> "BaseFileLock":
    """Lock a file for this process, until the lock is released or the process ends in any way.

    Raises:
        RunError: Another process holds the lock; the message names it as far as known.
        OSError: The file cannot be written.
    """
    # This import is made here, because a command that only prints its help must not wait for it.
    from filelock import FileLock, Timeout

    # The existence of the file is not the lock, because the file of a dead process would block the
    # next process.
    held = FileLock(file, timeout=0, thread_local=False, fallback_to_soft=False)
    try:
        held.acquire()
    except Timeout as error:
        raise RunError(
            f"Another process{_holder(file)} is writing to {folder}.",
            why="Results of two runs must not be mixed.",
            remedy="Wait until the process that uses the folder ends, or choose another folder.",
        ) from error
    except OSError as error:
        if error.errno not in UNSUPPORTED:
            raise
    # The process that holds the lock is recorded in another file, because Windows lets no other
    # process read a locked file.
    holder = {"pid": os.getpid(), "host": platform.node()}
    file.with_suffix(HOLDER).write_text(json.dumps(holder), encoding="utf-8")
    return held


def _holder(file: Path) -> str:
    """Return the process and host recorded as the lock's holder; an empty text if unreadable."""
    try:
        holder = json.loads(file.with_suffix(HOLDER).read_text(encoding="utf-8"))
        return f" (process {holder['pid']} on {holder['host']})"
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return ""


@contextmanager
def _locked(folder: Path) -> "Iterator[BaseFileLock]":
    """Lock a run's folder for writing; release the lock if the block raises."""
    try:
        (folder / HIDDEN).mkdir(parents=True, exist_ok=True)
        held = lock(folder / HIDDEN / LOCK, folder)
    except OSError as error:
        raise _unwritable(folder, error) from error
    try:
        yield held
    except BaseException:
        held.release()
        raise


class Run:
    """A locked run that this process may write; `fresh` means that the run began in this process.

    The manifest states the request and the inputs read so far; `watch` is called with the name of a
    posterior and the progress of its chains.
    """

    def __init__(
        self, folder: Path, manifest: Manifest, held: "BaseFileLock", *, fresh: bool
    ) -> None:
        self.folder, self.manifest = folder, manifest
        self._held, self._fresh = held, fresh
        self.interruption = Interruption()
        self.watch: Watch = lambda name, so_far: None
        self._opened = perf_counter()

    @property
    def to_resume(self) -> str:
        """The arguments of `jbw resume` that continue the run."""
        allowed = " --allow-outside" if self.manifest.allow_outside else ""
        return f"{shlex.quote(str(self.folder))}{allowed}"

    @property
    def campaign(self) -> Path:
        """The path of the run's campaign file."""
        return self.folder / self.manifest.campaign

    def keep(self, name: str) -> Checkpoint:
        """Return the checkpoints in which the chains of the named posterior are stored."""
        return Checkpoint(self.folder / HIDDEN, name, self.interruption, self.watch)

    def note(self, manifest: Manifest) -> None:
        """Rewrite the run's manifest with additional facts."""
        if manifest != self.manifest:
            write_manifest(self.folder / HIDDEN / MANIFEST, manifest)
        self.manifest = manifest

    @contextmanager
    def surviving(self) -> Iterator[None]:
        """Count the block in the manifest, until it ends in any way but a kill of its process."""
        self.note(replace(self.manifest, num_killed=self.manifest.num_killed + 1))
        try:
            yield
        finally:
            if (self.folder / HIDDEN / MANIFEST).exists():
                self.note(replace(self.manifest, num_killed=0))

    def finish(self) -> None:
        """Remove the files that only an unfinished run needs."""
        (self.folder / HIDDEN / MANIFEST).unlink(missing_ok=True)
        # Windows cannot remove open files, and no other process may begin a run in a folder with
        # results.
        self._held.release()
        shutil.rmtree(self.folder / HIDDEN, ignore_errors=True)

    def discard(self) -> None:
        """Remove the folder of a run that began in this process and has no checkpoint yet."""
        if not self._fresh or list((self.folder / HIDDEN).glob("*.checkpoint")):
            return
        if [path.name for path in self.folder.iterdir()] == [HIDDEN]:
            self.finish()
            self.folder.rmdir()

    @property
    def spent(self) -> float:
        """The time that earlier processes spent on this run [s]; zero if it was not recorded."""
        try:
            return float((self.folder / HIDDEN / SPENT).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return 0.0

    def close(self) -> None:
        """Release the folder's lock; save the time spent so far if the run is unfinished."""
        if (self.folder / HIDDEN / MANIFEST).exists():
            spent = self.spent + perf_counter() - self._opened
            (self.folder / HIDDEN / SPENT).write_text(f"{spent:.2f}", encoding="utf-8")
        self._held.release()


def begin(folder: Path, manifest: Manifest) -> Run:
    """Lock a folder and begin a run in it; it must be empty or contain only the result of a fit."""
    unfinished = folder / HIDDEN / MANIFEST
    if not unfinished.exists():
        _require_empty(folder)
        require_room(folder, ROOM if manifest.preset is None else ROOM_OF_RIG)
    with _locked(folder) as held:
        if _holds_nothing_else_than_a_first_answer(folder):
            (folder / HIDDEN / SPENT).unlink(missing_ok=True)
            write_manifest(unfinished, manifest)
            return Run(folder, manifest, held, fresh=False)
        if unfinished.exists():
            raise RunError(
                f"The folder {folder} contains a run that was interrupted.",
                why="Results of two runs must not be mixed.",
                remedy=f"Continue the run: jbw resume {folder}. Or choose another folder with "
                "--out.",
            )
        _require_empty(folder)  # Another process may have begun a run before this one got the lock.
        write_manifest(unfinished, manifest)
    return Run(folder, manifest, held, fresh=True)


def is_first_answer(folder: Path) -> bool:
    """Return whether a folder contains only the result of a fit, which a full run may replace."""
    try:
        summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
        return "quick" in summary
    except (OSError, ValueError, TypeError, RecursionError):
        return False


def _holds_nothing_else_than_a_first_answer(folder: Path) -> bool:
    if not (is_first_answer(folder) and (folder / HIDDEN / MANIFEST).exists()):
        return False
    asked_for_no_more = read_manifest(folder / HIDDEN / MANIFEST).quick
    return asked_for_no_more and {path.name for path in folder.iterdir()} <= RESULT | {HIDDEN}


def reopen(folder: Path, *, allow_outside: bool = False) -> Run | None:
    """Resume an interrupted run and lock its folder; return None if the run is already finished.

    A folder may come from elsewhere. Nothing in it can cause a write outside of it, and the caller
    decides again whether files outside the campaign's folder are read.

    Raises:
        RunError: There is no run, another process has its lock, or its files lead out of the
            folder.
    """
    if not (folder / HIDDEN / MANIFEST).exists():
        if (folder / "summary.json").exists():
            # The removal of the temporary folder may have been interrupted.
            shutil.rmtree(folder / HIDDEN, ignore_errors=True)
            return None
        raise RunError(
            f"The folder {folder} contains no run that could be continued.",
            remedy=f"Begin a run: jbw identify CAMPAIGN --out {folder}.",
        )
    _require_inside(folder)
    with _locked(folder) as held:
        manifest = replace(read_manifest(folder / HIDDEN / MANIFEST), allow_outside=allow_outside)
        if manifest.preset is not None and manifest.campaign != OF_RIG:
            raise RunError(
                f"The campaign of the run in {folder} must be that of its virtual rig, "
                f"{OF_RIG}, but is {manifest.campaign}.",
                why="The records of the virtual rig are written next to the campaign file.",
                remedy="Begin a run of your own: jbw demo --out DIR.",
            )
        require_room(folder)
        for part in folder.glob(".part-*"):
            shutil.rmtree(part, ignore_errors=True)
    return Run(folder, manifest, held, fresh=False)


def require_same(run: Run) -> str | None:
    """Raise an error if a run's inputs changed; return a warning if only the machine changed."""
    is_whole = (run.folder / "summary.json").exists() and not is_first_answer(run.folder)
    # If the result is complete, only the report remains, which does not depend on the inputs.
    if not is_whole:
        require_unchanged(run.manifest, run.campaign)
    was, is_ = run.manifest.machine, machine()
    if was == is_:
        return None
    return messages.another_machine(was["name"], was["processors"], is_["name"], is_["processors"])


def _require_inside(folder: Path) -> None:
    """Raise an error if a run's folder contains a link that leads out of it."""
    inside = folder.resolve()
    for path in folder.rglob("*"):
        if path.is_symlink() and not path.resolve().is_relative_to(inside):
            raise RunError(
                f"The run's folder {folder} must contain its own files, but {path.name} is a "
                f"link to {path.resolve()}.",
                why="A resumed run would write to a file outside of the run's folder.",
                remedy="Replace the link by a copy of the file.",
            )


def _require_empty(folder: Path) -> None:
    """Raise an error if a folder contains anything but an unfinished run."""
    try:
        names = sorted(path.name for path in folder.iterdir()) if folder.exists() else []
    except OSError as error:
        raise _unwritable(folder, error) from error
    if others := [name for name in names if name != HIDDEN]:
        raise RunError(
            f"The output folder {folder} must be new or empty, but it contains {others[0]}.",
            why="Results of two runs must not be mixed.",
            remedy=f"Choose another folder with --out, or empty {folder}.",
        )


def _unwritable(folder: Path, error: OSError) -> RunError:
    return RunError(
        f"The output folder {folder} cannot be written: {error.strerror or error}.",
        remedy="Choose another folder with --out, or make the folder writable.",
    )
