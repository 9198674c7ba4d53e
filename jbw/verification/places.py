"""The paths of tests in the tree of a result, and the names of their repeats."""

from collections.abc import Sequence

from jbw.measurement.records import Record


def place(group: str, name: str) -> str:
    """Return the path of a test in the tree."""
    return f"/{group}/{safe(name)}"


def safe(name: str) -> str:
    """Return a campaign's name as a safe name in the tree, where a slash would open another group.

    HDF5 reads a name of dots alone as this group or the one above.
    """
    name = name.replace("/", "\N{DIVISION SLASH}")
    return name if name.strip(".") else name.replace(".", "\N{ONE DOT LEADER}")


def repeats_named(records: Sequence[Record]) -> list[str]:
    """Return names of repeats: of their records if these differ, else their numbers from one."""
    names = [record.name for record in records]
    if all(names) and len(set(names)) == len(names):
        return names
    return [str(i + 1) for i in range(len(names))]
