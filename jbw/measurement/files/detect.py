"""Which reader opens which file; what goes wrong while reading becomes one clear refusal.

A reader is a module with `contents(path)`, a context manager that gives the open file as a tree
(`jbw.measurement.files.tree`), and one line in `READERS`; npz.py is the shortest to copy. It may
raise anything, `ValueError` by preference, where the file is damaged.
"""

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

from jbw.errors import DataError, JbwError
from jbw.measurement.files.paths import closest
from jbw.measurement.files.tree import Contents

# Suffix to the module that reads it, imported when first needed.
READERS: dict[str, str] = {}
PICKLES = (".pkl", ".pickle", ".p", ".joblib", ".pt")
EMPTY = "The file is empty: copy or export it again."
AGAIN = "Copy the file again from where it was measured, or export it again."


def register(module: str, *suffixes: str) -> None:
    """Let a module read the files of some suffixes.

    Args:
        module: Its dotted name; it has `contents(path)`.
        *suffixes: Suffixes in lower case, such as ".npz".
    """
    READERS.update(dict.fromkeys(suffixes, module))


register("jbw.measurement.files.mat", ".mat")
register("jbw.measurement.files.hdf5", ".h5", ".hdf5", ".hdf", ".nc")
register("jbw.measurement.files.npz", ".npz", ".npy")
register("jbw.measurement.files.csv", ".csv", ".txt", ".tsv", ".dat", ".asc")
register("jbw.measurement.files.wav", ".wav")
register("jbw.measurement.files.uff", ".uff", ".unv")
register("jbw.measurement.files.tdms", ".tdms")


@contextmanager
def opened(path: Path) -> Iterator[Contents]:
    """Open a measurement file with the reader of its suffix.

    Raises:
        DataError: No such file, no reader for it, or a damaged file.
    """
    module = reader_of(path)
    try:
        with import_module(module).contents(path) as contents:
            yield contents
    except (JbwError, KeyboardInterrupt):
        raise
    except Exception as error:  # a damaged file may raise anything inside a reader
        reason = str(error).strip().splitlines()[0] if str(error).strip() else "no reason given"
        raise DataError(
            f"File `{path}` ({path.stat().st_size} bytes) cannot be read by the {_short(module)} "
            f"reader: {type(error).__name__}: {reason}",
            remedy=AGAIN,
        ) from error


def reader_of(path: Path) -> str:
    """Dotted name of the module that reads a file.

    Raises:
        DataError: No such file, an empty file, a pickle, or an unknown suffix.
    """
    if not path.is_file():
        raise _missing(path)
    suffix = path.suffix.lower()
    if suffix in PICKLES:
        raise DataError(
            f"File `{path.name}` is a pickle, which is never read.",
            why="Opening a pickle runs whatever program it carries.",
            remedy="Save the arrays with numpy.savez, or as HDF5.",
        )
    if suffix not in READERS:
        raise DataError(
            f"File `{path.name}` has the suffix `{suffix}`, for which there is no reader.",
            remedy=f"Readers: {', '.join(READERS)}.",
        )
    if path.stat().st_size == 0:
        raise DataError(
            f"File `{path}` (0 bytes) cannot be read by the {_short(READERS[suffix])} reader.",
            remedy=EMPTY,
        )
    return READERS[suffix]


def _short(module: str) -> str:
    return module.rpartition(".")[2]


def sha256(path: Path) -> str:
    """Hash of a file's bytes, in hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _missing(path: Path) -> DataError:
    folder = path.parent
    found = sorted(p.name for p in folder.iterdir() if p.is_file()) if folder.is_dir() else []
    nearest = closest(path.name, found)
    where = f"Found: {', '.join(found[:10])}." if found else f"The folder `{folder}` has no files."
    guess = f"Did you mean `{nearest}`? " if nearest else ""
    return DataError(f"File `{path}` does not exist.", remedy=guess + where)
