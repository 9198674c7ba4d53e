"""NumPy archives, without pickle: an object array is refused."""

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from jbw.errors import DataError
from jbw.measurement.files.tree import MAX_BYTES, Contents, numeric
from jbw.report.messages import reading as messages


@contextmanager
def contents(path: Path) -> Iterator[Contents]:
    """Open an .npz archive, or an .npy array under the name `data`."""
    if path.suffix.lower() == ".npy":
        array = np.load(path, mmap_mode="r", allow_pickle=False)
        if (declared := array.offset + array.nbytes) != path.stat().st_size:
            raise ValueError(f"the shape {array.shape} takes {declared} bytes")
        yield Contents({"data": numeric(array)}, "npy")
        return
    require_unpackable(path, messages.AS_HDF5)
    with np.load(path, allow_pickle=False) as archive:
        # A damaged member fails its CRC here, before any of its samples is used.
        yield Contents({name: numeric(archive[name]) for name in archive.files}, "npz")


def require_unpackable(path: Path, remedy: str) -> None:
    """Refuse an .npz archive that unpacks to more than is read at once, before it is unpacked."""
    with zipfile.ZipFile(path) as archive:
        size = sum(member.file_size for member in archive.infolist())
    if size > MAX_BYTES:
        raise DataError(
            f"File `{path.name}` unpacks to {size / 2**30:.1f} GiB, "
            f"but at most {MAX_BYTES / 2**30:.0f} GiB are read at once.",
            remedy=remedy,
        )
