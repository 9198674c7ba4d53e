"""Bytes of a MATLAB v5 file in their order: as they lie there, or unpacked in small steps."""

import zlib
from typing import BinaryIO, Protocol

from jbw.errors import DataError

STEP = 2**16  # bytes unpacked at a time


class Source(Protocol):
    """Bytes in their order, some of them passed over."""

    def take(self, count: int) -> bytes:
        """The next bytes; fewer at the end."""
        ...

    def skip(self, count: int) -> None:
        """Pass over bytes."""
        ...


class Plain:
    """Bytes of a file as they are."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream

    def take(self, count: int) -> bytes:
        """The next bytes; fewer at the end."""
        return self._stream.read(count)

    def skip(self, count: int) -> None:
        """Pass over bytes."""
        self._stream.seek(count, 1)


class Packed:
    """Bytes of a packed variable, unpacked in small steps."""

    def __init__(self, packed: bytes) -> None:
        self._packed, self._unpack, self._ready = packed, zlib.decompressobj(), b""

    def take(self, count: int) -> bytes:
        """The next bytes; fewer at the end."""
        while len(self._ready) < count:
            more = self._unpack.decompress(self._packed, STEP)
            self._packed = self._unpack.unconsumed_tail
            if not more:
                break
            self._ready += more
        taken, self._ready = self._ready[:count], self._ready[count:]
        return taken

    def skip(self, count: int) -> None:
        """Pass over bytes."""
        while count > 0 and (taken := self.take(min(count, STEP))):
            count -= len(taken)

    def finish(self) -> None:
        """Unpack the end, which holds a checksum."""
        if len(self.take(STEP)) == STEP:
            raise broken("a packed variable holds more than it declares")
        if not self._unpack.eof:
            raise broken("a packed variable has no end")


def broken(what: str) -> DataError:
    """The refusal of a file whose headers cannot be true."""
    remedy = "Copy the file again from where it was measured, or export it again."
    return DataError(what, remedy=remedy)
