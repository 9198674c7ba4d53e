"""Headers of a MATLAB file before v7.3, walked before its reader is let in: what they say must be.

The reader takes types and sizes on trust: one changed byte among them can end the process, or take
all of its memory.
"""

import math
import struct
from pathlib import Path
from typing import BinaryIO

from jbw.errors import DataError
from jbw.measurement.files.mat_bytes import Packed, Plain, Source, broken

HEADER = 128  # bytes of a file before its first variable
MATRIX, COMPRESSED = 14, 15  # data types that hold further elements
# Data type of plain numbers or text to the bytes of one: int8 to uint64, then UTF-8, -16, -32.
NUMBERS = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8}
WIDTHS = {**NUMBERS, 16: 1, 17: 2, 18: 4}
WIDTHS_4 = {0: 8, 1: 4, 2: 4, 3: 2, 4: 2, 5: 1}  # the same of version 4
NAMES = (1, 2, 16)  # data types of names
CELL, STRUCT, OBJECT, CHAR, SPARSE = 1, 2, 3, 4, 5
NUMERIC = range(6, 16)  # classes of arrays of numbers: double to uint64
FUNCTION, OPAQUE = 16, 17
MOST_BARE = 2**16  # structs without a field in an array: nothing in the file stands for them
LONGEST_NAME = 2**16


class Walk:
    """The elements that lie one behind the other in a matrix of `size` bytes."""

    def __init__(self, source: Source, order: str, size: int) -> None:
        self.source, self.order, self.left = source, order, size

    def take(self, count: int) -> bytes:
        """The next bytes, all of them."""
        self._reduce(count)
        taken = self.source.take(count)
        if len(taken) < count:
            raise broken("it ends inside a variable")
        return taken

    def tag(self) -> tuple[int, int, bytes | None]:
        """Data type and size of the next element, and its content where that is in the tag."""
        head = self.take(8)
        kind, size = struct.unpack(f"{self.order}II", head)
        if kind >> 16:  # up to four bytes, within the tag
            small = min(kind >> 16, 4)
            return kind & 0xFFFF, kind >> 16, head[4 : 4 + small]
        if size > self.left:
            raise broken(f"an element declares {size} bytes, where {self.left} are left")
        return kind, size, None

    def content(self, what: str, kinds: tuple[int, ...]) -> bytes:
        """Content of the next element, which must be short and of one of the types."""
        kind, size, content = self.tag()
        if kind not in kinds or size > LONGEST_NAME:
            raise broken(f"its {what} have data type {kind} and {size} bytes")
        if content is None:
            content = self.take(size)
            self.skip(min(-size % 8, self.left))
        return content

    def whole_numbers(self, what: str, kinds: tuple[int, ...]) -> tuple[int, ...]:
        """The next element as integers of four bytes."""
        content = self.content(what, kinds)
        return struct.unpack(f"{self.order}{len(content) // 4}i", content[: len(content) & ~3])

    def numbers(self, count: int | None, kinds: dict[int, int]) -> None:
        """Pass over an element that must hold `count` numbers, or at least as many characters."""
        kind, size, content = self.tag()
        if kind not in kinds:
            raise broken(f"numbers have the data type {kind}, which does not exist")
        # Text may take more bytes than it has characters, or none at all where it is blank.
        exact = kinds is NUMBERS
        fits = count is None or (
            size == count * kinds[kind] if exact else size >= count or size == 0
        )
        if not fits:
            raise broken(f"an array of {count} values has {size} bytes")
        if content is None:
            self.skip(min(size + -size % 8, self.left))

    def matrices(self, count: int) -> None:
        """Walk through so many matrices."""
        if 8 * count > self.left:
            raise broken(f"{count} items are declared, where {self.left} bytes are left")
        for _ in range(count):
            kind, size, content = self.tag()
            if kind != MATRIX or content is not None:
                raise broken(f"an item of an array has the data type {kind}")
            self.inside(size)

    def inside(self, size: int) -> None:
        """Walk through the matrix of so many bytes that begins here."""
        self._reduce(size)
        within = Walk(self.source, self.order, size)
        if size:  # an empty item has no bytes at all
            _matrix(within)
        within.skip(within.left)

    def skip(self, count: int) -> None:
        """Pass over bytes."""
        self._reduce(count)
        self.source.skip(count)

    def _reduce(self, count: int) -> None:
        if count > self.left:
            raise broken("an element reaches beyond its variable")
        self.left -= count


