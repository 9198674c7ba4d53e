"""Results as NetCDF files: xarray and ArviZ read what is written, and what xarray wrote is read."""

import errno
import os

import arviz
import numpy as np
import pytest
import xarray as xr

from jbw.run import files
from jbw.run.netcdf import read_tree, write_tree

TEXTS = np.array(["weak", "", "80 Hz, µ-strain ε"])


def a_tree():
    """A tree of every kind of value that results hold, named as people name tests."""
    rng = np.random.default_rng(0)
    draws = xr.Dataset(
        {
            "gamma": (("chain", "draw"), rng.normal(size=(2, 3)), {"units": "1/m", "lower": 0.5}),
            "noise_std": (("level", "chain", "draw"), rng.normal(size=(3, 2, 3))),
        },
        coords={"chain": [0, 1], "draw": [0, 1, 2], "level": TEXTS},
        attrs={"seed": np.array([3, 4]), "sampler": "amis", "sample_dims": ["chain", "draw"]},
    )
    gaps = xr.Dataset(
        {
            "coverage": ("time", [0.5, np.nan, np.inf]),
            "single": ("time", np.array([1.0, np.nan, -0.0], "float32")),
            "withheld": ("time", [True, False, True]),
            "counts": ("time", np.array([1, -(2**62), 3])),
            "small": ("time", np.array([-3, 0, 3], "int8")),
            "words": ("time", TEXTS),
            "one_word": ((), "ok"),
            "one_number": ((), 2.5),
            "when": ("time", np.array(["2026-01-31T12:00", "NaT", "1999-12-31"], "datetime64[ns]")),
            "nothing": ("empty", np.zeros(0)),
            "no_words": ("empty", np.zeros(0, "U3")),
        },
        coords={"second": ("time", [2.0, 1.0, 0.0]), "run": ((), "day 2")},
        attrs={"level": np.float64(0.1), "number": np.int64(4), "forced": np.arange(6.0),
               "one_of_a_row": ["alone"], "none_of_a_row": [], "text": "ε = 1 µm/m\nsecond line"},
    )  # fmt: skip
    square = xr.Dataset(
        {"covariance": (("parameter", "other"), np.eye(2)), "other": ("parameter", [1.0, 2.0])},
        coords={"parameter": ["zeta", "gamma"]},
    )
    return xr.DataTree.from_dict(
        {
            "/": xr.Dataset(attrs={"laws": '["bouc_wen"]', "y_peak": 1.5e-300, "hashes": 1}),
            "/posterior": draws,
            "/posterior/of the same": xr.Dataset({"mean": ("chain", [1.0, 2.0])}),
            "/verification/sweep/Prüfung 1, [0.1 V]": gaps,
            "/square": square,
            "/links": xr.Dataset({"link": (("link", "end"), np.arange(6.0).reshape(3, 2))}),
            "/a": xr.Dataset(),
        }
    )


def require_same(found, expected):
    """Values, dimensions, coordinates and attributes, with their dtypes and their order."""
    xr.testing.assert_identical(found, expected)
    assert found.groups == expected.groups
    for node in expected.subtree:
        same = found[node.path]
        assert list(same.children) == list(node.children)
        require_same_attrs(same.attrs, node.attrs)
        assert same.dims == node.dims
        assert set(same.coords) == set(node.coords)
        for name, variable in node.variables.items():
            assert same.variables[name].dtype == variable.dtype, name
            require_same_attrs(same.variables[name].attrs, variable.attrs)


def require_same_attrs(found, expected):
    assert list(found) == list(expected)
    for name, value in expected.items():
        assert type(found[name]) is type(value), name
        assert getattr(found[name], "dtype", None) == getattr(value, "dtype", None), name


def by_xarray(path):
    with xr.open_datatree(path, engine="h5netcdf") as stored:
        return stored.load()


@pytest.fixture
def path(tmp_path):
    return tmp_path / "posterior.nc"


def test_xarray_reads_what_it_would_have_written_itself(path, tmp_path):
    a_tree().to_netcdf(tmp_path / "xarray.nc", engine="h5netcdf")
    write_tree(path, a_tree())
    require_same(by_xarray(path), by_xarray(tmp_path / "xarray.nc"))


@pytest.mark.parametrize("writes", ["here", "xarray"])
def test_what_is_read_is_what_xarray_reads(path, writes):
    """Runs of earlier versions were written by xarray."""
    if writes == "here":
        write_tree(path, a_tree())
    else:
        a_tree().to_netcdf(path, engine="h5netcdf")
    require_same(read_tree(path), by_xarray(path))


def test_a_tree_is_the_same_after_any_number_of_files(path):
    write_tree(path, a_tree())
    once = read_tree(path)
    write_tree(path, once)
    require_same(read_tree(path), once)
    xr.testing.assert_equal(once, a_tree())


def test_arviz_reads_the_draws(path):
    write_tree(path, a_tree())
    draws = arviz.from_netcdf(path).posterior
    np.testing.assert_array_equal(draws["gamma"], a_tree()["posterior"]["gamma"])
    assert draws["gamma"].dims == ("chain", "draw")


def test_a_dimension_that_may_grow_stays_one(path):
    tree = a_tree()
    tree["posterior"].encoding["unlimited_dims"] = {"draw"}
    tree["verification/sweep/Prüfung 1, [0.1 V]"].encoding["unlimited_dims"] = {"time"}
    write_tree(path, tree)
    for found in (read_tree(path), by_xarray(path)):
        assert found["posterior"].encoding["unlimited_dims"] == {"draw"}
        assert "time" in found["verification/sweep/Prüfung 1, [0.1 V]"].encoding["unlimited_dims"]
        xr.testing.assert_identical(found, by_xarray(path))


def test_only_the_groups_that_are_asked_for_are_read(path):
    write_tree(path, a_tree())
    some = read_tree(path, "posterior", "steps")
    assert some.groups == ("/", "/posterior", "/posterior/of the same")
    assert some.attrs == read_tree(path).attrs
    xr.testing.assert_identical(some["posterior"], read_tree(path)["posterior"])


@pytest.mark.fault(42)
def test_a_disk_that_is_full_leaves_the_file_of_before(path, monkeypatch):
    write_tree(path, a_tree())
    before = path.read_bytes()

    def full(_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(files.os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        write_tree(path, xr.DataTree())
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("damage", ["cut", "zeros", "no file", "text"])
def test_a_file_that_cannot_be_read_is_an_error_of_the_file(path, damage):
    write_tree(path, a_tree())
    content = path.read_bytes()
    if damage == "cut":
        path.write_bytes(content[: len(content) // 2])
    elif damage == "zeros":
        path.write_bytes(content[:600] + bytes(len(content) - 600))
    elif damage == "text":
        path.write_text("no results")
    else:
        path.unlink()
    with pytest.raises(OSError):  # noqa: PT011  # in HDF5's words
        read_tree(path)
