"""The run's folder: claimed before the work, written whole or not at all."""

import errno
import json

import numpy as np
import pytest
import xarray as xr

from jbw.errors import RunError
from jbw.study import store as storage


def a_tree():
    return xr.DataTree.from_dict(
        {"/posterior": xr.Dataset({"gamma": (("chain", "draw"), np.arange(6.0).reshape(2, 3))})}
    )


def save(folder, tree, summary):
    storage.save_result(folder, tree, summary)
    storage.save_report(folder, tree, summary)


def test_a_folder_that_holds_something_is_refused(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(RunError, match=r"notes\.txt") as caught:
        storage.claim(tmp_path)
    assert "--out" in caught.value.remedy
    assert storage.claim(tmp_path / "new" / "run").is_dir()


def test_a_run_is_written_with_its_summary(tmp_path):
    save(tmp_path, a_tree(), {"campaign": "toy", "steps": {}, "verdict": {}})
    assert json.loads((tmp_path / "summary.json").read_text())["campaign"] == "toy"
    with xr.open_datatree(tmp_path / "posterior.nc", engine="h5netcdf") as tree:
        np.testing.assert_array_equal(np.ravel(tree["posterior"]["gamma"]), np.arange(6.0))
    assert (tmp_path / "report.html").is_file()
    assert not list(tmp_path.glob(".part-*"))


def test_a_failing_report_leaves_the_result_and_says_how_to_try_again(tmp_path, monkeypatch):
    def fail(*_):
        raise ValueError("no such glyph")

    monkeypatch.setattr(storage, "write_page", fail)
    with pytest.raises(RunError, match="ValueError: no such glyph") as caught:
        save(tmp_path, a_tree(), {"campaign": "toy"})
    assert f"jbw report {tmp_path}" in caught.value.remedy
    assert {path.name for path in tmp_path.iterdir()} == {"posterior.nc", "summary.json"}


@pytest.mark.fault(42)
def test_a_full_disk_leaves_nothing_half_written(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(storage.os, "fsync", full)
    with pytest.raises(RunError, match="No space left") as caught:
        save(tmp_path, a_tree(), {"campaign": "toy"})
    assert "jbw resume" in caught.value.remedy
    assert list(tmp_path.iterdir()) == []
