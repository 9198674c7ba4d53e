"""Writing and reading of data trees in NetCDF 4 files by h5py, ten times as fast as by xarray.

The layout is the one that xarray writes by h5netcdf, and xarray's own rules encode and decode the
values: `xarray.open_datatree` and `arviz.from_netcdf` read the same content.
"""

from collections import ChainMap
from collections.abc import Mapping
from itertools import count
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import xarray as xr
from xarray.conventions import encode_cf_variable, encode_dataset_coordinates

from jbw.run.files import put_whole

NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable."
# prefix of a variable that has a dimension's name but other dimensions
RENAMED = "_nc4_non_coord_"
OF_LAYOUT = {
    "CLASS", "NAME", "REFERENCE_LIST", "DIMENSION_LIST", "_Netcdf4Dimid", "_Netcdf4Coordinates",
    "_NCProperties", "_nc3_strict",
}  # fmt: skip
# errors whose own message already states the cause
NO_DAMAGE = (OSError, ImportError, MemoryError)
TEXT = h5py.string_dtype()
BLOCK = 2**22  # number of bytes by which the file in memory grows at a time

Scales = ChainMap[str, h5py.Dataset]  # dimension scales by name; those of outer groups come last


def write_tree(path: Path, tree: xr.DataTree) -> None:
    """Write a data tree to a NetCDF file, completely or not at all.

    Raises:
        OSError: The file cannot be written.
    """
    dimension_numbers = count()
    scales: dict[str, Scales] = {}
    # The file is built in memory first: with a full disk, HDF5 would fail on closing and give an
    # unclear message.
    with h5py.File(
        path, "w", driver="core", backing_store=False, block_size=BLOCK, track_order=True
    ) as file:
        for key, node in tree.subtree_with_keys:
            outer = ChainMap() if key == "." else scales[key.rpartition("/")[0] or "."]
            group = file if key == "." else file.create_group(key, track_order=True)
            scales[key] = outer.new_child()
            _write_group(group, node.to_dataset(inherit=key == "."), scales[key], dimension_numbers)
        file.flush()
        put_whole(path, file.id.get_file_image())


def _write_group(
    group: h5py.Group, dataset: xr.Dataset, scales: Scales, dimension_numbers: "count[int]"
) -> None:
    variables, attrs = encode_dataset_coordinates(dataset)
    _write_attributes(group, attrs)
    endless = dataset.encoding.get("unlimited_dims", ())
    written = {
        str(name): _write_variable(group, str(name), encode_cf_variable(variable), dataset, endless)
        for name, variable in variables.items()
    }
    for dim, size in dataset.sizes.items():
        dim = str(dim)
        if dim in variables and variables[dim].dims == (dim,):
            scale = written.pop(dim)
            scale.make_scale(dim)
        elif dim in scales and scales[dim].shape == (size,):
            continue
        else:
            longest = (None if dim in endless else size,)
            scale = group.create_dataset(dim, (size,), ">f4", maxshape=longest, track_order=True)
            scale.make_scale(f"{NO_VARIABLE}{size:10}")
        scale.attrs["_Netcdf4Dimid"] = np.int32(next(dimension_numbers))
        scales[dim] = scale
    for name, stored in written.items():
        for axis, dim in enumerate(variables[name].dims):
            stored.dims[axis].attach_scale(scales[str(dim)])


def _write_variable(
    group: h5py.Group, name: str, variable: xr.Variable, dataset: xr.Dataset, endless: Any
) -> h5py.Dataset:
    values = np.asarray(variable.values)
    is_text = values.dtype.kind in "OU"
    is_clash = name in dataset.sizes and variable.dims != (name,)
    stored = group.create_dataset(
        f"{RENAMED}{name}" if is_clash else name,
        data=values.astype(object) if is_text else values,
        dtype=TEXT if is_text else None,
        fillvalue=None if is_text else variable.attrs.get("_FillValue"),
        maxshape=[None if dim in endless else dataset.sizes[dim] for dim in variable.dims]
        if set(endless) & set(variable.dims)
        else None,
        track_order=True,
    )
    _write_attributes(stored, variable.attrs)
    return stored


def _write_attributes(target: h5py.Group | h5py.Dataset, attrs: Mapping[Any, Any]) -> None:
    for name, value in attrs.items():
        # NetCDF stores a single number as an array with one element.
        target.attrs[name] = value if isinstance(value, str | list) else np.atleast_1d(value)


def read_tree(path: Path, *groups: str) -> xr.DataTree:
    """Read a data tree from a NetCDF file that `write_tree` or xarray wrote.

    Args:
        path: The file.
        groups: Names of groups below the root that are read with everything below them; all groups
            if none is given. The root itself is always read.

    Raises:
        OSError: The file does not exist, or is damaged.
    """
    datasets: dict[str, xr.Dataset] = {}
    try:
        with h5py.File(path) as file:
            waiting: list[tuple[str, h5py.Group]] = [("/", file)]
            names: dict[Any, str] = {}  # dimension names, keyed by the identity of their scales
            for key, group in waiting:
                found = dict(group.items())
                datasets[key] = _read_group(group, found, names)
                waiting += [
                    (f"{key.rstrip('/')}/{name}", below)
                    for name, below in found.items()
                    if isinstance(below, h5py.Group) and (key != "/" or name in (groups or found))
                ]
        return xr.DataTree.from_dict(datasets)
    except NO_DAMAGE:
        raise
    except Exception as cause:  # HDF5 may raise any exception for a damaged file.
        raise OSError(f"{type(cause).__name__}: {cause}") from cause


def _read_group(group: h5py.Group, found: Mapping[str, Any], names: dict[Any, str]) -> xr.Dataset:
    stored = {name: item for name, item in found.items() if isinstance(item, h5py.Dataset)}
    names |= {item: name for name, item in stored.items() if item.is_scale}
    variables = {}
    for name, item in stored.items():
        if item.is_scale and str(item.attrs.get("NAME", b""), "utf-8").startswith(NO_VARIABLE):
            continue
        # This variable has further dimensions besides the one with its own name.
        if item.is_scale and item.ndim > 1:
            by_id = {scale.attrs.get("_Netcdf4Dimid"): called for scale, called in names.items()}
            dims = [by_id[one] for one in np.asarray(item.attrs["_Netcdf4Coordinates"])]
        elif item.is_scale:
            dims = [name]
        else:
            dims = [names[item.file[axis[-1]]] for axis in item.attrs.get("DIMENSION_LIST", ())]
        is_text = h5py.check_string_dtype(item.dtype)
        values = np.asarray(item.asstr()[()], dtype=str) if is_text else item[()]
        variables[name.removeprefix(RENAMED)] = xr.Variable(dims, values, _attributes(item))
    dataset = xr.decode_cf(xr.Dataset(variables, attrs=_attributes(group))).load()
    endless = {
        name for name, item in stored.items() if item.is_scale and None in (item.maxshape or ())
    }
    dataset.encoding["unlimited_dims"] = endless
    return dataset


def _attributes(source: h5py.Group | h5py.Dataset) -> dict[str, Any]:
    """Return attributes in xarray's form: one-element arrays as single values, texts as lists."""
    attrs = {}
    for name in source.attrs:
        if name in OF_LAYOUT:
            continue
        value = source.attrs[name]
        if isinstance(value, np.ndarray):
            value = value.tolist() if value.dtype.kind == "O" else value
            value = value[0] if len(value) == 1 else value
        attrs[name] = value
    return attrs
