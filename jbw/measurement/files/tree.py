"""What a file holds, whatever its format: a tree of names, cells and arrays, read on demand."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import DTypeLike, NDArray

from jbw.errors import DataError

MAX_BYTES = 4 * 2**30  # of one channel in memory: stops decompression bombs and slips


class Stored(Protocol):
    """An array in memory or in a file: numpy's, or h5py's dataset."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Length of each axis."""
        ...

    @property
    def dtype(self) -> Any:
        """Type of the elements."""
        ...

    def __getitem__(self, index: Any, /) -> Any:
        """Read a selection."""
        ...


@dataclass(frozen=True)
class Leaf:
    """A numeric array of a file, and the part of it that a path selects; read only on demand."""

    array: Stored  # the stored array
    axes: tuple[int, ...]  # stored axes still open, in the user's order
    # Stored axis to the index taken along it.
    fixed: Mapping[int, int] = field(default_factory=dict)
    fs: float | None = None  # sampling frequency that the file gives for it [Hz], if any
    unit: str = ""  # unit that the file gives for it, if any
    minus: "Leaf | None" = None  # what to subtract from it, if it is a difference of two channels

    @property
    def shape(self) -> tuple[int, ...]:
        """Length of each open axis."""
        return tuple(self.array.shape[axis] for axis in self.axes)


@dataclass(frozen=True)
class Opaque:
    """Something that is no array of numbers."""

    kind: str  # what it is, for messages
    remedy: str = ""  # how to export it instead


@dataclass(frozen=True)
class Contents:
    """An open file."""

    root: "Node"  # its tree
    reader: str  # which reader opened it
    fs: float | None = None  # sampling frequency of the whole file [Hz], if it gives one
    # What the reader decided by itself, for the provenance.
    notes: Mapping[str, str] = field(default_factory=dict)


# A container of cells is a numpy array of objects, each a node.
Node = Mapping[str, Any] | NDArray[Any] | Leaf | Opaque
Opener = AbstractContextManager[Contents]


def leaf(array: Stored, *, fs: float | None = None, unit: str = "") -> Leaf:
    """Leaf of a whole array, its axes in stored order."""
    return Leaf(array, tuple(range(len(array.shape))), fs=fs, unit=unit)


def names(root: Node, prefix: str = "") -> Iterator[tuple[str, Leaf | Opaque]]:
    """Every path of the tree that ends in an array, and what is there."""
    if isinstance(root, Leaf | Opaque):
        yield prefix, root
    elif isinstance(root, Mapping):
        for name, node in root.items():
            yield from names(node, f"{prefix}.{name}" if prefix else name)
    else:
        for index in np.ndindex(root.shape):
            yield from names(root[index], prefix + "".join(f"[{i}]" for i in index))


def load(
    source: Leaf, start: int = 0, stop: int | None = None, dtype: DTypeLike | None = None
) -> NDArray[Any]:
    """Read a leaf, samples `start` to `stop` along its last open axis.

    Args:
        source: What to read; axes of length one are dropped.
        start: First sample.
        stop: One past the last sample; the end when None.
        dtype: Type to convert to while reading; as stored when None, or when complex.

    Returns:
        Array of one axis (time) or two (repeat, time).

    Raises:
        DataError: More than two axes, or too large for memory.
    """
    axes = [axis for axis in source.axes if source.array.shape[axis] != 1] or source.axes[-1:]
    index: list[int | slice] = [source.fixed.get(i, 0) for i in range(len(source.array.shape))]
    for axis in axes:
        index[axis] = slice(None)
    if axes:
        index[axes[-1]] = slice(start, stop)
    _fits(source, axes, start, stop)
    array: Any = source.array
    is_complex = np.issubdtype(array.dtype, np.complexfloating)
    if dtype is not None and not is_complex and not isinstance(array, np.ndarray):
        array = array.astype(dtype)  # h5py converts as it reads, without a second copy
    loaded = np.asarray(array[tuple(index)])
    loaded = np.atleast_1d(loaded.transpose(np.argsort(np.argsort(axes))))
    if source.minus is None:
        return loaded
    _subtractable(source, source.minus)
    # In float64, so that integers do not wrap around.
    subtracted = load(source.minus, start, stop)
    return np.subtract(loaded, subtracted, dtype=np.result_type(loaded, subtracted, np.float64))


def _subtractable(first: Leaf, second: Leaf) -> None:
    facts = [
        f"shape {leaf.shape}, unit `{leaf.unit}`, fs {leaf.fs or 'unstated'}"
        for leaf in (first, second)
    ]
    if facts[0] != facts[1]:
        raise DataError(
            f"Channels that are subtracted must agree, but one has {facts[0]}, "
            f"the other {facts[1]}.",
            remedy="Subtract channels that were sampled together, in one unit.",
        )


def _fits(source: Leaf, axes: Sequence[int], start: int, stop: int | None) -> None:
    lengths = [source.array.shape[axis] for axis in axes]
    if lengths:
        lengths[-1] = len(range(*slice(start, stop).indices(lengths[-1])))
    size = int(np.prod(lengths, dtype=np.float64)) * source.array.dtype.itemsize
    if size > MAX_BYTES:
        raise DataError(
            f"A channel of shape {source.shape} takes {size / 2**30:.1f} GiB, "
            f"but at most {MAX_BYTES / 2**30:.0f} GiB are read at once.",
            remedy="Read a part of it: span = [first second, last second].",
        )
