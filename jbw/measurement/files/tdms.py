"""TDMS through npTDMS, an optional extra: samples stay on disk until asked for."""

import logging
import os
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from io import BufferedReader, FileIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from jbw.errors import DataError
from jbw.measurement.files.tree import Contents, Node, Opaque, leaf, optional

UNITS = ("unit_string", "NI_UnitDescription", "unit")  # properties that hold a channel's unit
INTERVAL = "wf_increment"  # property that holds the sampling interval [s]
LEAD_IN = 28  # bytes that begin a segment
METADATA, BIG_ENDIAN = 0x2, 0x40  # of the flags in them


@dataclass(frozen=True)
class Channel:
    """A TDMS channel as an array that is read on demand."""

    stored: Any
    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    def __getitem__(self, index: Any, /) -> Any:
        """Read a slice of the samples."""
        found = self.stored[index[0] if isinstance(index, tuple) else index]
        return np.asarray(found, dtype=self.dtype)

    def astype(self, dtype: DTypeLike) -> "Channel":
        """The same channel, converted as it is read."""
        return replace(self, dtype=np.dtype(dtype))


class Bounded(BufferedReader):
    """A file never asked for more bytes than it has, which a damaged length would do."""

    def read(self, size: int | None = -1, /) -> bytes:
        """The next bytes, up to the end of the file."""
        left = os.fstat(self.fileno()).st_size - self.tell()
        return super().read(left if size is None or size < 0 else min(size, max(left, 0)))


class Said(logging.Handler):
    """Keeps what the library logs, which prints the bytes of a damaged file by the page."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.messages: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keep the message."""
        self.messages.append(record.getMessage())


@contextmanager
def _overheard() -> Iterator[Said]:
    """What the library logs, kept instead of printed."""
    console = import_module("nptdms.log").log_manager.console_handler
    log, said, before = logging.getLogger("nptdms"), Said(), console.level
    passed_on, log.propagate = log.propagate, False
    console.setLevel(logging.ERROR)
    log.addHandler(said)
    try:
        yield said
    finally:
        log.removeHandler(said)
        console.setLevel(before)
        log.propagate = passed_on


@contextmanager
def contents(path: Path) -> Iterator[Contents]:
    """Open a TDMS file: groups hold channels, with their interval and unit."""
    nptdms = optional("nptdms", "tdms", path)
    # By its stream: given the path, npTDMS would believe a stale index file beside it.
    with _overheard() as said, Bounded(FileIO(path)) as stream:
        _require_consistent_segments(stream)
        with nptdms.TdmsFile.open(stream) as file:
            yield _checked(file, said, path)


def _require_consistent_segments(stream: Bounded) -> None:
    """Refuse a segment that says it has no metadata and where they end: it lost a flag.

    The library would go on with the channels before and add its bytes to their samples.
    """
    begin = 0
    while True:
        stream.seek(begin)
        lead_in = stream.read(LEAD_IN)
        if len(lead_in) < LEAD_IN or lead_in[:4] != b"TDSm":
            break
        flags = int.from_bytes(lead_in[4:8], "little")
        order = ">" if flags & BIG_ENDIAN else "<"
        length, samples_at = struct.unpack(f"{order}QQ", lead_in[12:])
        if samples_at and not flags & METADATA:
            raise ValueError(f"The segment at byte {begin} has lost its metadata.")
        begin += LEAD_IN + length
    stream.seek(0)


def _checked(file: Any, said: Said, path: Path) -> Contents:
    """Contents of an opened file; refused where samples of it are not there."""
    groups = file.groups()
    if file.file_status.incomplete_final_segment or not groups:
        found = sum(len(channel) for group in groups for channel in group.channels())
        raise DataError(
            f"File `{path}` ({path.stat().st_size} bytes) is cut short: only {found} samples "
            "of its channels can be read by the tdms reader.",
            remedy="Copy the file again; the recorder may not have closed it.",
        )
    torn = [message for message in said.messages if "not a multiple" in message]
    if torn:
        raise ValueError(torn[0])
    root: dict[str, Node] = {
        group.name: {channel.name: _node(channel) for channel in group.channels()}
        for group in groups
    }
    return Contents(root, "TDMS")


def _node(channel: Any) -> Node:
    if not np.issubdtype(channel.dtype, np.number):
        return Opaque("text" if channel.dtype == object else "not numeric")
    interval = float(channel.properties.get(INTERVAL) or 0.0)
    unit = next((str(channel.properties[key]) for key in UNITS if channel.properties.get(key)), "")
    array = Channel(channel, (len(channel),), np.dtype(channel.dtype))
    return leaf(array, fs=1 / interval if interval > 0 else None, unit=unit.strip())
