"""Lazy reading of HDF5 files, which follows no links to other files; writing with checksums."""

import mmap
import os
import struct
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import DTypeLike

from jbw.errors import DataError
from jbw.measurement.files.tree import RATE, Contents, Node, Opaque, leaf
from jbw.measurement.records import Record
from jbw.report.messages import reading as messages

HEAP = b"GCOL\x01\0\0\0"  # signature, version, three reserved bytes; the heap's size follows
HEAD = 16  # length in bytes of the header of a heap, and of an object in it
UNITS = ("unit", "units", "unit_str")  # attributes that contain a channel's unit
LABELS = ("long_name", "label", "name")  # attributes that describe a channel
# largest number of texts read per attribute, and of attributes per dataset
MOST_TEXTS, MOST_FACTS = 256, 64
LEAST_HEAP = 4096  # bytes of the smallest heap
REACH = 2**26  # number of bytes searched at either end of a file; between them there are samples


@contextmanager
def contents(path: Path) -> Iterator[Contents]:
    """Open an HDF5 file as a tree of groups; datasets are read only when they are used."""
    with path.open("rb") as stream:
        is_classic = stream.read(3) == b"CDF"
    if is_classic:
        raise DataError(
            f"File `{path.name}` is NetCDF 3, which is not HDF5.",
            remedy=f"Convert the file: nccopy -k netCDF-4 {path.name} {path.stem}_4.nc",
        )
    require_sound_heaps(path)
    with h5py.File(path, "r") as file:
        if {"NASTRAN", "INDEX"} <= set(file):
            raise DataError(
                f"File `{path.name}` contains a Nastran model and its results, but no record.",
                remedy="Export measured time records or FRFs as UFF 58 or CSV.",
            )
        yield Contents(
            group_tree(file, _node), "HDF5", fs=fs_of(file.attrs), attributes=facts_of(file.attrs)
        )


def write_hdf5(
    path: str | Path,
    record: Record,
    *,
    names: Mapping[str, str] | None = None,
    dtype: DTypeLike = np.float64,
) -> None:
    """Write a record completely or not at all, with one checksummed dataset per channel."""
    path = Path(path)
    partial = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with h5py.File(partial, "w") as file:
            file.attrs["fs"] = record.fs
            file.attrs["name"] = record.name
            for role, samples in record.channels.items():
                name = (names or {}).get(role, role)
                data = np.asarray(samples, dtype=dtype)
                dataset = file.create_dataset(name, data=data, fletcher32=True, shuffle=True)
                dataset.attrs.update(unit=record.units[role], fs=record.fs, role=role)
        with partial.open("rb+") as stream:
            os.fsync(stream.fileno())
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def group_tree(group: h5py.Group, node: Callable[[h5py.Group, str], Node]) -> dict[str, Node]:
    """Return a group's entries by name, each converted by `node`."""
    return {name: node(group, name) for name in map(str, group) if not name.startswith("#")}


def fs_of(attributes: Mapping[str, Any]) -> float | None:
    """Return the sampling frequency [Hz] from attributes: `fs`, `dt` [s], or another rate name."""
    others = [name for name in attributes if RATE.search(str(name)) and name != "fs"]
    named = (("fs", lambda fs: fs), ("dt", lambda dt: 1 / dt))
    for name, to_fs in (*named, *((name, lambda fs: fs) for name in others)):
        stated = attribute(attributes, name)
        if isinstance(stated, str | bytes) or np.size(stated) != 1:
            continue
        value = float(np.ravel(stated)[0])
        return to_fs(value) if value > 0 else None
    return None


def attribute(attributes: Mapping[str, Any], name: str) -> Any:
    """Return an attribute that is a text or number; an empty text for all other attributes."""
    # Attributes of other types are never read, because a changed byte in their type can crash the
    # process.
    if name not in attributes:
        return ""
    if isinstance(attributes, h5py.AttributeManager):
        kind = attributes.get_id(name).get_type()
        if not isinstance(kind, h5py.h5t.TypeStringID | h5py.h5t.TypeAtomicID):
            return ""
    return attributes[name]


def inside(dataset: h5py.Dataset) -> h5py.Dataset:
    """Return the dataset if its samples are in its own file and complete; else raise an error."""
    virtual = dataset.is_virtual and any(s.file_name != "." for s in dataset.virtual_sources())
    if dataset.external or virtual:
        raise _outside(dataset.name or "dataset")
    if dataset.chunks is None:
        stored = dataset.id.get_storage_size()
        # A dataset that was never written has no bytes in the file.
        is_complete = stored in (0, dataset.nbytes)
    else:
        most = dataset.maxshape or dataset.shape
        sizes = zip(dataset.chunks, dataset.shape, most, strict=True)
        is_complete = not any(end is not None and chunk > n for chunk, n, end in sizes)
    if not is_complete:
        raise DataError(
            f"`{dataset.name}` declares the shape {dataset.shape}, but stores another shape.",
            why="The header may be damaged; if the file were read, samples would be lost.",
            remedy="Copy the file again, or export the file again.",
        )
    return dataset


