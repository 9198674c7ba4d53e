"""A byte that was flipped in a result: one sentence that names the file, whatever it hit."""

import json
import shutil
import signal
import subprocess
import sys

import h5py
import numpy as np
import pytest
import xarray as xr

import jbw
from jbw.cli import run as command
from jbw.errors import DataError
from jbw.report.result import read_result
from jbw.run.folder import begin, is_first_answer, reopen
from jbw.run.manifest import Manifest
from jbw.study.store import save_result

SUMMARY = {"campaign": "toy", "steps": {}, "verdict": {}, "seed": 3, "numbers": [1.5e-300, 0.1]}


@pytest.fixture(scope="module", name="folder")
def _folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("result")
    draws = np.random.default_rng(0).standard_normal((4, 500))
    posterior = xr.Dataset({"gamma": (("chain", "draw"), draws, {"units": "1/m"})})
    save_result(folder, xr.DataTree.from_dict({"/posterior": posterior}), SUMMARY)
    return folder


def test_a_whole_result_is_read_as_it_was_written(folder):
    summary, tree = read_result(folder)
    assert summary.plain() == SUMMARY
    assert tree["posterior"]["gamma"].shape == (4, 500)


@pytest.mark.parametrize("name", ["posterior.nc", "summary.json"])
@pytest.mark.parametrize("place", np.linspace(0.001, 0.999, 30))
def test_a_flipped_byte_is_named_in_one_sentence(folder, tmp_path, name, place):
    copy = shutil.copytree(folder, tmp_path / "copy")
    content = bytearray((copy / name).read_bytes())
    content[int(place * len(content))] ^= 0x11
    (copy / name).write_bytes(content)
    with pytest.raises(DataError) as caught:
        read_result(copy)
    assert "damaged" in caught.value.what
    assert "\n" not in caught.value.what
    assert "copy" in caught.value.remedy


def test_the_command_line_ends_as_for_bad_data(folder, tmp_path, capsys):
    copy = shutil.copytree(folder, tmp_path / "copy")
    content = bytearray((copy / "posterior.nc").read_bytes())
    content[len(content) // 2] ^= 0xFF
    (copy / "posterior.nc").write_bytes(content)
    assert command(["report", str(copy)]) == 3
    assert "posterior.nc is damaged" in " ".join(capsys.readouterr().err.split())


def test_a_result_without_hashes_is_of_an_earlier_version(folder, tmp_path):
    (tmp_path / "summary.json").write_text(json.dumps(SUMMARY))
    read_result(folder)[1].to_netcdf(tmp_path / "posterior.nc", engine="h5netcdf")
    assert read_result(tmp_path)[0].plain() == SUMMARY


def test_hashes_that_are_gone_are_missed(folder, tmp_path):
    copy = shutil.copytree(folder, tmp_path / "copy")
    summary = json.loads((copy / "summary.json").read_text())
    del summary["sha256"]
    (copy / "summary.json").write_text(json.dumps(summary))
    with pytest.raises(DataError, match=r"summary\.json is damaged"):
        read_result(copy)


@pytest.mark.fault(36)
@pytest.mark.parametrize("lost", [np.nan, np.inf])
@pytest.mark.parametrize("sealed_by", ["this version", "an earlier one"])
def test_draws_that_are_no_numbers_are_refused_whatever_the_hashes(tmp_path, lost, sealed_by):
    """As where somebody wrote the file anew, with or without hashes."""
    draws = np.random.default_rng(0).standard_normal((4, 50))
    draws[2, 7] = lost
    variables = {name: (("chain", "draw"), draws) for name in ("omega_n", "zeta")}
    tree = xr.DataTree.from_dict({"/posterior": xr.Dataset(variables)})
    if sealed_by == "this version":
        save_result(tmp_path, tree, SUMMARY)
    else:
        (tmp_path / "summary.json").write_text(json.dumps(SUMMARY))
        tree.to_netcdf(tmp_path / "posterior.nc", engine="h5netcdf")
    before = {path.name for path in tmp_path.iterdir()}
    for words in (["report"], ["export"], ["predict"], ["export", "--draws", "10"]):
        code = command([words[0], str(tmp_path), *words[1:]])
        assert code == 3, words
    with pytest.raises(DataError, match=r"omega_n in .* must be finite numbers, but 1 of 200"):
        read_result(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == before


def test_a_result_that_memory_cannot_hold_is_not_called_damaged(tmp_path):
    """A file of a few kB that states 400 TB of draws, as a bomb or a broken header would."""
    (tmp_path / "summary.json").write_text(json.dumps(SUMMARY))
    with h5py.File(tmp_path / "posterior.nc", "w") as file:
        file.create_group("posterior").create_dataset("gamma", (5, 10**13), "f8", chunks=(5, 1000))
    with pytest.raises(MemoryError):
        jbw.load_study(tmp_path)


def test_a_library_that_is_missing_is_named(folder, monkeypatch):
    """An import that fails below the reader, as of a damaged installation."""
    monkeypatch.setitem(sys.modules, "cftime", None)

    def decoded(*_, **__):
        import cftime  # noqa: F401

    monkeypatch.setattr("xarray.decode_cf", decoded)
    with pytest.raises(ImportError, match="cftime"):
        jbw.load_study(folder)


KILLED = """
import os, signal, sys
from pathlib import Path
import xarray as xr
from jbw.study import store

folder, replace = Path(sys.argv[1]), os.replace

def replaced_and_killed(part, target):
    replace(part, target)
    if Path(target) == folder / "posterior.nc":
        os.kill(os.getpid(), signal.SIGKILL)

store.os.replace = replaced_and_killed
store.save_result(folder, xr.DataTree(xr.Dataset(attrs={"new": 1})), {"campaign": "new"})
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no such signal on this system")
@pytest.mark.fault(40)
def test_a_kill_between_both_files_of_a_result_names_what_completes_it(tmp_path, capsys):
    campaign = tmp_path / "x.toml"
    campaign.touch()
    begun = begin(tmp_path / "run", Manifest("jbw identify", str(campaign)))
    first = xr.DataTree.from_dict({"/": xr.Dataset(attrs={"old": 1})})
    save_result(begun.folder, first, {**SUMMARY, "quick": {}})
    begun.close()
    killed = subprocess.run([sys.executable, "-c", KILLED, str(begun.folder)], check=False)
    assert killed.returncode == -signal.SIGKILL
    assert command(["report", str(begun.folder)]) == 3
    said = " ".join(capsys.readouterr().err.split())
    assert f"Finish the run: jbw resume {begun.folder}" in said
    # What `jbw resume` takes up: a run whose result is a first answer still.
    again = reopen(begun.folder)
    assert again is not None
    assert is_first_answer(again.folder)
    assert not list(again.folder.glob(".part-*"))
    save_result(again.folder, first, SUMMARY)
    again.finish()
    again.close()
    assert read_result(begun.folder)[0].plain() == SUMMARY
