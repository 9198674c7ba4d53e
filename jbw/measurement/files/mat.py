"""MATLAB files: v5 to v7 read with scipy, v7.3 with h5py; structs, struct arrays and cells."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.io
import scipy.sparse
from numpy.typing import NDArray

from jbw.errors import DataError
from jbw.measurement.files import hdf5
from jbw.measurement.files.mat_headers import require_sound
from jbw.measurement.files.tree import (
    LONGEST_TEXT,
    Contents,
    Leaf,
    Node,
    OnDemand,
    Opaque,
    cells,
    numeric,
)
from jbw.report.messages import reading as messages

# MATLAB's own objects; they contain no arrays that other programs can read.
OPAQUE = (
    scipy.io.matlab.MatlabOpaque,
    scipy.io.matlab.MatlabFunction,
    scipy.io.matlab.MatlabObject,
)


@contextmanager
def contents(path: Path) -> Iterator[Contents]:
    """Open a MATLAB file of version 5 or later."""
    if h5py.is_hdf5(path):
        hdf5.require_sound_heaps(path)
        with h5py.File(path, "r") as file:
            yield Contents(hdf5.group_tree(file, _node73), "MATLAB v7.3", fs=hdf5.fs_of(file.attrs))
    else:
        require_sound(path)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # sparse matrices are not read here
            # Objects have no name in the file, so that two of them look like duplicates.
            warnings.filterwarnings("ignore", message='Duplicate variable name "None"')
            loaded = scipy.io.loadmat(path, squeeze_me=True, struct_as_record=False)
        root = {name: _node(x) for name, x in loaded.items() if not name.startswith("__")}
        yield Contents(root, "MATLAB v5")


def _node(value: Any) -> Node:
    """Convert scipy's values to a tree: structs, object arrays, numbers."""
    if isinstance(value, OPAQUE):
        return Opaque(messages.MATLAB_OBJECT, messages.EXPORT_ARRAYS)
    if isinstance(value, scipy.io.matlab.mat_struct):
        return {name: _node(vars(value)[name]) for name in vars(value)["_fieldnames"]}
    if isinstance(value, np.ndarray) and value.dtype == object:
        return cells([_node(item) for item in value.ravel()], value.shape)
    if scipy.sparse.issparse(value):
        return Opaque("a sparse matrix", "In MATLAB, export full(x).")
    return numeric(np.asarray(value))


def _complex73(item: Any) -> OnDemand:
    """Return an array of complex numbers, which MATLAB stores as compounds of `real` and `imag`."""

    def read(index: Any) -> NDArray[np.complex128]:
        parts = item[index]
        return np.asarray(parts["real"] + 1j * parts["imag"], np.complex128)

    return OnDemand(item.shape, np.dtype(np.complex128), read)


def _node73(group: h5py.Group, name: str) -> Node:
    """Convert a tree from a MATLAB HDF5 file: follow references of cells, reverse the axes."""
    link = group.get(name, getlink=True)
    if not isinstance(link, h5py.HardLink):
        raise DataError(
            f"`{group.name}/{name}` is a link, which MATLAB does not write.",
            remedy="Copy the data to which the link points into the file.",
        )
    return _item73(group[name])


def _item73(item: Any) -> Node:
    of_class = hdf5.text_of(item.attrs, "MATLAB_class")
    if "MATLAB_object_decode" in item.attrs or of_class in ("table", "function_handle", "string"):
        return Opaque(messages.MATLAB_OBJECT, messages.EXPORT_ARRAYS)
    if isinstance(item, h5py.Group):
        fields: Any = hdf5.group_tree(item, _node73)
        # Each field of a struct array is an array of references without a MATLAB class.
        are_arrays = [
            isinstance(field, h5py.Dataset)
            and h5py.check_ref_dtype(field.dtype) is h5py.Reference
            and "MATLAB_class" not in field.attrs
            for field in item.values()
        ]
        if not (are_arrays and all(are_arrays)):
            return fields
        # This builds an array of structs, as in v5 files.
        shape = np.shape(next(iter(fields.values())))
        structs = [{name: fields[name][i] for name in fields} for i in np.ndindex(shape)]
        return cells(structs, shape)
    if h5py.check_ref_dtype(item.dtype) is h5py.Reference:
        references = np.asarray(item[()]).T
        shape = tuple(n for n in references.shape if n != 1)
        nodes = [_item73(item.file[reference]) for reference in references.ravel()]
        return cells(nodes, shape) if shape else nodes[0]
    axes = tuple(axis for axis in reversed(range(item.ndim)) if item.shape[axis] != 1)
    if item.dtype.names == ("real", "imag"):
        return Leaf(_complex73(hdf5.inside(item)), axes)
    if of_class == "char":
        return Opaque("text", text=_text73(item))
    if not np.issubdtype(item.dtype, np.number):
        return Opaque("not numeric")
    if hdf5.attribute(item.attrs, "MATLAB_empty"):
        return Opaque("empty")
    return Leaf(hdf5.inside(item), axes)


def _text73(item: Any) -> str:
    """Decode a one-row char array, stored as codes; return an empty text for other arrays."""
    if not np.issubdtype(item.dtype, np.integer) or item.size > LONGEST_TEXT:
        return ""
    if hdf5.attribute(item.attrs, "MATLAB_empty"):
        return ""
    codes = np.ravel(hdf5.inside(item)[()])
    return "".join(chr(code) for code in codes if 0 < code < 0xD800)
