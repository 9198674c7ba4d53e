"""A byte that was flipped in a result: one sentence that names the file, whatever it hit."""

import json
import shutil

import numpy as np
import pytest
import xarray as xr

from jbw.cli import run as command
from jbw.errors import DataError
from jbw.report.result import read_result
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
    assert summary == SUMMARY
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
    assert read_result(tmp_path)[0] == SUMMARY


def test_hashes_that_are_gone_are_missed(folder, tmp_path):
    copy = shutil.copytree(folder, tmp_path / "copy")
    summary = json.loads((copy / "summary.json").read_text())
    del summary["sha256"]
    (copy / "summary.json").write_text(json.dumps(summary))
    with pytest.raises(DataError, match=r"summary\.json is damaged"):
        read_result(copy)
