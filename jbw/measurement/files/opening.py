"""Which reader opens which file; what goes wrong while reading becomes one clear refusal."""

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

from jbw.errors import DataError, JbwError
from jbw.measurement.files.paths import closest
from jbw.measurement.files.tree import Contents

# Suffix to reader module, imported when first needed; each has `contents(path)`.
READERS = {
    ".mat": "mat",
    ".h5": "hdf5",
    ".hdf5": "hdf5",
    ".hdf": "hdf5",
    ".nc": "hdf5",
    ".npz": "npz",
    ".npy": "npz",
    ".csv": "csv",
    ".txt": "csv",
    ".tsv": "csv",
    ".dat": "csv",
    ".asc": "csv",
    ".wav": "wav",
    ".uff": "uff",
    ".unv": "uff",
    ".tdms": "tdms",
}
PICKLES = (".pkl", ".pickle", ".p", ".joblib", ".pt")
EMPTY = "The file is empty: copy or export it again."
AGAIN = "Copy the file again from where it was measured, or export it again."


@contextmanager
def opened(path: Path) -> Iterator[Contents]:
    """Open a measurement file with the reader of its suffix.

    Raises:
        DataError: No such file, no reader for it, or a damaged file.
    """
    reader = reader_of(path)
    try:
        with import_module(f"jbw.measurement.files.{reader}").contents(path) as contents:
            yield contents
    except (JbwError, KeyboardInterrupt):
        raise
    except Exception as error:  # a damaged file may raise anything inside a reader
        reason = str(error).strip().splitlines()[0] if str(error).strip() else "no reason given"
        raise DataError(
            f"File `{path}` ({path.stat().st_size} bytes) cannot be read by the {reader} reader: "
            f"{type(error).__name__}: {reason}",
            remedy=AGAIN,
        ) from error


def reader_of(path: Path) -> str:
    """Name of the reader module of a file.

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
            f"File `{path}` (0 bytes) cannot be read by the {READERS[suffix]} reader.",
            remedy=EMPTY,
        )
    return READERS[suffix]


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
