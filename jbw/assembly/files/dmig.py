"""Nastran's direct matrix input, DMIG, in a punch file with fields of 8 or 16 characters.

Reference:
    MSC Nastran Quick Reference Guide, bulk data entry DMIG.
"""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from jbw.assembly.dofs import Dof, dof_of
from jbw.assembly.files.contents import MatrixFile, of_labels
from jbw.errors import DataError

_SHORT_EXPONENT = re.compile(r"(?<=[\d.])([+-]\d+)$")  # Nastran writes 1.5e+3 as 1.5+3.
_COMPLEX = ("3", "4")  # codes of complex types of entries


def contents(path: Path) -> MatrixFile:
    """Return the matrices of all DMIG entries of a file, by name.

    Raises:
        DataError: There is no entry, or a matrix is complex or cannot be read.
    """
    entries: dict[str, list[tuple[Dof, Dof, float]]] = {}
    for name, *fields in _entries(path):
        if name not in entries:
            entries[name] = []
        # This line is the header: form, type of the entries, type of the output.
        if fields[0] == "0":
            if len(fields) > 2 and fields[2] in _COMPLEX:
                raise DataError(
                    f"Matrix {name} of {path.name} must be real, but is complex.",
                    remedy=f"Export matrix {name} without structural damping.",
                )
            continue
        try:
            column = dof_of(fields[0], fields[1])
            rest = fields[2:]
            for i in range(0, len(rest) - 2, 4):
                if rest[i]:
                    row = dof_of(rest[i], rest[i + 1] or "0")
                    entries[name].append((row, column, _number(rest[i + 2])))
        except (ValueError, IndexError):
            raise DataError(
                f"An entry of DMIG {name} in {path.name} must consist of numbers, but is {fields}.",
                remedy="Export the punch file again.",
            ) from None
    if not entries:
        raise DataError(
            f"{path.name} must contain DMIG entries, but contains none.",
            remedy="Export with PARAM,EXTOUT,DMIGPCH.",
        )
    matrices, dofs = {}, {}
    for name, triples in entries.items():
        rows, columns, values = zip(*triples, strict=True) if triples else ((), (), ())
        matrices[name], dofs[name] = of_labels(rows, columns, np.array(values, float))
    return MatrixFile(matrices, dofs)


def _entries(path: Path) -> Iterator[list[str]]:
    """Yield each DMIG entry: name, column (grid, component), rows (grid, component, two numbers).

    A header entry is name, "0", form, types.
    """
    fields: list[str] = []
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        text = line.expandtabs(8)
        if not text.strip() or text.lstrip()[0] == "$":
            continue
        if text.upper().startswith("DMIG"):
            if fields:
                yield _joined(fields)
            fields = _fields(text)
        elif fields and text[0] in "*+ ,":
            fields += _fields(text)
        elif fields:
            yield _joined(fields)
            fields = []
    if fields:
        yield _joined(fields)


def _joined(fields: list[str]) -> list[str]:
    """Return the fields of an entry; omit the empty field after the component of a column."""
    name, grid, component, *rest = [*fields, "", "", ""]
    if grid in ("", "0"):
        return [name, "0", component, *rest]
    return [name, grid, component, *rest[1:]]


def _fields(text: str) -> list[str]:
    """Split a line after its first field: four fields of 16, eight of 8 characters, or commas."""
    if "," in text:
        cells = [cell.strip() for cell in text.split(",")][1:9]
        return cells + [""] * (8 - len(cells))
    width, count = (16, 4) if "*" in text[:8] else (8, 8)
    body = text[8:].ljust(width * count)
    return [body[i * width : (i + 1) * width].strip() for i in range(count)]


def _number(text: str) -> float:
    """Return a number from Nastran's notation, such as 1.5+3 for 1.5e+3."""
    plain = text.upper().replace("D", "E")
    return float(plain if "E" in plain else _SHORT_EXPONENT.sub(r"E\1", plain))
