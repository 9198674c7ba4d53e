"""Validation of the headers of MATLAB files before v7.3, before their content is read.

The reader trusts types and sizes: one changed byte among them can crash the process or exhaust
its memory. Validation before reading refuses both at once and on every system. A separate process
with limits would take time to start, read every file twice, and depend on a timer.
"""

import math
import struct
import zlib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from jbw.memory import require_readable
from jbw.report.messages import reading as messages

HEADER = 128  # number of bytes before the first variable of a file
MATRIX, COMPRESSED = 14, 15  # data types that contain further elements
# bytes per value for each data type of plain numbers or text: int8 to uint64, then UTF-8, -16, -32
NUMBERS = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8}
WIDTHS = {**NUMBERS, 16: 1, 17: 2, 18: 4}
WIDTHS_4 = {0: 8, 1: 4, 2: 4, 3: 2, 4: 2, 5: 1}  # bytes per value for each data type in version 4
NAMES = (1, 2, 16)  # data types in which names are stored
CELL, STRUCT, OBJECT, CHAR, SPARSE = 1, 2, 3, 4, 5
NUMERIC = range(6, 16)  # classes of numeric arrays: double to uint64
FUNCTION, OPAQUE = 16, 17
MOST_BARE = 2**16  # largest number of structs without fields, which occupy no bytes in the file
LONGEST_NAME = 2**16
SLACK = 2**16  # number of bytes by which a compressed variable may exceed its declared size


def require_sound(path: Path) -> None:
    """Raise an error if headers declare content that is absent or too large to be read at once."""
    # Reference: MATLAB, MAT-File Format, level 5: data elements and their tags.
    data = memoryview(np.memmap(path, np.uint8, "r"))
    # Versions 5 to 7 begin with text, version 4 with a number below 5000.
    variables = _variables(data) if 0 not in data[:4] else _variables_4(data)
    declared = 0
    for size, check in variables:
        declared += size
        require_readable(declared, f"File `{path.name}` declares", messages.AS_V73)
        check()


def _variables(data: memoryview) -> Iterator[tuple[int, Callable[[], None]]]:
    """Yield the unpacked size [bytes] of each variable in a v5 file, and a check function."""
    order = {b"IM": "<", b"MI": ">"}.get(bytes(data[HEADER - 2 : HEADER]))
    if order is None:
        raise ValueError("the header of the file does not state the byte order")
    file = Elements(data[HEADER:], order)
    while len(file.data) >= 8:
        code, size = file.integers("II")
        content = file.take(size)
        if code not in (MATRIX, COMPRESSED):
            raise ValueError(
                f"the data type of a variable must be {MATRIX} or {COMPRESSED}, but is {code}"
            )
        if code == COMPRESSED:
            head = zlib.decompressobj().decompress(content[:256], 8)
            code, size = Elements(memoryview(head), order).integers("II")
            if code != MATRIX:
                raise ValueError(
                    f"the data type of a compressed variable must be {MATRIX}, but is {code}"
                )
            yield size, partial(_packed, content, order, size)
        else:
            yield size, partial(_matrix, content, order)