def _matrix(walk: Walk) -> None:
    """Walk through one matrix: flags, shape, name, then what its class has."""
    flags = walk.whole_numbers("flags", (6,))
    if len(flags) != 2:
        raise broken("a variable has no flags")
    kind, is_complex = flags[0] & 0xFF, flags[0] >> 11 & 1
    if kind == OPAQUE:  # no shape; names of itself, its system and its class
        for _ in range(3):
            walk.content("names", NAMES)
        return walk.matrices(1)
    shape = walk.whole_numbers("dimensions", (5, 6))
    if not shape or min(shape) < 0 or len(shape) > 32:
        raise broken(f"a variable has the shape {shape}")
    walk.content("names", NAMES)
    count = math.prod(shape)
    if kind in NUMERIC:
        for _ in range(1 + is_complex):
            walk.numbers(count, NUMBERS)
    elif kind == CHAR:
        walk.numbers(count, WIDTHS)
    elif kind == CELL:
        walk.matrices(count)
    elif kind in (STRUCT, OBJECT):
        _fields(walk, count, kind)
    elif kind == SPARSE:  # rows, columns, values
        for _ in range(3 + is_complex):
            walk.numbers(None, NUMBERS)
    elif kind == FUNCTION:
        walk.matrices(1)
    else:
        raise broken(f"a variable has the class {kind}")
    return None


def _fields(walk: Walk, count: int, kind: int) -> None:
    if kind == OBJECT:
        walk.content("names", NAMES)
    lengths = walk.whole_numbers("field names", (5, 6))
    if len(lengths) != 1 or lengths[0] < 1:
        raise broken(f"a struct has field names of lengths {lengths}")
    fields = len(walk.content("field names", NAMES)) // lengths[0]
    if not fields and count > MOST_BARE:
        raise broken(f"{count} structs have no field")
    walk.matrices(count * fields)


def is_v5(header: bytes) -> bool:
    """Whether the first bytes of a file are those of version 5 to 7, which begins with a text."""
    return b"\0" not in header[:4]


def require_whole(path: Path) -> None:
    """Refuse a file of version 4 to 7 whose headers declare what is not there.

    Args:
        path: The file.

    Raises:
        DataError: A type that does not exist, or a size beyond what the file holds.

    Reference:
        MATLAB, MAT-File Format, level 5: data elements and their tags.
    """
    size = path.stat().st_size
    with path.open("rb") as stream:
        header = stream.read(HEADER)
        try:
            _variables(stream, header, size) if is_v5(header) else _variables_4(stream, size)
        except DataError as error:
            raise DataError(
                f"File `{path}` ({size} bytes) cannot be read by the mat reader: {error.what}.",
                remedy=error.remedy,
            ) from None


def _variables(stream: BinaryIO, header: bytes, size: int) -> None:
    """Walk through the variables of a v5 file, from behind its header."""
    order = {b"IM": "<", b"MI": ">"}.get(header[-2:])
    if order is None:
        raise broken("its header has no mark of the byte order")
    while size - stream.tell() >= 8:
        kind, length = struct.unpack(f"{order}II", stream.read(8))
        after = stream.tell() + length
        if after > size:
            raise broken("its last variable is cut short")
        _variable(stream, order, kind, length)
        stream.seek(after)


def _variables_4(stream: BinaryIO, size: int) -> None:
    """Walk through the variables of a v4 file: type, rows, columns, imaginary part, name."""
    stream.seek(0)
    while size - stream.tell() >= 20:
        head = stream.read(20)
        order = "<" if 0 <= struct.unpack("<i", head[:4])[0] <= 5000 else ">"
        kind, rows, columns, is_complex, name = struct.unpack(f"{order}5i", head)
        width = WIDTHS_4.get(kind // 10 % 10, 0)
        end = stream.tell() + name + rows * columns * width * (1 + (is_complex == 1))
        if not width or min(rows, columns, name) < 0 or end > size:
            raise broken(f"a variable of {rows} x {columns} values is not there")
        stream.seek(end)


def _variable(stream: BinaryIO, order: str, kind: int, length: int) -> None:
    if kind == MATRIX:
        return Walk(Plain(stream), order, length).inside(length)
    if kind != COMPRESSED:
        raise broken(f"a variable has the data type {kind}")
    packed = Packed(stream.read(length))
    kind, length = struct.unpack(f"{order}II", packed.take(8))
    if kind != MATRIX:
        raise broken(f"a packed variable has the data type {kind}")
    Walk(packed, order, length).inside(length)
    return packed.finish()
