"""The content of a file of any format: a tree of names, cells and arrays, read on demand."""

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

# What ends as a sampling frequency is called, such as `_fs_hz` or `log_samplerate`.
RATE = re.compile(
    r"(?:^|_)(?:fs|sampl(?:e|ing)_(?:frequency|freq|rate)|samplerate)(?:_?hz)?_*$", re.IGNORECASE
)
LONGEST_TEXT = 4096  # letters of a text in a file that are looked at
WHOLE = slice(0, None)


@dataclass(frozen=True)
class Leaf:
    """A numeric array of a file, and the part of it that a path selects; read only on demand."""

    array: Any  # with shape, dtype and items: numpy's, or of the file, such as h5py's dataset
    axes: tuple[int, ...]  # stored axes still open, in the user's order
    # Stored axis to the index taken along it.
    fixed: Mapping[int, int] = field(default_factory=dict)
    fs: float | None = None  # sampling frequency that the file gives for it [Hz], if any
    unit: str = ""  # unit that the file gives for it, if any
    start_s: float | None = None  # when it was started, as the file says, since some instant [s]
    minus: "Leaf | None" = None  # what to subtract from it, if it is a difference of two channels
    label: str = ""  # what the file calls it, where its path does not tell
    attributes: Mapping[str, Any] = field(default_factory=dict)  # whatever else the file says of it

    @property
    def shape(self) -> tuple[int, ...]:
        """Length of each open axis."""
        return tuple(self.array.shape[axis] for axis in self.axes)


@dataclass(frozen=True)
class OnDemand:
    """An array of a file that a function reads, index by index, converted as it is read."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    read: Callable[[Any], Any]

    def __getitem__(self, index: Any, /) -> NDArray[Any]:
        return np.asarray(self.read(index), self.dtype)

    def astype(self, dtype: DTypeLike) -> "OnDemand":
        """Return the same array in another type."""
        return replace(self, dtype=np.dtype(dtype))


@dataclass(frozen=True)
class Opaque:
    """Something that is no array of numbers."""

    kind: str  # what it is, for messages
    remedy: str = ""  # how to export it instead
    text: str = ""  # what it says, if it is text; of several texts a line each


@dataclass(frozen=True)
class Contents:
    """An open file."""

    root: "Node"  # its tree
    reader: str  # which reader opened it
    fs: float | None = None  # sampling frequency of the whole file [Hz], if it gives one
    # What the reader decided by itself, for the provenance.
    notes: Mapping[str, str] = field(default_factory=dict)
    attributes: Mapping[str, Any] = field(default_factory=dict)  # what the file says of itself
    # Path to the channels that a recorder measured; None where all arrays may be such.
    series: "Mapping[str, Leaf] | None" = None
    recorder: str = ""  # which wrote it, if it is known
    doubts: tuple[str, ...] = ()  # what the file says and its reader cannot use, a sentence each


# A container of cells is a numpy array of objects, each a node.
Node = Mapping[str, Any] | NDArray[Any] | Leaf | Opaque


def leaf(
    array: Any, *, fs: float | None = None, unit: str = "", start_s: float | None = None
) -> Leaf:
    """Return the leaf of a whole array, with its axes in stored order."""
    return Leaf(array, tuple(range(len(array.shape))), fs=fs, unit=unit, start_s=start_s)


def numeric(array: NDArray[Any]) -> Leaf | Opaque:
    """Return the leaf of an array in memory, if it has numbers."""
    if np.issubdtype(array.dtype, np.number):
        return leaf(array)
    if not np.issubdtype(array.dtype, np.character):
        return Opaque("not numeric")
    few = array.size <= LONGEST_TEXT and array.nbytes <= 64 * LONGEST_TEXT
    return Opaque("text", text="\n".join(map(str, array.ravel())) if few else "")


def cells(nodes: Sequence[Node], shape: tuple[int, ...]) -> NDArray[Any]:
    """Return an object array of the given shape filled with nodes."""
    container = np.empty(len(nodes), dtype=object)
    for i, node in enumerate(nodes):
        container[i] = node
    return container.reshape(shape)


def names(root: Node, prefix: str = "") -> Iterator[tuple[str, Leaf | Opaque]]:
    """Yield every path of the tree that ends in an array, and what is there."""
    if isinstance(root, Leaf | Opaque):
        yield prefix, root
    elif isinstance(root, Mapping):
        for name, node in root.items():
            yield from names(node, f"{prefix}.{name}" if prefix else name)
    else:
        for index in np.ndindex(root.shape):
            yield from names(root[index], prefix + "".join(f"[{i}]" for i in index))


def load(source: Leaf, part: slice = WHOLE, dtype: DTypeLike | None = None) -> NDArray[Any]:
    """Read a leaf, or a part along its last open axis; axes of length one are dropped."""
    # Converted to `dtype` while it is read; left as stored when None, or when complex.
    array: Any = source.array
    axes = [axis for axis in source.axes if array.shape[axis] != 1] or source.axes[-1:]
    index: list[Any] = [source.fixed.get(i, 0) for i in range(len(array.shape))]
    for axis in axes:
        index[axis] = WHOLE
    if axes:
        index[axes[-1]] = part
    lengths = [len(range(*index[axis].indices(array.shape[axis]))) for axis in axes]
    # As it will be held: bytes that a file packs may unpack to eight times as many.
    width = max(array.dtype.itemsize, np.dtype(dtype or array.dtype).itemsize)
    size = int(np.prod(lengths, dtype=np.float64)) * width
    fewer = memory.MAX_BYTES * lengths[-1] / max(size, 1) if lengths else 1
    remedy = messages.beginning(source.fs, fewer)
    memory.require_readable(size, messages.channel_takes(source.shape), remedy)
    is_complex = np.issubdtype(array.dtype, np.complexfloating)
    if dtype is not None and not is_complex and not isinstance(array, np.ndarray):
        array = array.astype(dtype)  # h5py converts as it reads, without a second copy
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
            f"Channels that are subtracted must agree, but one has {facts[0]}, "
            f"the other {facts[1]}.",
            remedy="Subtract channels that were sampled together, in one unit.",
        )
    # In float64, so that integers do not wrap around.
    subtracted = load(source.minus, part)
    return np.subtract(loaded, subtracted, dtype=np.result_type(loaded, subtracted, np.float64))


def optional(package: str, extra: str, path: Path) -> Any:
    """Return a library that only files of one format need."""
    try:
        return import_module(package)
    except ImportError:
        raise DataError(
            f"File `{path.name}` needs the package {package} to be read.",
            remedy=f"Install it: pip install jbw[{extra}]",
        ) from None
