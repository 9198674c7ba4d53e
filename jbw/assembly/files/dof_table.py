"""Tables of degrees of freedom: the node and direction of every row of the matrices."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jbw.assembly.dofs import Dof, dof_of
from jbw.errors import DataError
from jbw.report.messages.matrices import ROWS_OF_DOFS

DOFS = "dofs"  # name of the table in files with several variables
_SEPARATORS = re.compile(r"[,;\s]+")


def read_table(path: Path) -> list[Dof]:
    """Read a text table with columns row, node, direction, or node, direction, and any header.

    Rows may be counted from 0 or from 1.

    Raises:
        DataError: A line has other columns, or rows are missing, repeated or out of range.
    """
    cells = []
    for line in path.read_text(encoding="utf-8-sig").splitlines():
        columns = [cell for cell in _SEPARATORS.split(line.strip().strip('"')) if cell]
        if columns and not line.lstrip().startswith("#"):
            cells.append([cell.strip("\"'") for cell in columns])
    if cells and not any(character.isdigit() for character in cells[0][0]):
        header, *cells = cells
        order = _order(header, path)
        cells = [[row[i] for i in order if i < len(row)] for row in cells]
    return rows_of_table(cells, path.name)


def _order(header: Sequence[str], path: Path) -> list[int]:
    """Return the positions of the columns row, node and direction in a table's header."""
    names = [name.lower() for name in header]
    columns = {"row": ("row", "index"), "node": ("node",), "direction": ("direction", "dof", "dir")}
    order = [
        next((i for i, name in enumerate(names) if name in spellings), -1)
        for spellings in columns.values()
    ]
    if -1 in order[1:]:
        raise DataError(
            f"{path.name} must have columns node and direction, but has {', '.join(header)}.",
            remedy=ROWS_OF_DOFS,
        )
    return [column for column in order if column >= 0]


def rows_of_table(table: Any, name: str = DOFS) -> list[Dof]:
    """Return the degrees of freedom that a table in memory states, in the order of its rows.

    Args:
        table: Texts "node:direction", or rows of [node, direction] or [row, node, direction].
        name: Name of the table in messages.

    Raises:
        DataError: As for `read_table`.
    """
    rows = [_cells_of(row, name) for row in table]
    if len({len(row) for row in rows}) > 1:
        shorter = next(i for i, row in enumerate(rows) if len(row) != len(rows[0]))
        raise DataError(
            f"Every line of {name} must have {len(rows[0])} columns, but line {shorter + 1} has "
            f"{len(rows[shorter])}.",
            remedy=ROWS_OF_DOFS,
        )
    if rows and len(rows[0]) == 3:
        rows = _in_order(rows, name)
    return [dof_of(node, direction) for node, direction in rows]


def _cells_of(row: Any, name: str) -> list[str]:
    if isinstance(row, str | np.str_):
        node, colon, direction = str(row).strip().rpartition(":")
        columns = [node, direction] if colon else []
    else:
        columns = [_plain(cell) for cell in np.ravel(np.asarray(row))]
    if len(columns) not in (2, 3):
        raise DataError(
            f"A line of {name} must be row, node and direction, but is {row!r}.",
            remedy=ROWS_OF_DOFS,
        )
    return columns


def _plain(cell: Any) -> str:
    """Return the text of a cell, with a whole number such as 17.0 written as 17."""
    text = str(cell).strip()
    return text.removesuffix(".0") if text.endswith(".0") else text


def _in_order(rows: list[list[str]], name: str) -> list[list[str]]:
    """Sort a table by its column of row numbers, and return it without this column."""
    try:
        numbers = [int(row[0]) for row in rows]
    except ValueError:
        raise DataError(
            f"The rows of {name} must be whole numbers, but one is not.", remedy=ROWS_OF_DOFS
        ) from None
    first = 0 if 0 in numbers else 1
    expected = range(first, first + len(rows))
    wrong = sorted(set(numbers) - set(expected)) or sorted(set(expected) - set(numbers))
    if wrong:
        out = wrong[0] in numbers
        raise DataError(
            f"The rows of {name} must be {first} to {first + len(rows) - 1}, each once, but row "
            f"{wrong[0]} is {'out of range' if out else 'missing'}.",
            remedy=ROWS_OF_DOFS,
        )
    return [row[1:] for _, row in sorted(zip(numbers, rows, strict=True))]