def _variables_4(data: memoryview) -> Iterator[tuple[int, Callable[[], None]]]:
    """Yield the size [bytes] of each variable in a v4 file, and a check function without effect.

    A variable consists of type, rows, columns, imaginary part, name and numbers.
    """
    file = Elements(data, "<")
    while len(file.data) >= 20:
        first = struct.unpack("<i", file.data[:4])[0]
        file.order = "<" if 0 <= first <= 5000 else ">"
        code, rows, columns, is_complex, name = file.integers("5i")
        width = WIDTHS_4.get(code // 10 % 10, 0)
        if not width or min(rows, columns, name) < 0:
            raise ValueError(f"the header of a variable ({rows} x {columns} values) is damaged")
        size = rows * columns * width * (1 + (is_complex == 1))
        file.take(name + size)
        yield size, lambda: None


def _packed(content: memoryview, order: str, size: int) -> None:
    """Unpack a compressed variable of a v5 file and validate it."""
    unpack = zlib.decompressobj()
    unpacked = memoryview(unpack.decompress(content, 8 + size + SLACK))
    if not unpack.eof:  # The checksum is at the end.
        raise ValueError("a compressed variable is cut off, or larger than its declared size")
    _matrix(Elements(unpacked[8:], order).take(size), order)


class Elements:
    """Consecutive elements in a block of bytes, which are read from its start."""

    def __init__(self, data: memoryview, order: str) -> None:
        self.data, self.order = data, order

    def take(self, count: int) -> memoryview:
        """Return the next `count` bytes of a MATLAB file; raise a ValueError if fewer remain."""
        if count > len(self.data):
            raise ValueError(f"the file declares {count} bytes, but has only {len(self.data)} more")
        head, self.data = self.data[:count], self.data[count:]
        return head

    def integers(self, form: str) -> tuple[int, ...]:
        """Return the next bytes of a MATLAB file as integers, in the given struct format."""
        form = self.order + form
        return struct.unpack(form, self.take(struct.calcsize(form)))

    def element(self) -> tuple[int, memoryview]:
        """Return type and content of the next element; its tag contains up to four bytes."""
        (code,) = self.integers("I")
        if size := code >> 16:
            if size > 4:
                raise ValueError(f"a small element must have 4 bytes at most, but declares {size}")
            return code & 0xFFFF, self.take(4)[:size]
        (size,) = self.integers("I")
        content = self.take(size)
        if code != MATRIX:
            self.take(min(-size % 8, len(self.data)))
        return code, content

    def short(self, what: str, codes: tuple[int, ...]) -> memoryview:
        """Return the next element's content; raise an error if it is long or of another type."""
        code, content = self.element()
        if code not in codes or len(content) > LONGEST_NAME:
            raise ValueError(
                f"the {what} of a variable are damaged: data type {code}, {len(content)} bytes"
            )
        return content

    def whole_numbers(self, what: str, codes: tuple[int, ...]) -> tuple[int, ...]:
        """Return the next element of a MATLAB file as four-byte integers."""
        content = self.short(what, codes)
        return struct.unpack(f"{self.order}{len(content) // 4}i", content[: len(content) & ~3])

    def numbers(self, count: int | None) -> None:
        """Skip the next element after a check that it contains `count` numbers."""
        code, content = self.element()
        if code not in NUMBERS or count not in (None, len(content) / NUMBERS[code]):
            raise ValueError(f"{count} numbers cannot have type {code} and {len(content)} bytes")

    def text(self, count: int) -> None:
        """Skip the next text, which may have more bytes than characters, or none at all."""
        code, content = self.element()
        if code not in WIDTHS or 0 < len(content) < count:
            raise ValueError(f"{count} characters cannot have type {code} and {len(content)} bytes")

    def matrices(self, count: int) -> None:
        """Validate the next `count` matrices of a MATLAB file."""
        if 8 * count > len(self.data):
            raise ValueError(
                f"the file declares {count} items, but has only {len(self.data)} more bytes"
            )
        for _ in range(count):
            code, content = self.element()
            if code != MATRIX:
                raise ValueError(
                    f"an item of a cell array or struct is not a matrix, but has type {code}"
                )
            _matrix(content, self.order)


def _matrix(content: memoryview, order: str) -> None:
    """Validate one matrix: flags, shape, name, then the content that its class requires."""
    if not content:  # An empty item has no bytes.
        return
    walk = Elements(content, order)
    flags = walk.whole_numbers("flags", (6,))
    if len(flags) != 2:
        raise ValueError("a variable has no flags")
    of_class, is_complex = flags[0] & 0xFF, flags[0] >> 11 & 1
    # An opaque object of a MATLAB class has no shape; its name, its system and its class follow.
    if of_class == OPAQUE:
        for _ in range(3):
            walk.short("names", NAMES)
        walk.matrices(1)
        return
    shape = walk.whole_numbers("dimensions", (5, 6))
    if not shape or min(shape) < 0 or len(shape) > 32:
        raise ValueError(f"the shape of a variable is {shape}, which is impossible")
    walk.short("names", NAMES)
    count = math.prod(shape)
    if of_class in NUMERIC:
        for _ in range(1 + is_complex):
            walk.numbers(count)
    elif of_class == CHAR:
        walk.text(count)
    elif of_class == CELL:
        walk.matrices(count)
    elif of_class in (STRUCT, OBJECT):
        _fields(walk, count, of_class)
    elif of_class == SPARSE:  # rows, columns, values
        for _ in range(3 + is_complex):
            walk.numbers(None)
    elif of_class == FUNCTION:
        walk.matrices(1)
    else:
        raise ValueError(f"a variable has the unknown class {of_class}")


def _fields(walk: Elements, count: int, of_class: int) -> None:
    """Validate the fields of `count` structs, or of objects, which begin with a class name."""
    if of_class == OBJECT:
        walk.short("names", NAMES)
    lengths = walk.whole_numbers("field names", (5, 6))
    if len(lengths) != 1 or lengths[0] < 1:
        raise ValueError(
            f"the length of a struct's field names must be one positive number, but is {lengths}"
        )
    fields = len(walk.short("field names", NAMES)) // lengths[0]
    if not fields and count > MOST_BARE:
        raise ValueError(f"{count} structs must have at least one field, but have no field")
    walk.matrices(count * fields)
