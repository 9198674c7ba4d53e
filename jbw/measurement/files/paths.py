"""Paths that select an array in the tree of a file.

A path is `group.sub.name`, with `/` allowed for `.`. Brackets contain one index per axis, counted
from zero as in Python: `[3]` takes the fourth item and drops the axis, `[:]` keeps it, `[:, 1]` is
short for `[:][1]`. Parentheses and braces count from one, as in MATLAB, so that a MATLAB path can
be copied: `FR.Level(4).force` is `FR.Level[3].force`, and `xData{:, 2}` is `xData[:, 1]`. A `[:]`
over cells or a struct array visits every item, and each item gives one repeat. In MATLAB files,
axes of length one are dropped. `a - b`, with spaces around the sign, is the difference of two
channels.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from numpy.typing import NDArray

from jbw.errors import DataError, did_you_mean
from jbw.measurement.files.tree import Leaf, Node, Opaque, names
from jbw.report.messages.message import first_of
from jbw.units import titled

INDICES = re.compile(r"\s*(:|-?\d+)(\s*,\s*(:|-?\d+))*\s*")
CLOSING = {"[": "]", "(": ")", "{": "}"}
MINUS = " - "


def select(root: Node, path: str) -> Leaf | list[Leaf]:
    """Return the array at a path, or a list of arrays if `[:]` visits several cells."""
    if MINUS not in path or (isinstance(root, Mapping) and path in root):
        return _follow(root, path)
    picked = [_follow(root, part.strip()) for part in path.split(MINUS, 1)]
    minuends, subtrahends = (item if isinstance(item, list) else [item] for item in picked)
    if len(minuends) != len(subtrahends):
        raise DataError(
            f"`{path}` must subtract as many channels as stand before the minus sign, but "
            f"subtracts {len(subtrahends)} from {len(minuends)}."
        )
    differences = [replace(x, minus=y) for x, y in zip(minuends, subtrahends, strict=True)]
    return differences if isinstance(picked[0], list) else differences[0]


def _follow(root: Node, path: str) -> Leaf | list[Leaf]:
    """Return the array at one path; an error lists similar and available channels."""
    path = path.strip("/")
    try:
        return _walk(root, [], path)
    except DataError as error:
        name, unit = titled(path)
        # Here the path is a title followed by the title's unit.
        if unit and isinstance(root, Mapping) and name in root:
            return _walk(root[name], [], "")
        channels = [name for name, item in names(root) if isinstance(item, Leaf)]
        listed = f"Found: {first_of(channels, 20) or 'nothing'}."
        remedy = error.remedy or did_you_mean(path, channels) + listed
        raise DataError(f"Channel `{path}` {error.what}", why=error.why, remedy=remedy) from None


def _walk(node: Node, indices: Sequence[int | None], rest: str) -> Leaf | list[Leaf]:
    """Apply indices to a group, list or array, then follow the rest of the path."""
    if isinstance(node, Opaque):
        raise DataError(f"is {node.kind}, not an array of numbers.", remedy=node.remedy)
    while rest and rest[0] in CLOSING and (isinstance(node, Leaf) or not indices):
        more, rest = _indices(rest)
        indices = [*indices, *more]
    if isinstance(node, Leaf):
        if rest:
            raise DataError(
                f"continues after an array of shape {node.array.shape}: end the path at the array."
            )
        return _pick(node, indices)
    if indices:
        return _item(node, indices, rest)
    if not isinstance(node, Mapping):
        count = " x ".join(map(str, node.shape))
        raise DataError(
            f"has {count} items before `{rest}`: select one item by an index."
            if rest
            else f"has {count} items, not an array."
        )
    if not rest:
        raise DataError("is a group, not an array.")
    rest = rest.lstrip("./")
    # A name is matched exactly as in the file; dots and brackets in a name do not split it.
    fitting = (n for n in map(str, node) if rest.startswith(n) and rest[len(n) :][:1] in "./[({")
    name = max(fitting, key=len, default="")
    if not name:
        raise DataError("is not in the file.")
    return _walk(node[name], [], rest[len(name) :])


def _indices(rest: str) -> tuple[list[int | None], str]:
    """Parse the brackets at the start of `rest`; return indices counted from zero, and the rest."""
    inside, closed, after = rest[1:].partition(CLOSING[rest[0]])
    if not (closed and INDICES.fullmatch(inside)):
        raise DataError(
            f"has indices `{rest}` that cannot be read.",
            remedy="Write [3] for an item, counted from zero, or (4), counted from one as in "
            "MATLAB; [:] selects all items.",
        )
    first = 0 if rest[0] == "[" else 1
    numbers = [None if text == ":" else int(text) for text in re.findall(r":|-?\d+", inside)]
    if first and any(i is not None and i < first for i in numbers):
        raise DataError(
            f"has an index below 1 in `{rest[0]}{inside}{closed}`.",
            why="Parentheses and braces count from one, as in MATLAB; brackets from zero.",
            remedy="Write (1) or [0] for the first item.",
        )
    return [None if i is None else i - first for i in numbers], after


def _item(
    node: Mapping[str, Any] | NDArray[Any], indices: Sequence[int | None], rest: str
) -> Leaf | list[Leaf]:
    """Apply the first index to a struct or to cells; `[:]` visits all cells in order."""
    step, *others = indices
    if isinstance(node, Mapping):
        if step in (0, None):  # A struct array of length one is treated as a struct.
            return _walk(node, others, rest)
        raise DataError(f"selects item [{step}], counted from zero, but there is only one item.")
    if step is not None:
        _require_within(step, len(node), f"but there are {len(node)} items")
        return _walk(node[step], others, rest)
    picked = [_walk(item, others, rest) for item in node]
    if any(isinstance(item, list) for item in picked):
        raise DataError("runs over cells twice.", remedy="Keep one [:] over cells.")
    return [item for item in picked if isinstance(item, Leaf)]


def _require_within(step: int, length: int, but_words: str) -> None:
    if not -length <= step < length:
        raise DataError(f"selects item [{step}], counted from zero, {but_words}.")


def _pick(node: Leaf, steps: Sequence[int | None]) -> Leaf:
    """Apply indices, in the given order, to the axes of an array that have no index yet."""
    if len(steps) > len(node.axes):
        raise DataError(f"has too many indices for an array of shape {node.array.shape}.")
    fixed = {}
    for axis, step in zip(node.axes, steps, strict=False):
        if step is not None:
            length = node.array.shape[axis]
            _require_within(step, length, f"on an axis of {length}")
            fixed[axis] = step % length
    axes = tuple(axis for axis in node.axes if axis not in fixed)
    return replace(node, axes=axes, fixed={**node.fixed, **fixed})
