"""Tables of node positions, which are used only for drawings."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jbw.errors import DataError

NODES = "nodes"  # name of the table in files with several variables
Position = tuple[float, float, float]
_SEPARATORS = re.compile(r"[,;\s]+")


def read_nodes(path: Path) -> dict[str, Position]:
    """Read a text table with columns node, x, y, z; skip its header and comment lines.

    Raises:
        DataError: A line has other columns.
    """
    rows = []
    for line in path.read_text(encoding="utf-8-sig").splitlines():
        columns = [cell.strip("\"'") for cell in _SEPARATORS.split(line.strip()) if cell]
        if columns and columns[0].lower() != "node" and not columns[0].startswith("#"):
            rows.append(columns)
    return positions(rows, path.name)


def positions(table: Any, name: str = NODES) -> dict[str, Position]:
    """Return the position of every node, in the unit of length of the matrices.

    Args:
        table: Rows of [node, x, y, z].
        name: Name of the table in messages.

    Raises:
        DataError: A row has other columns, or a position is not a finite number.
    """
    if isinstance(table, Mapping):
        table = [(node, *position) for node, position in table.items()]
    found: dict[str, Position] = {}
    for row in table:
        node, *where = np.ravel(np.asarray(row)).tolist() if not isinstance(row, tuple) else row
        try:
            x, y, z = map(float, where)
        except (ValueError, TypeError):
            x = y = z = np.nan
        if len(where) != 3 or not np.isfinite([x, y, z]).all():
            raise DataError(
                f"A line of {name} must be node, x, y and z, but is {row!r}.",
                remedy="Write a line `node,x,y,z` for each node, such as `17,0.1,0.0,0.25`.",
            )
        found[str(node).strip().removesuffix(".0")] = (x, y, z)
    return found