def text_of(attributes: Mapping[str, Any], name: str) -> str:
    """Return an attribute as text."""
    value = attribute(attributes, name)
    if isinstance(value, np.ndarray) and value.size <= MOST_TEXTS:
        return _joined(value)
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _node(group: h5py.Group, name: str) -> Node:
    """Return the group or array with a given name; follow only links that stay in the file."""
    link = group.get(name, getlink=True)
    if isinstance(link, h5py.ExternalLink):
        raise _outside(f"{group.name}/{name}")
    if isinstance(link, h5py.SoftLink):
        return _behind(group, name, link.path)
    item = group[name]
    if isinstance(item, h5py.Group):
        return group_tree(item, _node)
    return _array(item)


def _array(item: Any) -> Node:
    if not isinstance(item, h5py.Dataset) or not np.issubdtype(item.dtype, np.number):
        return Opaque("not numeric", messages.STORE_NUMBERS,
                      _texts(item))  # fmt: skip
    unit = next(filter(None, (text_of(item.attrs, key) for key in UNITS)), "")
    label = next(filter(None, (text_of(item.attrs, key) for key in LABELS)), "")
    # If a unit has one line per channel, the recorder modules interpret it.
    unit = "" if item.ndim > 1 and "\n" in unit else unit
    samples = leaf(inside(item), fs=fs_of(item.attrs), unit=unit.partition(" since ")[0])
    return replace(samples, attributes=facts_of(item.attrs), label=label)


def _texts(item: Any) -> str:
    """Return the texts of a small dataset, one per line; empty for any other dataset."""
    is_text = isinstance(item, h5py.Dataset) and (
        item.dtype.kind == "S" or h5py.check_string_dtype(item.dtype) is not None
    )
    if not is_text or item.shape is None or int(np.prod(item.shape)) > MOST_TEXTS:
        return ""
    return _joined(inside(item)[()]) if item.dtype.kind == "S" else _joined(item[()])


def _joined(value: Any) -> str:
    flat = np.ravel(np.asarray(value, dtype=object))
    return "\n".join(x.decode("utf-8", "replace") if isinstance(x, bytes) else str(x) for x in flat)


def facts_of(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the attributes that are texts or numbers, by name; join several texts as lines."""
    facts: dict[str, Any] = {}
    for name in list(attributes)[:MOST_FACTS]:
        value = attribute(attributes, name)
        if np.size(value) > MOST_TEXTS:
            continue
        is_number = np.issubdtype(np.asarray(value).dtype, np.number)
        facts[str(name)] = value if is_number else _joined(value)
    return facts


def _behind(group: h5py.Group, name: str, target: str) -> Node:
    """Return the target of a soft link if no step of its path leaves the file."""
    here: Any = group.file if target.startswith("/") else group
    steps = [part for part in target.split("/") if part not in ("", ".")]
    for step in steps:
        # A link to another link is rejected too, because it could lead out of the file or in a
        # circle.
        is_hard = isinstance(here, h5py.Group) and isinstance(
            here.get(step, getlink=True), h5py.HardLink
        )
        if not is_hard:
            raise _outside(f"{group.name}/{name}")
        here = here[step]
    if isinstance(here, h5py.Dataset):
        return _array(here)
    return Opaque("a soft link to a group", messages.own_path(target))


def _outside(name: str) -> DataError:
    return DataError(
        f"`{name.replace('//', '/')}` is a link out of the HDF5 file, or a link to a link.",
        why="Following links could read other files than the one that is named and hashed.",
        remedy="Copy the data into the file, for example with h5repack or h5copy.",
    )


def require_sound_heaps(path: Path) -> None:
    """Raise a ValueError if a global heap, where HDF5 stores texts, is corrupt."""
    # One changed byte in a heap would make the library loop forever and ignore even Ctrl-C. See
    # HDF5 File Format Specification 3.0, section III.E.
    size = path.stat().st_size
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        for begin, end in {(0, min(REACH, size)), (max(size - REACH, 0), size)}:
            at = data.find(HEAP, begin, end)
            while at >= 0:
                if not _is_sound(data, at):
                    raise ValueError(f"the heap at byte {at} is damaged")
                at = data.find(HEAP, at + 1, end)


def _is_sound(data: mmap.mmap, start: int) -> bool:
    """Return whether the objects of an HDF5 heap fill it without gaps."""
    head = data[start + len(HEAP) : start + HEAD]
    total = int.from_bytes(head, "little")
    if len(head) < HEAD - len(HEAP) or not LEAST_HEAP <= total <= len(data) - start:
        # These bytes are samples and not a heap, or a heap whose size the HDF5 library rejects.
        return True
    at = HEAD
    while at + HEAD <= total:
        number, _, _, size = struct.unpack("<HHIQ", data[start + at : start + at + HEAD])
        # Free space (number 0) counts its own header; objects do not, and are padded to 8 bytes.
        step = size if number == 0 else HEAD + size + -size % 8
        if step < 8 or at + step > total:
            return False
        at += step
    return True
