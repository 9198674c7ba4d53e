"""WAV files: full scale is 1, so that a calibration factor is needed; cut files are rejected."""

import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io.wavfile
from numpy.typing import NDArray

from jbw.measurement.files.tree import Contents, OnDemand, leaf


@contextmanager
def contents(path: Path) -> Iterator[Contents]:
    """Open a WAV file as `channel[0]`, `channel[1]`, ...; full scale of integer samples is 1."""
    _require_whole(path)
    with warnings.catch_warnings():
        # If the data chunk is cut off, scipy only warns and returns the remaining samples.
        warnings.simplefilter("error", scipy.io.wavfile.WavFileWarning)
        warnings.filterwarnings("ignore", message=".*not understood.*")
        try:
            rate, samples = scipy.io.wavfile.read(path, mmap=True)
        # Samples of 24 bits cannot be mapped into memory and are read at once; a damaged file then
        # raises an error again.
        except ValueError:
            rate, samples = scipy.io.wavfile.read(path)
    stored, integer = np.atleast_2d(samples.T), np.issubdtype(samples.dtype, np.integer)
    full = 2.0 ** (8 * samples.dtype.itemsize - 1) if integer else 1.0
    zero = 128.0 if samples.dtype == np.uint8 else 0.0  # 8-bit WAV is unsigned

    def read(index: Any) -> NDArray[np.float64]:
        return (stored[index].astype(np.float64) - zero) / full

    array = OnDemand(stored.shape, np.dtype(np.float64), read)
    notes = {"full scale": str(samples.dtype)}
    yield Contents({"channel": leaf(array)}, "WAV", fs=float(rate), notes=notes)


def _require_whole(path: Path) -> None:
    """Raise a ValueError if a chunk exceeds the file, has incomplete samples, or is not a chunk."""
    size, frame = path.stat().st_size, 1
    with path.open("rb") as stream:
        order = {b"RIFF": "<", b"RIFX": ">"}.get(stream.read(12)[:4])
        while order and (head := stream.read(8)):
            where = stream.tell() - len(head)
            if len(head) < 8:
                raise ValueError(f"at byte {where} the file ends within the head of a chunk")
            name, length = struct.unpack(f"{order}4sI", head)
            is_chunk = name.decode("ascii", "replace").isprintable()
            if (
                not is_chunk
                or stream.tell() + length > size
                or (name == b"data" and length % frame)
            ):
                raise ValueError(
                    f"the chunk {name!r} at byte {where} declares {length} bytes, which "
                    "contradicts the rest of the file"
                )
            begin = stream.tell()
            if name == b"fmt " and length >= 16:
                frame = max(_frame_of(struct.unpack(f"{order}2xHIIHH", stream.read(16))), 1)
            stream.seek(begin + length + length % 2)


def _frame_of(head: tuple[int, ...]) -> int:
    """Return the bytes per sample of all channels; raise an error for an inconsistent header."""
    channels, rate, bytes_a_second, frame, bits = head
    if bytes_a_second != rate * frame or frame != channels * -(-bits // 8):
        raise ValueError(
            f"the header contradicts itself: {channels} channel(s) with {bits} bits at {rate} "
            f"samples per second do not give {bytes_a_second} bytes per second and {frame} bytes "
            "per sample"
        )
    return frame
