"""NumPy archives, read without pickle, so that object arrays are refused."""

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from jbw.measurement.files.tree import Contents, numeric
from jbw.memory import require_readable
from jbw.report.messages import reading as messages


@contextmanager
def contents(path: Path) -> Iterator[Contents]:
    """Open an .npz archive, or an .npy file as an array named `data`."""
    if path.suffix.lower() == ".npy":
        array = np.load(path, mmap_mode="r", allow_pickle=False)
        if (declared := array.offset + array.nbytes) != path.stat().st_size:
            raise ValueError(f"the file must have {declared} bytes for the shape {array.shape}")
        yield Contents({"data": numeric(array)}, "npy")
        return
    require_unpackable(path, messages.AS_HDF5)
    with np.load(path, allow_pickle=False) as archive:
        # A damaged array fails its checksum here, before any of its samples is used.
        yield Contents({name: numeric(archive[name]) for name in archive.files}, "npz")


def require_unpackable(path: Path, remedy: str) -> None:
    """Raise an error if an .npz archive would unpack to more than can be read at once."""
    with zipfile.ZipFile(path) as archive:
        size = sum(member.file_size for member in archive.infolist())
    require_readable(size, f"File `{path.name}` unpacks to", remedy)
