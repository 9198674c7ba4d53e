"""Paths into a file's tree.

A path is `group.sub.name`, with `/` allowed for `.`. In brackets, one index an axis, from zero:
`[3]` takes an item and drops the axis, `[:]` keeps it, `[:, 1]` is short for `[:][1]`. A `[:]`
over cells or a struct array visits every item, and each gives one repeat. Axes of length one are
dropped in MATLAB files.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from typing import Any

from numpy.typing import NDArray

from jbw.errors import DataError
from jbw.measurement.files.tree import Leaf, Node, Opaque, names

Step = str | int | None  # a name, an index, or None for [:]


def select(root: Node, path: str) -> Leaf | list[Leaf]:
    """What a path points at: one array, or one an item where a `[:]` runs over cells.

    Args:
        root: The file's tree.
        path: Path to the channel.

    Raises:
        DataError: Nothing is there, or it is no array of numbers.
    """
    return _walk(root, _steps(root, path), path, root)


def closest(path: str, found: Sequence[str]) -> str:
    """The found name most like the one that was asked for, or nothing."""
    lowered = {name.lower(): name for name in found}
    nearest = get_close_matches(path.lower(), list(lowered), n=1, cutoff=0.4)
    return lowered[nearest[0]] if nearest else ""


def _steps(root: Node, path: str) -> list[Step]:
    """Path taken apart; a name that the file has as written is never split at its dots."""
    path = path.strip("/")
    whole = [str(name) for name in root] if isinstance(root, Mapping) else []
    fitting = (n for n in whole if path == n or path.startswith((f"{n}[", f"{n}.", f"{n}/")))
    first = max(fitting, key=len, default="")
    steps: list[Step] = [first] if first else []
    for part in re.split(r"[./](?![^\[]*\])", path[len(first) :]):
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
