"""The files: read back by h5py and tomllib, and through the door of every campaign."""

import hashlib
import json
import tomllib
from dataclasses import replace

import h5py
import numpy as np
import pytest

import jbw
from jbw import RunError
from jbw.campaign.load import load_campaign
from jbw.rig import LABORATORY, SLIDERS, measure, write

NAMES = ("sweep_0p05V", "sweep_0p10V", "sweep_0p20V", "loop_0p02V")


@pytest.fixture(scope="module")
def campaign():
    return measure(tests=NAMES, repeats=2, seed=3, delay=1e-4)


@pytest.fixture(scope="module")
def folder(campaign, tmp_path_factory):
    return write(campaign, tmp_path_factory.mktemp("rig") / "new").parent


def test_files_give_back_the_records_exactly(campaign, folder):
    for test in campaign.tests:
        for r, record in enumerate(test.records):
            with h5py.File(folder / f"{test.name}_{r + 1:02d}.h5") as file:
                for role, unit in (("input", "V"), ("velocity", "m/s")):
                    dataset = file[role]
                    np.testing.assert_array_equal(np.float64(dataset[:]), record.channels[role])
                    assert dataset.attrs["unit"] == unit
                    assert dataset.attrs["fs"] == 1024.0
                    assert dataset.fletcher32
                demand = campaign.demands[test.name][r]
                np.testing.assert_allclose(file["demand"][:], demand, rtol=1e-7, atol=1e-40)


def test_campaign_file_states_the_tests(campaign, folder):
    table = tomllib.loads((folder / "campaign.toml").read_text())
    assert table["campaign"] == {"name": "virtual rig, laboratory"}
    assert table["identify"]["fit_levels"] == [0.05, 0.2]
    assert table["identify"]["prior"]["alpha"] == [424.31, 589.61]
    assert [test["name"] for test in table["test"]] == [test.name for test in campaign.tests]
    for test in table["test"]:
        assert len(list(folder.glob(test["files"]))) == 2
        assert test["fs"] == 1024.0
        assert test["delay"] == 1e-4
        assert test["channels"] == {"input": "input", "velocity": "velocity"}
        assert test["units"] == {"input": "V", "velocity": "m/s"}
    assert table["test"][2]["level"] == 0.2
    assert table["test"][3]["tones"] == [18.5]


def test_no_empty_table_is_written(campaign, folder):
    assert "[assembly]" not in (folder / "campaign.toml").read_text(encoding="utf-8")


def test_every_planned_test_has_its_own_file_pattern():
    """No pattern takes the files of another test."""
    names = [plan.name for plan in LABORATORY.plans]
    assert not any(a != b and b.startswith(f"{a}_") for a in names for b in names)


def test_the_truth_is_beside_the_campaign_not_in_it(campaign, folder):
    truth = json.loads((folder / "truth.json").read_text())
    assert truth == campaign.truth
    assert truth["joint"]["delta"] == 340.21
    assert "340.21" not in (folder / "campaign.toml").read_text()


def test_equal_campaigns_give_equal_bytes(campaign, folder, tmp_path):
    write(campaign, tmp_path)
    for path in sorted(tmp_path.iterdir()):
        digest = hashlib.sha256(path.read_bytes()).digest()
        assert digest == hashlib.sha256((folder / path.name).read_bytes()).digest(), path.name


def test_a_finished_campaign_is_not_overwritten(campaign, folder):
    with pytest.raises(RunError, match="new or empty"):
        write(campaign, folder)


def test_an_interrupted_writing_is_completed(campaign, tmp_path):
    (tmp_path / "sweep_0p05V_01.h5").write_bytes(b"half a fi")
    assert write(campaign, tmp_path).exists()
    with h5py.File(tmp_path / "sweep_0p05V_01.h5") as file:
        assert file["velocity"].shape == (16_384,)
    assert not list(tmp_path.glob(".*"))


def test_strangers_in_the_folder_are_refused(campaign, tmp_path):
    (tmp_path / "sweep_0p05V_99.h5").write_bytes(b"")
    with pytest.raises(RunError, match="sweep_0p05V_99"):
        write(campaign, tmp_path)
    assert not (tmp_path / "campaign.toml").exists()


def test_a_file_in_the_way_is_a_plain_error(campaign, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RunError, match="writable"):
        write(campaign, tmp_path / "file" / "folder")


@pytest.mark.filterwarnings("ignore:.*has no effect")  # the settings of all its tests
def test_the_door_of_every_campaign_reads_it(campaign, folder):
    loaded = jbw.load_campaign(folder / "campaign.toml")
    assert (loaded.name, loaded.gain, loaded.modal_mass) == (campaign.name, None, None)
    for test, same in zip(campaign.tests, loaded.tests, strict=True):
        fields = ("name", "kind", "level", "tones_hz", "band_hz", "settle", "delay")
        assert all(getattr(test, name) == getattr(same, name) for name in fields)
        for record, read in zip(test.records, same.records, strict=True):
            assert read.fs == record.fs
            for role, samples in record.channels.items():
                np.testing.assert_array_equal(read.channels[role], samples)


@pytest.mark.filterwarnings("ignore:.*has no effect")  # the settings of all its tests
def test_a_campaign_of_another_law_names_it(tmp_path):
    campaign = measure("mixed", joint=SLIDERS, tests="pull_4p00mm", repeats=1, omega_n_cv=0.01)
    assert campaign.laws == ("jenkins_3",)
    assert campaign.truth["joint"]["slip_ratio_2"] == pytest.approx(4.0)
    assert campaign.truth["days"][0]["omega_n"] != SLIDERS.omega_n
    assert set(campaign.settings.prior) == {"zeta"}  # the paper's boxes are of another law
    light = replace(SLIDERS, zeta=0.002)  # and of another damping
    assert not measure("mixed", joint=light, tests="pull_4p00mm", repeats=1).settings.prior
    assert load_campaign(write(campaign, tmp_path / "sliders")).laws == ("jenkins_3",)
    assert (
        "[joint]"
        not in write(
            measure("mixed", tests="pull_4p00mm", repeats=1), tmp_path / "bouc_wen"
        ).read_text()
    )
