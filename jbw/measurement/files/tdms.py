"""TDMS files, read by the optional package npTDMS; samples stay on disk until needed."""

import logging
import os
import struct
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from io import BufferedReader, FileIO
from logging.handlers import BufferingHandler
from pathlib import Path
from typing import Any

import numpy as np

from jbw.errors import DataError
from jbw.measurement.files.tree import Contents, Node, OnDemand, Opaque, leaf, optional

# Properties that may contain a channel's unit.
UNITS = ("unit_string", "NI_UnitDescription", "unit")
INTERVAL = "wf_increment"  # property that contains the sampling interval [s]
# Properties that contain a channel's start date, and the seconds after it.
START, OFFSET = "wf_start_time", "wf_start_offset"
SECOND = np.timedelta64(1, "s")
LEAD_IN = 28  # number of bytes at the beginning of a segment
METADATA, BIG_ENDIAN = 0x2, 0x40  # flags in the lead-in


class Bounded(BufferedReader):
    """A reader that stops at the end of the file, even if a damaged length states more bytes."""

    def read(self, size: int | None = -1, /) -> bytes:
        """Return the next bytes of the file, at most up to its end."""
        remaining = os.fstat(self.fileno()).st_size - self.tell()
        return super().read(remaining if size is None or size < 0 else min(size, max(remaining, 0)))


@contextmanager
def _overheard() -> Iterator[list[logging.LogRecord]]:
    """Collect npTDMS's log messages, which for a damaged file contain many of its bytes."""
    console = import_module("nptdms.log").log_manager.console_handler
    log, handler, level = logging.getLogger("nptdms"), BufferingHandler(sys.maxsize), console.level
    handler.setLevel(logging.WARNING)
    passed_on, log.propagate = log.propagate, False
    console.setLevel(logging.ERROR)
    log.addHandler(handler)
    try:
        yield handler.buffer
    finally:
        log.removeHandler(handler)
        console.setLevel(level)
        log.propagate = passed_on


@contextmanager
def contents(path: Path) -> Iterator[Contents]:
    """Open a TDMS file as groups of channels, with the interval and unit of each."""
    nptdms = optional("nptdms", "tdms", path)
    # With a path instead of a stream, npTDMS would trust an outdated index file next to it.
    with _overheard() as logged, Bounded(FileIO(path)) as stream:
        _require_consistent_segments(stream)
        with nptdms.TdmsFile.open(stream) as file:
            yield _checked(file, logged, path)


def _require_consistent_segments(stream: Bounded) -> None:
    """Raise a ValueError if a segment has lost its metadata flag or is cut off."""
    # npTDMS would reuse the previous channels and append the segment's bytes to them.
    begin = 0
    while True:
        stream.seek(begin)
        lead_in = stream.read(LEAD_IN)
        if begin and not lead_in:
            break
        if begin and (len(lead_in) < LEAD_IN or lead_in[:4] != b"TDSm"):
            raise ValueError(
                f"The file is incomplete: the segment at byte {begin} ends within the lead-in."
            )
        if len(lead_in) < LEAD_IN or lead_in[:4] != b"TDSm":
            break  # This is no TDMS file; npTDMS itself reports what is missing.
        flags = int.from_bytes(lead_in[4:8], "little")
        order = ">" if flags & BIG_ENDIAN else "<"
        length, samples_at = struct.unpack(f"{order}QQ", lead_in[12:])
        if samples_at and not flags & METADATA:
            raise ValueError(f"The file is damaged: the segment at byte {begin} has no metadata.")
        begin += LEAD_IN + length
    stream.seek(0)


def _checked(file: Any, logged: Sequence[logging.LogRecord], path: Path) -> Contents:
    """Return the contents of an opened file; raise an error if some of its samples are missing."""
    groups = file.groups()
    if file.file_status.incomplete_final_segment or not groups:
        num_samples = sum(len(channel) for group in groups for channel in group.channels())
        raise DataError(
            f"File `{path}` ({path.stat().st_size} bytes) is cut short: only {num_samples} samples "
            "of its channels can be read by the tdms reader.",
            remedy="Copy the file again; the recorder may not have closed the file.",
        )
    for record in logged:
        if "not a multiple" in record.getMessage():
            raise ValueError(record.getMessage())
    starts = {
        channel.path: channel.properties[START]
        for group in groups
        for channel in group.channels()
        if START in channel.properties
    }
    first = min(starts.values(), default=None)
    # A date in seconds would lose its microseconds; times therefore count from the first start.
    seconds = {path: float((time - first) / SECOND) for path, time in starts.items()}
    root: dict[str, Node] = {
        group.name: {
            channel.name: _node(channel, seconds.get(channel.path)) for channel in group.channels()
        }
        for group in groups
    }
    return Contents(root, "TDMS")


def _node(channel: Any, start_s: float | None) -> Node:
    if not np.issubdtype(channel.dtype, np.number):
        return Opaque("text" if channel.dtype == object else "not numeric")
    interval = float(channel.properties.get(INTERVAL) or 0.0)
    unit = next((str(channel.properties[key]) for key in UNITS if channel.properties.get(key)), "")
    array = OnDemand((len(channel),), np.dtype(channel.dtype), lambda index: channel[index[0]])
    if start_s is not None:
        start_s += float(channel.properties.get(OFFSET) or 0.0)
    fs = 1 / interval if interval > 0 else None
    samples = leaf(array, fs=fs, unit=unit.strip(), start_s=start_s)
    return replace(samples, label=str(channel.properties.get("NI_ChannelName", "")))
