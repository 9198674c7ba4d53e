"""The paths of tests in a result tree, and the names of their repeats."""

from collections.abc import Sequence

from jbw.measurement.records import Record


def place(group: str, name: str) -> str:
    """Return the path of a test in the result tree."""
    return f"/{group}/{safe(name)}"


def safe(name: str) -> str:
    """Return a name with characters replaced that are invalid in the paths of a result tree.

    HDF5 reads a name that consists of dots as this group or its parent.
    """
    name = name.replace("/", "\N{DIVISION SLASH}")
    return name if name.strip(".") else name.replace(".", "\N{ONE DOT LEADER}")


def repeats_named(records: Sequence[Record]) -> list[str]:
    """Return names of repeats: the names of the records if all differ, else numbers from one."""
    names = [record.name for record in records]
    if all(names) and len(set(names)) == len(names):
        return names
    return [str(i + 1) for i in range(len(names))]
