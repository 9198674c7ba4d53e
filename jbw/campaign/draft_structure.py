"""The draft of the tables [structure] and [[joint]] from matrices next to the records."""

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from jbw.assembly.files.read import READERS, read_matrices, role_of
from jbw.campaign.document import toml
from jbw.errors import JbwError
from jbw.measurement.files.read import opened
from jbw.measurement.files.tree import names
from jbw.report.messages import draft as messages

# suffixes of files that contain all matrices and nothing else
HELD_TOGETHER = (".pch", ".dmig", ".op4")
HELD_WITH_NAMES = (".mat", ".npz")  # suffixes of files that contain either all matrices or records
TEXTS = (".csv", ".txt", ".dat")
# column names in tables of degrees of freedom and of nodes; a table has one of these sets
TABLES = {"dofs": ({"node"}, {"direction", "dof", "dir"}), "nodes": ({"node"}, {"x"}, {"y"}, {"z"})}
BEGINNING = 256  # number of characters at a text's start that contain its header


MatrixFiles = str | dict[str, str]  # a file or several files, in the form that [structure] uses


def model_files(files: Sequence[Path]) -> tuple[MatrixFiles, Sequence[Path]] | None:
    """Return the files of a model, with mass and stiffness in one file or two; empty if none.

    Matrices in separate files are recognised by the names of the files, and the tables of degrees
    of freedom and of nodes next to them by their columns.
    """
    if (whole := next(filter(_holds_model, files), None)) is not None:
        return whole.name, (whole,)
    parts = {role: path for path in files if (role := _role_of_file(path))}
    if not {"mass", "stiffness"} <= set(parts):
        return None
    return {role: path.name for role, path in parts.items()}, tuple(parts.values())


def structure_lines(stated: MatrixFiles, folder: Path) -> Iterator[str]:
    """Yield the tables [structure] and [[joint]] as comments; the user adds where joints act."""
    source: str | Path | Mapping[str, Path]
    if isinstance(stated, str):
        source = folder / stated
    else:
        source = {role: folder / name for role, name in stated.items()}
    places: list[str] = []
    with suppress(JbwError):  # `jbw check` reports the cause.
        places = [str(dof) for dof in read_matrices(source, units="SI").dofs]
    first = places[0] if places else messages.EXAMPLE_PLACES[0]
    others = (place for place in reversed(places) if place.endswith(first[first.index(":") :]))
    last = next(others, messages.EXAMPLE_PLACES[1])
    written = toml(first), toml({"tip": last}), toml([first, last])
    for line in messages.structure(toml(stated), places, written).splitlines():
        yield f"# {line}"


def _holds_model(path: Path) -> bool:
    """Return whether the names of a file's arrays include those of mass and stiffness."""
    suffix = path.suffix.lower()
    if suffix in HELD_TOGETHER:
        return True
    if suffix in HELD_WITH_NAMES:
        with suppress(JbwError), opened(path) as contents:
            return {"mass", "stiffness"} <= {role_of(name) for name, _ in names(contents.root)}
    return False


def _role_of_file(path: Path) -> str:
    """Return which matrix or table a file contains, from its name (`K.mtx`) or its columns."""
    suffix = path.suffix.lower()
    if suffix in READERS and suffix not in HELD_TOGETHER:
        words = (word.rstrip("0123456789") for word in re.split(r"[\W_]+", path.stem))
        return next((role for word in words if (role := role_of(word))), "")
    if suffix not in TEXTS:
        return ""
    with suppress(OSError), path.open(encoding="utf-8-sig", errors="replace") as text:
        header = set(re.split(r"[^a-z]+", text.read(BEGINNING).lower().partition("\n")[0]))
        return next((t for t, columns in TABLES.items() if all(header & c for c in columns)), "")
    return ""
