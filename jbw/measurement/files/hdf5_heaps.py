"""Heaps of an HDF5 file, in which its texts lie: walked before the library does.

One changed byte in a heap, and the library walks in it without end, deaf even to Ctrl-C.
"""

import mmap
import struct
from pathlib import Path

from jbw.errors import DataError

MARK = b"GCOL\x01\0\0\0"  # a heap: signature, version, three bytes of nothing; then its size
HEAD = 16  # bytes of a heap's head, and of an object's
LEAST = 4096  # bytes of a heap
REACH = 2**26  # bytes looked through at either end of a file; samples lie between


def require_sound_heaps(path: Path) -> None:
    """Refuse a file with a heap in which one object does not lead to the next.

    Args:
        path: The file.

    Raises:
        DataError: An object of no size, or one that reaches beyond its heap.

    Reference:
        HDF5 File Format Specification 3.0, section III.E.
    """
    size = path.stat().st_size
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        for begin, end in {(0, min(REACH, size)), (max(size - REACH, 0), size)}:
            at = data.find(MARK, begin, end)
            while at >= 0:
                if not _is_sound(data, at):
                    raise DataError(
                        f"File `{path}` ({size} bytes) cannot be read by the hdf5 reader: its heap "
                        f"at byte {at} is broken.",
                        remedy="Copy the file again from where it was measured, or export it "
                        "again.",
                    )
                at = data.find(MARK, at + 1, end)


def _is_sound(data: mmap.mmap, start: int) -> bool:
    """Whether the objects of a heap fill it, one behind the other."""
    head = data[start + len(MARK) : start + HEAD]
    total = int.from_bytes(head, "little")
    if len(head) < HEAD - len(MARK) or not LEAST <= total <= len(data) - start:
        return True  # no heap: these bytes are samples, or the library refuses them by their size
    at = HEAD
    while at + HEAD <= total:
        number, _, _, size = struct.unpack("<HHIQ", data[start + at : start + at + HEAD])
        # Free space, number 0, counts its own head; objects do not, and are padded to 8 bytes.
        step = size if number == 0 else HEAD + size + -size % 8
        if step < 8 or at + step > total:
            return False
        at += step
    return True
