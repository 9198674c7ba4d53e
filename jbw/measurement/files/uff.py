"""UFF 58 through pyuff, an optional extra: every set counted, its declared length compared."""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from jbw.errors import DataError
from jbw.measurement.files.tree import Contents, Node, Opaque, leaf

SET_58 = re.compile(rb"^ {4}-1 *\r?\n *58[ b]", re.MULTILINE)


@contextmanager
def contents(path: Path) -> Iterator[Contents]:
    """Open a universal file as `set[0]`, `set[1]`, ..., and by their names where unique."""
    declared = len(SET_58.findall(path.read_bytes()))
    sets = [found for found in _all_sets(path) if found.get("type") == 58]
    if not sets or len(sets) != declared:
        raise DataError(
            f"File `{path}` declares {declared} sets of type 58, but {len(sets)} can be read.",
            remedy="Export it again, as UFF 58 with time records.",
        )
    nodes = [_node(found, f"{path.name}, set[{i}]") for i, found in enumerate(sets)]
    cells = np.empty(len(nodes), dtype=object)
    for i, node in enumerate(nodes):
        cells[i] = node
    titles = [str(found.get("id1", "")).strip() for found in sets]
    root: dict[str, Node] = {"set": cells}
    root |= {
        title: node
        for title, node in zip(titles, nodes, strict=True)
        if title and titles.count(title) == 1
    }
    yield Contents(root, "UFF 58")


def _all_sets(path: Path) -> list[Mapping[str, Any]]:
    try:
        pyuff = import_module("pyuff")
    except ImportError:
        raise DataError(
            f"File `{path.name}` needs the package pyuff to be read.",
            remedy="Install it: pip install pyuff",
        ) from None
    found = pyuff.UFF(str(path)).read_sets()
    return found if isinstance(found, list) else [found]


def _node(found: Mapping[str, Any], where: str) -> Node:
    data = np.asarray(found["data"])
    if found.get("num_pts") not in (None, len(data)):
        raise DataError(
            f"{where} declares {found['num_pts']} samples, but has {len(data)}.",
            remedy="Copy the file again, or export it again.",
        )
    if np.iscomplexobj(data):
        return Opaque("complex", "Export time records, or amplitude and phase as CSV.")
    spacing = float(found.get("abscissa_inc") or 0.0)
    unit = str(found.get("ordinate_axis_units_lab", "")).strip()
    return leaf(
        data.astype(np.float64),
        fs=1 / spacing if spacing > 0 else None,
        unit="" if unit.upper() in ("NONE", "") else unit,
    )
