"""Files that are there whole or not at all."""

import hashlib
import os
import shutil
from pathlib import Path

from jbw.errors import RunError

ROOM = 50 * 2**20  # bytes that a run may need: posterior, report and checkpoints
ROOM_OF_RIG = 300 * 2**20  # with the records of the virtual rig


def write_whole(path: Path, content: bytes) -> None:
    """Write a file so that a kill or a full disk leaves the old one, or the new one, never half.

    Raises:
        RunError: If the disk is full, the folder cannot be written, or the path is no file: a
            device, which the new file would replace, or a folder.
    """
    if path.exists() and not path.is_file():
        kind = "folder" if path.is_dir() else "device"
        raise RunError(
            f"{path} must be a file or a new name, but is a {kind}.",
            remedy="Name a file, for example result.html.",
        )
    try:
        put_whole(path, content)
    except OSError as error:
        raise RunError(
            f"{path} cannot be written: {error.strerror or error}.",
            why="What was saved before is whole.",
            remedy="Free some space, or make the folder writable, and go on: jbw resume DIR.",
        ) from error


def put_whole(path: Path, content: bytes) -> None:
    """Put a file in place of the one of before; where that fails, leave the old one untouched.

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
    """Write the folder to disk so that a rename survives a power cut, if the system can."""
    if os.name != "posix":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def require_room(folder: Path, room: int = ROOM) -> None:
    """Refuse a folder, made or not, whose disk has not so many bytes left, before any work."""
    made = next(place for place in (folder, *folder.absolute().parents) if os.path.exists(place))
    total, _, free = shutil.disk_usage(made)
    if total > 0 and free < room:  # some file systems state no size
        raise RunError(
            f"The disk of {folder} has {free / 2**20:.0f} MB left, but a run may need "
            f"{room / 2**20:.0f} MB.",
            remedy="Free some space, or choose a folder on another disk with --out.",
        )


def hash_of(path: Path) -> str:
    """Return the SHA-256 of a file in hexadecimal digits."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
