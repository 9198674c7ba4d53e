"""The table of recorders: one file per recorder, found because it is in this folder.

A module of this folder that defines `RECORDER` or `RECORDERS` is in the table; nothing else needs
to be changed. Its docstring is its section in the documentation: a title, then lines such as
`Recognised by: ...`. The modules are loaded when the first file is opened.
"""

import pkgutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from importlib import import_module
from pathlib import Path

from jbw.measurement.files.tree import Contents, Leaf, Node
from jbw.measurement.recorders.recorder import Recorder
from jbw.units import titled

LOOKED_AT = 80  # number of lines of a text from which its recorder is recognised


@cache
def modules() -> tuple[str, ...]:
    """Return the dotted names of the recorder modules."""
    return tuple(
        f"{__name__}.{module.name}"
        for module in sorted(pkgutil.iter_modules(__path__), key=lambda module: module.name)
        if module.name != "recorder"
    )


@cache
def recorders() -> tuple[Recorder, ...]:
    """Return all recorders in the order of their modules; readers of a general format come last."""
    collected: list[Recorder] = []
    for name in modules():
        module = import_module(name)
        collected += getattr(module, "RECORDERS", None) or (module.RECORDER,)
    return tuple(sorted(collected, key=lambda recorder: recorder.is_general))


def of_lines(lines: Sequence[str], path: Path) -> Contents | None:
    """Read a text by the rules of its recorder; return None if no recorder recognises it."""
    head = lines[:LOOKED_AT]
    for recorder in recorders():
        if recorder.of_text and recorder.read_text and recorder.of_text(head):
            return replace(recorder.read_text(lines, path), recorder=recorder.name)
    return None


def annotated(contents: Contents) -> Contents:
    """Return an open file's contents; add what a recognised recorder states on its channels."""
    for recorder in recorders() if not contents.recorder else ():
        if recorder.read and recorder.recognises(contents):
            contents = replace(recorder.read(contents), recorder=recorder.name)
            break
    series = contents.series
    if series is not None:
        series = {path: _with_unit(item, path) for path, item in series.items()}
    return replace(contents, root=_with_units(contents.root), series=series)


def _with_units(node: Node, name: str = "") -> Node:
    """Return a tree in which arrays without a unit take the unit at the end of their name."""
    if isinstance(node, Mapping):
        return {key: _with_units(child, str(key)) for key, child in node.items()}
    return _with_unit(node, name) if isinstance(node, Leaf) else node


def _with_unit(item: Leaf, path: str) -> Leaf:
    unit = item.unit or titled(path)[1] or titled(item.label)[1]
    return replace(item, unit=unit) if unit != item.unit else item
