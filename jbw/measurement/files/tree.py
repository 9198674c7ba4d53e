"""The content of a file of any format as a tree of names, cells and arrays, read on demand."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from jbw import memory
from jbw.errors import DataError
from jbw.report.messages import reading as messages

# endings of names of sampling frequencies, such as `_fs_hz` or `log_samplerate`
RATE = re.compile(
    r"(?:^|_)(?:fs|sampl(?:e|ing)_(?:frequency|freq|rate)|samplerate)(?:_?hz)?_*$", re.IGNORECASE
)
LONGEST_TEXT = 4096  # longest text in a file that is examined [characters]
WHOLE = slice(0, None)


@dataclass(frozen=True)
class Leaf:
    """A numeric array of a file and the selected part of that array; it is read on demand."""

    # numpy array, or an object of the file with shape and dtype, such as an h5py dataset
    array: Any
    axes: tuple[int, ...]  # those stored axes that have no index yet, in the user's order
    # index of every stored axis that is not in `axes`
    fixed: Mapping[int, int] = field(default_factory=dict)
    fs: float | None = None  # sampling frequency that the file states for the array [Hz], if any
    unit: str = ""  # unit that the file states for the array, if any
    # start of the array as stated in the file, relative to an arbitrary time [s]
    start_s: float | None = None
    minus: "Leaf | None" = None  # an array to subtract, if this is a difference of two channels
    label: str = ""  # name of the array in the file, if its path does not contain it
    # all other attributes of the array in the file
    attributes: Mapping[str, Any] = field(default_factory=dict)

    @property
    def shape(self) -> tuple[int, ...]:
        """The length of each axis that has no index."""
        return tuple(self.array.shape[axis] for axis in self.axes)


@dataclass(frozen=True)
class OnDemand:
    """An array of a file that a function reads and converts part by part."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    read: Callable[[Any], Any]

    def __getitem__(self, index: Any, /) -> NDArray[Any]:
        return np.asarray(self.read(index), self.dtype)

    def astype(self, dtype: DTypeLike) -> "OnDemand":
        """Return the array with another type of values."""
        return replace(self, dtype=np.dtype(dtype))


@dataclass(frozen=True)
class Opaque:
    """An item of a file that is no array of numbers."""

    kind: str  # description, for messages
    remedy: str = ""  # instruction for exporting the item as numbers
    text: str = ""  # content of an item that is text, with one line per text


@dataclass(frozen=True)
class Contents:
    """The content of an open file."""

    root: "Node"  # tree of the file
    reader: str  # name of the reader that opened the file
    fs: float | None = None  # sampling frequency of the whole file [Hz], if stated
    # decisions of the reader, for the provenance
    notes: Mapping[str, str] = field(default_factory=dict)
    attributes: Mapping[str, Any] = field(default_factory=dict)  # attributes of the file as a whole
    # Measured channels by path; None if any array may be a channel.
    series: "Mapping[str, Leaf] | None" = None
    recorder: str = ""  # recorder that wrote the file, if known
    # sentences on information in the file that the reader cannot use
    doubts: tuple[str, ...] = ()


# Cells are stored as a numpy array of objects, each of which is again an item of the tree.
Node = Mapping[str, Any] | NDArray[Any] | Leaf | Opaque


def leaf(
    array: Any, *, fs: float | None = None, unit: str = "", start_s: float | None = None
) -> Leaf:
    """Return a whole array as an item of the tree, with its axes in stored order."""
    return Leaf(array, tuple(range(len(array.shape))), fs=fs, unit=unit, start_s=start_s)


def numeric(array: NDArray[Any]) -> Leaf | Opaque:
    """Return an array in memory as an item of the tree; opaque if it contains no numbers."""
    if np.issubdtype(array.dtype, np.number):
        return leaf(array)
    if not np.issubdtype(array.dtype, np.character):
        return Opaque("not numeric")
    few = array.size <= LONGEST_TEXT and array.nbytes <= 64 * LONGEST_TEXT
    return Opaque("text", text="\n".join(map(str, array.ravel())) if few else "")


def cells(nodes: Sequence[Node], shape: tuple[int, ...]) -> NDArray[Any]:
    """Return an object array of the given shape, filled with items of the tree."""
    container = np.empty(len(nodes), dtype=object)
    for i, node in enumerate(nodes):
        container[i] = node
    return container.reshape(shape)


def names(root: Node, prefix: str = "") -> Iterator[tuple[str, Leaf | Opaque]]:
    """Yield the path and content of every array or opaque item of the tree."""
    if isinstance(root, Leaf | Opaque):
        yield prefix, root
    elif isinstance(root, Mapping):
        for name, node in root.items():
            yield from names(node, f"{prefix}.{name}" if prefix else name)
    else:
        for index in np.ndindex(root.shape):
            yield from names(root[index], prefix + "".join(f"[{i}]" for i in index))


def load(source: Leaf, part: slice = WHOLE, dtype: DTypeLike | None = None) -> NDArray[Any]:
    """Load an array, or a part along its last open axis; axes of length one are dropped."""
    # The array is converted to `dtype` on reading, unless `dtype` is None or the array is complex.
    array: Any = source.array
    axes = [axis for axis in source.axes if array.shape[axis] != 1] or source.axes[-1:]
    index: list[Any] = [source.fixed.get(i, 0) for i in range(len(array.shape))]
    for axis in axes:
        index[axis] = WHOLE
    if axes:
        index[axes[-1]] = part
    lengths = [len(range(*index[axis].indices(array.shape[axis]))) for axis in axes]
    # The size in memory counts, since packed bytes of a file may unpack to eight times as many.
    width = max(array.dtype.itemsize, np.dtype(dtype or array.dtype).itemsize)
    size = int(np.prod(lengths, dtype=np.float64)) * width
    fewer = memory.MAX_BYTES * lengths[-1] / max(size, 1) if lengths else 1
    remedy = messages.beginning(source.fs, fewer)
    memory.require_readable(size, messages.channel_takes(source.shape), remedy)
    is_complex = np.issubdtype(array.dtype, np.complexfloating)
    if dtype is not None and not is_complex and not isinstance(array, np.ndarray):
        array = array.astype(dtype)  # h5py converts while it reads, without a second copy.
    loaded = np.asarray(array[tuple(index)], None if is_complex else dtype)
    loaded = np.atleast_1d(loaded.transpose(np.argsort(np.argsort(axes))))
    if source.minus is None:
        return loaded
    facts = [
        f"shape {leaf.shape}, unit `{leaf.unit}`, fs {leaf.fs or 'unstated'}"
        for leaf in (source, source.minus)
    ]
    if facts[0] != facts[1]:
        raise DataError(
            f"Channels that are subtracted must agree, but one channel has {facts[0]}, "
            f"and the other channel has {facts[1]}.",
            remedy="Subtract channels that were sampled together, in the same unit.",
        )
    # The difference is computed in float64, because integers would wrap around.
    subtracted = load(source.minus, part)
    return np.subtract(loaded, subtracted, dtype=np.result_type(loaded, subtracted, np.float64))


def optional(package: str, extra: str, path: Path) -> Any:
    """Import a package that only one file format needs; raise a DataError if it is missing."""
    try:
        return import_module(package)
    except ImportError:
        raise DataError(
            f"File `{path.name}` needs the package {package} to be read.",
            remedy=f"Install the package: pip install jbw[{extra}]",
        ) from None
