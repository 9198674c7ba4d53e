"""What a file holds, whatever its format: a tree of names, cells and arrays, and paths into it.

A path is `group.sub.name`, with `/` allowed for `.`. In brackets, one index an axis, from zero:
`[3]` takes an item and drops the axis, `[:]` keeps it, `[:, 1]` is short for `[:][1]`. A `[:]`
over cells or a struct array visits every item, and each gives one repeat. Axes of length one are
dropped in MATLAB files.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

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
    """A numeric array of a file, and the part of it that a path selects; read only on demand.

    Attributes:
        array: The stored array.
        axes: Stored axes still open, in the user's order.
        fixed: Stored axis to the index taken along it.
        fs: Sampling frequency that the file gives for it [Hz], if any.
        unit: Unit that the file gives for it, if any.
    """

    array: Stored
    axes: tuple[int, ...]
    fixed: Mapping[int, int] = field(default_factory=dict)
    fs: float | None = None
    unit: str = ""

    @property
    def shape(self) -> tuple[int, ...]:
        """Length of each open axis."""
        return tuple(self.array.shape[axis] for axis in self.axes)


@dataclass(frozen=True)
class Opaque:
    """Something that is no array of numbers.

    Attributes:
        kind: What it is, for messages.
        remedy: How to export it instead.
    """

    kind: str
    remedy: str = ""


@dataclass(frozen=True)
class Contents:
    """An open file.

    Attributes:
        root: Its tree.
        reader: Which reader opened it.
        fs: Sampling frequency of the whole file [Hz], if it gives one.
        notes: What the reader decided by itself, for the provenance.
    """

    root: "Node"
    reader: str
    fs: float | None = None
    notes: Mapping[str, str] = field(default_factory=dict)


# A container of cells is a numpy array of objects, each a node.
Node = Mapping[str, Any] | NDArray[Any] | Leaf | Opaque
Opener = AbstractContextManager[Contents]
Step = str | int | None  # a name, an index, or None for [:]


def leaf(array: Stored, *, fs: float | None = None, unit: str = "") -> Leaf:
    """Leaf of a whole array, its axes in stored order."""
    return Leaf(array, tuple(range(len(array.shape))), fs=fs, unit=unit)


def select(root: Node, path: str) -> Leaf | list[Leaf]:
    """What a path points at: one array, or one an item where a `[:]` runs over cells.

    Args:
        root: The file's tree.
        path: Path to the channel.

    Raises:
        DataError: Nothing is there, or it is no array of numbers.
    """
    return _walk(root, _steps(root, path), path, root)


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


def load(source: Leaf, start: int = 0, stop: int | None = None) -> NDArray[Any]:
    """Read a leaf, samples `start` to `stop` along its last open axis.

    Args:
        source: What to read; axes of length one are dropped.
        start: First sample.
        stop: One past the last sample; the end when None.

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
    loaded = np.asarray(source.array[tuple(index)])
    return np.atleast_1d(loaded.transpose(np.argsort(np.argsort(axes))))


def closest(path: str, found: Sequence[str]) -> str:
    """The found name most like the one that was asked for, or nothing."""
    lowered = {name.lower(): name for name in found}
    nearest = get_close_matches(path.lower(), list(lowered), n=1, cutoff=0.4)
    return lowered[nearest[0]] if nearest else ""


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


def _steps(root: Node, path: str) -> list[Step]:
    """Path taken apart; a name that the file has as written is never split at its dots."""
    head = path if isinstance(root, Mapping) and path in root else path.split("[")[0]
    if isinstance(root, Mapping) and head in root:
        return [head, *_indices(path[len(head) :], path)]
    steps: list[Step] = []
    for part in re.split(r"[./](?![^\[]*\])", path.strip("./")):
        name, bracket, rest = part.partition("[")
        steps += [name] if name else []
        steps += _indices(bracket + rest, path)
    return steps


def _indices(brackets: str, path: str) -> list[Step]:
    """The indices of `[3][:]` or `[:, 1]`."""
    if not re.fullmatch(r"(\[\s*(:|-?\d+)(\s*,\s*(:|-?\d+))*\s*\])*", brackets):
        raise DataError(
            f"Path `{path}` has indices `{brackets}` that cannot be read.",
            remedy="Write [3] for an item, counted from zero, and [:] for all.",
        )
    return [None if step == ":" else int(step) for step in re.findall(r":|-?\d+", brackets)]


def _walk(node: Node, steps: list[Step], path: str, root: Node) -> Leaf | list[Leaf]:
    if isinstance(node, Opaque):
        raise DataError(f"`{path}` is {node.kind}, not an array of numbers.", remedy=node.remedy)
    if isinstance(node, Leaf):
        return _pick(node, steps, path, root)
    if not steps:
        raise _absent(path, root, "is a group, not an array")
    step, *rest = steps
    if isinstance(node, Mapping):
        if isinstance(step, str) and step in node:
            return _walk(node[step], rest, path, root)
        if step in (0, None):  # a struct array of one is a struct
            return _walk(node, rest, path, root)
        raise _absent(path, root)
    if isinstance(step, str):
        raise _absent(path, root, f"has {node.shape} items before `{step}`: index them")
    if step is None:
        return _spread(node, rest, path, root)
    if not -len(node) <= step < len(node):
        raise _absent(path, root, f"has index {step}, but there are {len(node)} items")
    return _walk(node[step], rest, path, root)


def _spread(cells: NDArray[Any], steps: list[Step], path: str, root: Node) -> list[Leaf]:
    """Every item along the first axis of the cells, in order."""
    found = [_walk(cells[i], steps, path, root) for i in range(len(cells))]
    if any(isinstance(item, list) for item in found):
        raise DataError(f"Path `{path}` runs over cells twice.", remedy="Keep one [:] over cells.")
    return [item for item in found if isinstance(item, Leaf)]


def _pick(node: Leaf, steps: list[Step], path: str, root: Node) -> Leaf:
    """Apply indices to the open axes of an array, in the user's order."""
    position = 0
    for step in steps:
        if isinstance(step, str) or position >= len(node.axes):
            raise _absent(path, root, f"goes on after an array of shape {node.array.shape}")
        if step is None:
            position += 1
            continue
        axis = node.axes[position]
        if not -node.array.shape[axis] <= step < node.array.shape[axis]:
            raise _absent(path, root, f"has index {step} on an axis of {node.array.shape[axis]}")
        axes = node.axes[:position] + node.axes[position + 1 :]
        taken = step % node.array.shape[axis]
        node = replace(node, axes=axes, fixed={**node.fixed, axis: taken})
    return node


def _absent(path: str, root: Node, because: str = "is not in the file") -> DataError:
    """The refusal that lists what was found, with the closest match."""
    found = [name for name, item in names(root) if isinstance(item, Leaf)]
    nearest = closest(path, found)
    listed = ", ".join(found[:20]) + (f" and {len(found) - 20} more" if len(found) > 20 else "")
    return DataError(
        f"Channel `{path}` {because}.",
        remedy=(f"Did you mean `{nearest}`? " if nearest else "")
        + f"Found: {listed or 'nothing'}.",
    )
