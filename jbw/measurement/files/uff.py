"""UFF 58 through pyuff, an optional extra: every set counted, its declared length compared."""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from jbw.errors import DataError
from jbw.measurement.files.sampling import sampling_frequency
from jbw.measurement.files.tree import Contents, Node, cells, leaf, optional

FREQUENCY_RESPONSE = 4  # function type of the format
SET_58 = re.compile(rb"^ {4}-1 *\r?\n *58[ b]", re.MULTILINE)


@contextmanager
def contents(path: Path) -> Iterator[Contents]:
    """Open a universal file as `set[0]`, `set[1]`, ..., and by their names where unique."""
    declared = len(SET_58.findall(path.read_bytes()))
    found = optional("pyuff", "uff", path).UFF(str(path)).read_sets()
    every = found if isinstance(found, list) else [found]
    sets = [one for one in every if one.get("type") == 58]
    if not sets or len(sets) != declared:
        raise DataError(
            f"File `{path}` declares {declared} sets of type 58, but {len(sets)} can be read.",
            remedy="Export it again, as UFF 58 with time records.",
        )
    nodes = [_node(one, f"{path.name}, set[{i}]") for i, one in enumerate(sets)]
    titles = [str(one.get("id1", "")).strip() for one in sets]
    root: dict[str, Node] = {"set": cells(nodes, (len(nodes),))}
    root |= {
        title: node
        for title, node in zip(titles, nodes, strict=True)
        if title and titles.count(title) == 1
    }
    yield Contents(root, "UFF 58")


def _node(found: Mapping[str, Any], where: str) -> Node:
    data = np.asarray(found["data"])
    if found.get("num_pts") not in (None, len(data)):
        raise DataError(
            f"{where} declares {found['num_pts']} samples, but has {len(data)}.",
            remedy="Copy the file again, or export it again.",
        )
    unit = str(found.get("ordinate_axis_units_lab", "")).strip()
    unit = "" if unit.upper() == "NONE" else unit
    if found.get("func_type") == FREQUENCY_RESPONSE:
        return {
            "frequency": leaf(np.asarray(found["x"]), unit="Hz"),
            "response": leaf(data, unit=unit),
        }
    spacing, fs = float(found.get("abscissa_inc") or 0.0), None
    if spacing > 0:
        fs = 1 / spacing
    elif len(found["x"]) > 1:  # uneven
        fs, _ = sampling_frequency(np.asarray(found["x"]), f"{where}, abscissa")
    return leaf(data, fs=fs, unit=unit)
