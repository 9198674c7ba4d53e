"""`watch.jsonl`: a line a record, appended whole, and what a crash cut off set aside."""

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from jbw.errors import RunError
from jbw.report.messages import watch
from jbw.run.folder import lock

NAME = "watch.jsonl"
TORN = "watch.torn"  # beside it: lines that a crash cut, as they were found
Entry = dict[str, Any]


@contextmanager
def locked_log(folder: Path) -> Iterator[Path]:
    """The log of a run's folder, for this process alone."""
    path = folder / NAME
    try:
        held = lock(folder / f".{NAME}.lock", folder)
    except OSError as error:
        raise _unwritable(path, error) from error
    try:
        yield path
    finally:
        held.release()


def read_log(path: Path) -> list[Entry]:
    """Every entry of a log, the oldest first; none where there is no log.

    Raises:
        RunError: A line that is no entry, other than the last, which `set_aside` takes away.
    """
    if not path.exists():
        return []
    entries = []
    lines = path.read_bytes().split(b"\n")
    for number, line in enumerate(lines[:-1], start=1):
        try:
            entry = json.loads(line)
            kind = entry["kind"]
        except (ValueError, KeyError, TypeError, RecursionError):
            kind = None
        if not isinstance(kind, str):
            raise RunError(
                f"Line {number} of {path} is no entry of a watch.",
                why="What is stated of later records depends on it.",
                remedy="Restore the file from a copy, or move it away and begin the watch anew.",
            )
        entries.append(entry)
    return entries


def set_aside(path: Path) -> str | None:
    """Move a last line that a crash cut off to `watch.torn`; what to say of it, None if whole."""
    content = path.read_bytes() if path.exists() else b""
    complete, mark, torn = content.rpartition(b"\n")
    if not torn:
        return None
    torn_path = path.with_name(TORN)
    try:
        _append(torn_path, torn + b"\n")  # first kept, then cut: a crash between leaves it twice
        with path.open("rb+") as stream:
            stream.truncate(len(complete) + len(mark))
            os.fsync(stream.fileno())
    except OSError as error:
        raise _unwritable(path, error) from error
    return watch.torn_line(str(path), len(torn), str(torn_path))


def append(path: Path, entry: Mapping[str, Any]) -> None:
    """Add an entry by one write, which reaches the disk before this returns."""
    line = json.dumps(entry, ensure_ascii=False, allow_nan=False) + "\n"
    try:
        _append(path, line.encode())
    except OSError as error:
        raise _unwritable(path, error) from error


def _append(path: Path, content: bytes) -> None:
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    try:
        written = os.write(handle, content)
        if written < len(content):  # a full disk: the next call sets the half line aside
            raise OSError(f"only {written} of {len(content)} bytes were written")
        os.fsync(handle)
    finally:
        os.close(handle)


def _unwritable(path: Path, error: OSError) -> RunError:
    return RunError(
        f"{path} cannot be written: {error.strerror or error}.",
        why="What was written before is whole.",
        remedy="Free some space, or make the folder writable, and add the record again.",
    )
