"""The run's folder: claimed before the work, written whole or not at all."""

import errno
import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from jbw.cli import run as command
from jbw.errors import ConfigError, RunError
from jbw.results.run import RunSummary
from jbw.run.manifest import Manifest, read_manifest, write_manifest
from jbw.study import store as storage
from jbw.study.study import Study


def a_tree():
    return xr.DataTree.from_dict(
        {"/posterior": xr.Dataset({"gamma": (("chain", "draw"), np.arange(6.0).reshape(2, 3))})}
    )


def save(folder, tree, summary):
    storage.save_result(folder, tree, summary)
    storage.save_report(folder, tree, RunSummary.read(summary))


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

    monkeypatch.setattr("jbw.report.page.write_page", fail)
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


def test_figures_are_files_only_where_formats_are_asked_for(tmp_path, capsys):
    """`--figures png` gives what every report wrote before; the page holds the figures anyway."""
    save(tmp_path, a_tree(), {"campaign": "toy", "steps": {}, "verdict": {}})
    assert not (tmp_path / "figures").exists()
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<svg" in page
    assert command(["report", str(tmp_path), "--figures", "png,pdf"]) == 0
    written = {path.name for path in (tmp_path / "figures").iterdir()}
    assert {"extra_trace_rank.png", "extra_trace_rank.pdf"} <= written
    assert {Path(name).suffix for name in written} == {".png", ".pdf"}
    assert str(tmp_path / "figures") in capsys.readouterr().out.replace("\n", "")


@pytest.mark.parametrize("other", [["--out", "page.html"], ["--brief"]])
def test_one_file_alone_has_no_figures_beside_it(tmp_path, capsys, other):
    assert command(["report", str(tmp_path), "--figures", "pdf", *other]) == 2
    assert other[0] in capsys.readouterr().err


def test_a_format_that_is_none_is_refused_before_any_work(tmp_path, capsys):
    assert command(["demo", "--figures", "png,jpeg", "--out", str(tmp_path / "demo")]) == 2
    assert "among png, svg, pdf" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "demo").exists()
    with pytest.raises(ConfigError, match="Argument `figures`"):
        Study(a_tree(), {}).save(tmp_path / "run", figures=["tiff"])
    assert not (tmp_path / "run").exists()


def test_a_run_that_goes_on_knows_which_figures_were_asked_for(tmp_path):
    manifest = Manifest("jbw identify", "campaign.toml", figures=("png", "pdf"))
    write_manifest(tmp_path / "manifest.json", manifest)
    assert read_manifest(tmp_path / "manifest.json") == manifest
