"""What a campaign states beside its records: a decay's band, a level that is an amplitude."""

import tomllib

import numpy as np
import pytest
from pasted import lines_of
from scipy.io import savemat

from jbw.campaign.check import check_campaign
from jbw.campaign.draft import start_campaign, write_campaign
from jbw.cli import run
from jbw.errors import DataError
from jbw.measurement.demodulation import band_filter
from jbw.measurement.faults.examine import Examined, examined_decay
from jbw.measurement.faults.responses import band_about_peak, level_unlike
from jbw.measurement.records import Record

FS, HERTZ = 512.0, 18.8


def decay(size=4096):
    """Acceleration of a mode at 18.8 Hz, a louder one at 90 Hz beside it, and a mean."""
    t = np.arange(size) / FS
    fast = 20 * np.exp(-4 * t) * np.sin(2 * np.pi * 90 * t)
    return 2.0 * np.exp(-1.2 * t) * np.cos(2 * np.pi * HERTZ * t) + fast + 0.3


@pytest.fixture
def folder(tmp_path):
    rows = {"t": np.arange(4096) / FS, "acceleration": decay()}
    savemat(tmp_path / "tap_decay_1.mat", rows)
    return tmp_path


def test_a_band_is_proposed_about_the_mode_and_not_the_loudest_acceleration():
    record = Record(FS, {"acceleration": decay()}, {"acceleration": "m/s^2"})
    # Half of 18.8 Hz to either side, to two digits, as no line is nearer than 90 Hz.
    assert band_about_peak(record) == (9.4, 28.0)


@pytest.mark.parametrize(
    ("other_hz", "band"),
    [(31.0, (10.0, 25.0)), (13.0, (16.0, 30.0)), (45.0, (10.0, 30.0)), (22.0, (10.0, 30.0))],
)
def test_a_band_ends_half_way_to_the_nearest_other_line(other_hz, band):
    """Of 20 and 31 Hz sqrt(620) = 24.9 Hz; what is within 20 % is of the line itself."""
    t = np.arange(6144) / FS
    x = np.exp(-0.5 * t) * np.cos(2 * np.pi * 20 * t)
    x += 0.2 * np.exp(-0.7 * t) * np.cos(2 * np.pi * other_hz * t)
    x += 1e-4 * np.random.default_rng(0).standard_normal(len(t))
    assert band_about_peak(Record(FS, {"displacement": x}, {})) == band


def test_init_drafts_the_band_of_a_decay_and_check_takes_it(folder):
    draft = start_campaign(folder)
    (test,) = tomllib.loads(draft.text)["test"]
    assert test["band"] == [9.4, 28.0]
    assert draft.text.count("band = ") == 1
    assert any("band 9.4 to 28 Hz" in line for line in draft.assumed)
    assert check_campaign(write_campaign(draft, folder)).exit_code == 0


def test_check_refuses_a_decay_without_a_band_with_the_line_that_mends_it(folder, capsys):
    path = write_campaign(start_campaign(folder), folder)
    text = path.read_text()
    line = next(line for line in text.splitlines() if line.startswith("band = "))
    path.write_text(text.replace(line + "\n", ""))
    found = check_campaign(path)
    assert found.exit_code == 2  # the file must change, not the data
    (fault,) = (one for row in found.rows for one in row.findings if one.severity == "error")
    assert "needs `band`" in fault.what
    assert lines_of(fault.remedy) == [("[test]", "band = [9.4, 28]")]
    assert run(["check", str(path)]) == 2
    assert "band = [9.4, 28]" in capsys.readouterr().out
    # A look needs no band, and tells frequency and damping all the same.
    assert run(["look", str(path)]) == 0


@pytest.mark.parametrize(
    ("level", "doubted"),
    [(22.0, False), (15.6, False), (11.5, False), (40.0, False), (2.0, True), (1e3, True)],
)
def test_a_level_that_is_a_name_is_doubted(level, doubted):
    """A sine of 22 N: rms 15.6; twice or half of either is let pass, `level = 2` is not."""
    t = np.arange(512) / FS
    channels = {"force": 22.0 * np.sin(2 * np.pi * 16 * t), "velocity": 1e-3 * np.cos(t)}
    found = list(level_unlike(Record(FS, channels, {"force": "N"}), level))
    assert bool(found) == doubted
    if doubted:
        assert "`level` is" in found[0].what
        assert "peak of 22 and an rms of 15.6 N" in found[0].what
        assert "`level = 22`" in found[0].remedy


@pytest.mark.parametrize("level", [float("nan"), 0.0])
def test_a_level_that_is_not_stated_is_not_doubted(level):
    record = Record(FS, {"force": np.ones(8), "velocity": np.ones(8)}, {})
    assert list(level_unlike(record, level)) == []


def test_a_level_of_the_response_that_was_held_is_one():
    channels = {"force": np.full(9, 22.0), "acceleration": np.full(9, 5.0)}
    assert list(level_unlike(Record(float("nan"), channels, {}), 5.0)) == []


@pytest.mark.parametrize("fs", ["1e300", "1e13", "1e-7", "1e-300"])
@pytest.mark.parametrize("kind", ["decay", "sweep", "noise", "multisine"])
def test_a_sampling_frequency_that_no_recorder_has_is_refused(tmp_path, kind, fs):
    """Before anything is made whose size follows from it."""
    rng = np.random.default_rng(0)
    np.savez(tmp_path / "a.npz", u=rng.standard_normal(4096), v=rng.standard_normal(4096))
    (tmp_path / "campaign.toml").write_text(f"""[[test]]
kind = "{kind}"
files = "a.npz"
channels = {{ force = "u", velocity = "v" }}
units = {{ force = "N", velocity = "m/s" }}
band = [10.0, 40.0]
fs = {fs}
""")
    found = check_campaign(tmp_path / "campaign.toml")
    (fault,) = (one for row in found.rows for one in row.findings)
    assert "must lie between 1e-06 and 1e+12 Hz" in fault.what
    assert "Correct `fs`" in fault.remedy


def test_a_band_that_no_record_resolves_is_refused():
    record = Record(1e12, {"velocity": decay(4096)}, {"velocity": "m/s"})
    with pytest.raises(DataError, match="needs a filter of more than"):
        band_filter((10.0, 40.0), record.fs)
    assert examined_decay(record, (10.0, 40.0), 0.0) == Examined(None, (), (10.0, 40.0))


@pytest.mark.parametrize("seed", range(5))
def test_noise_of_an_acceleration_is_no_suspension(seed):
    """White noise of a thousandth: as a displacement its lines at 0.5 Hz are the largest."""
    t = np.arange(6144) / FS
    x = np.exp(-0.5 * t) * np.cos(2 * np.pi * 20 * t)
    x += 2e-2 * np.random.default_rng(seed).standard_normal(len(t))
    assert band_about_peak(Record(FS, {"acceleration": x}, {})) == (10.0, 30.0)


def test_a_suspension_that_stands_out_is_the_largest_displacement():
    t = np.arange(6144) / FS
    x = np.exp(-0.5 * t) * np.cos(2 * np.pi * 20 * t) + 0.1 * np.cos(2 * np.pi * 1.4 * t)
    x += 1e-3 * np.random.default_rng(0).standard_normal(len(t))
    assert band_about_peak(Record(FS, {"acceleration": x}, {})) == (0.71, 2.1)
