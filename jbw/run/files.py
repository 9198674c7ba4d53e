"""The writing of files, completely or not at all."""

import hashlib
import os
import shutil
from pathlib import Path

from jbw.errors import RunError

ROOM = 50 * 2**20  # bytes that a run may need on disk for posterior, report and checkpoints
# bytes that a run may need on disk if it also stores records of the virtual rig
ROOM_OF_RIG = 300 * 2**20


def write_whole(path: Path, content: bytes) -> None:
    """Write a file completely: after a kill or with a full disk, the old file remains.

    Raises:
        RunError: The disk is full, the folder cannot be written, or the path is no file but a
            folder, or a device, which the new file would replace.
    """
    if path.exists() and not path.is_file():
        kind = "folder" if path.is_dir() else "device"
        raise RunError(
            f"{path} must be a file or a new name, but is a {kind}.",
            remedy="Give the name of a file, for example result.html.",
        )
    try:
        put_whole(path, content)
    except OSError as error:
        raise RunError(
            f"{path} cannot be written: {error.strerror or error}.",
            why="All files that were saved before are complete.",
            remedy="Free some space, or make the folder writable, and continue: jbw resume DIR.",
        ) from error


def put_whole(path: Path, content: bytes) -> None:
    """Replace a file by new content; if that fails, leave the old file unchanged.

    Raises:
        OSError: The file cannot be written.
    """
    part = path.with_name(f"{path.name}.part")
    try:
        with part.open("wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(part, path)
        _sync_folder(path.parent)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def _sync_folder(folder: Path) -> None:
    """Write a folder's entries to the disk, so that a rename survives a power cut."""
    if os.name != "posix":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def require_room(folder: Path, room: int = ROOM) -> None:
    """Raise an error if the disk of a folder has less than `room` bytes of free space."""
    made = next(place for place in (folder, *folder.absolute().parents) if os.path.exists(place))
    total, _, free = shutil.disk_usage(made)
    if total > 0 and free < room:  # Some file systems do not state their size.
        raise RunError(
            f"The disk of {folder} has {free / 2**20:.0f} MB left, but a run may need "
            f"{room / 2**20:.0f} MB.",
            remedy="Free some space, or choose a folder on another disk with --out.",
        )


def hash_of(path: Path) -> str:
    """Return the SHA-256 hash of a file in hexadecimal digits."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
