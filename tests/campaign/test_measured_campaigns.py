"""The campaign files of published measurements; skipped where the data are not at hand."""

from pathlib import Path

import numpy as np
import pytest
import scipy.io
from measured_data import DATA

from jbw.campaign.check import check_campaign
from jbw.campaign.load import load_campaign
from jbw.campaign.schema import read_spec
from jbw.measurement.curves import displacement_of, forced_loop, response_curve
from jbw.measurement.loops import enclosed_area

ROOT = Path(__file__).parents[2]
CAMPAIGNS = sorted((ROOT / "notebooks" / "campaigns").glob("*.toml"))
FOLDERS = {
    "bolted_double_beam": "bolted_double_beam",
    "bolted_double_beam_mode2": "bolted_double_beam",
    "brake_reuss_all": "brake_reuss_beam",
    "brake_reuss_beam": "brake_reuss_beam",
    "f16_multisine": "f16_gvt_multisine",
    "f16_sweep": "f16_gvt_sinesweep",
    "f16_torsion": "f16_gvt_sinesweep",
    "friction_damper": "friction_damper_brfd",
    "hysteretic_benchmark": "boucwen_benchmark_synthetic",
    "silverbox": "silverbox",
    "silverbox_official": "silverbox",
    "silverbox_smooth": "silverbox",
    "silverbox_without_cubic": "silverbox",
}


@pytest.fixture
def campaign_file(monkeypatch):
    """The path of a campaign whose data are at hand."""

    def path(name):
        if not (DATA / FOLDERS[name]).is_dir():
            pytest.skip(f"{FOLDERS[name]} is not in {DATA}; set JBW_DATA to the folder of the data")
        monkeypatch.setenv("JBW_DATA", str(DATA))
        return ROOT / "notebooks" / "campaigns" / f"{name}.toml"

    return path


def loaded(campaign_file, name):
    return load_campaign(campaign_file(name), allow_outside=True)


@pytest.mark.parametrize("path", CAMPAIGNS, ids=lambda p: p.stem)
def test_campaign_file_is_valid_without_its_data(path):
    assert path.stem in FOLDERS
    spec = read_spec(path)
    files = [f for t in spec.tests for f in getattr(t.files, "values", lambda t=t: [t.files])()]
    assert all(name.startswith("$JBW_DATA/") for names in files for name in names)


@pytest.mark.parametrize("name", FOLDERS)
def test_campaign_checks_without_errors(campaign_file, name):
    found = check_campaign(campaign_file(name), allow_outside=True)
    assert found.exit_code == 0, [f.what for row in found.rows for f in row.findings]


def test_brake_reuss_beam_has_eight_passive_levels(campaign_file, recwarn):
    campaign = loaded(campaign_file, "brake_reuss_beam")
    assert not recwarn.list
    assert [test.level for test in campaign.tests] == [5, 20, 30, 40, 50, 60, 70, 80]
    levels = scipy.io.loadmat(
        DATA / "brake_reuss_beam" / "ForcedFrequencyResponses.mat", simplify_cells=True
    )["FRdata"]["ResponseControl"]
    for test, level in zip(campaign.tests, levels, strict=True):
        curve = response_curve(test.records[0])
        assert (curve.source_kind, len(curve.freq_hz)) == ("force", 41)
        assert test.records[0].units["force"] == "N"
        np.testing.assert_allclose(curve.source, level["force"])
        np.testing.assert_allclose(np.abs(curve.response), level["amplitude"])
        y = displacement_of(curve)
        # From the description: displacement at resonance, in whole micrometres.
        at_resonance = np.abs(y[np.argmax(np.abs(y) / curve.source)])
        expected = {5: 20, 20: 79, 30: 117, 40: 159, 50: 198, 60: 236, 70: 276, 80: 315}
        np.testing.assert_allclose(at_resonance * 1e6, expected[int(test.level)], rtol=0.03)
        # A passive joint takes energy in at every line.
        assert np.all(y.imag < 0)


def test_hysteretic_benchmark_joins_its_two_files(campaign_file):
    campaign = loaded(campaign_file, "hysteretic_benchmark")
    (test,) = campaign.tests
    (record,) = test.records
    assert (campaign.modal_mass, test.periods, record.fs) == (2.0, 4, 750.0)
    assert set(record.channels) == {"force", "displacement"}
    assert record.name == "uest_multisine.mat + yest_multisine.mat"
    # From the description: 50 N rms. The periods are alike but for the authors' noise on y, which
    # is the same between all of them: no transient in the first.
    np.testing.assert_allclose(record.channels["force"].std(), 50.0, rtol=0.01)
    periods = record.channels["displacement"].reshape(4, 8192)
    noise = np.std(np.diff(periods, axis=0), axis=1)
    np.testing.assert_allclose(noise, noise.mean(), rtol=0.03)
    assert noise.mean() < 0.02 * periods.std()


def test_silverbox_has_no_offset(campaign_file):
    tests = {test.name: test for test in loaded(campaign_file, "silverbox").tests}
    for test in tests.values():
        for samples in test.records[0].channels.values():
            assert abs(samples.mean()) < 1e-12
        np.testing.assert_allclose(test.records[0].channels["input"].std(), test.level, rtol=0.06)
    # From the description: input of 22.3 mV rms in the multisines.
    multisine = tests["multisine 2"].records[0].channels["input"]
    np.testing.assert_allclose(multisine.std(), 22.3e-3, rtol=0.02)
    low = tests["arrow, low"].records[0]
    assert "0.006" in low.provenance["mean of input removed"]


@pytest.mark.filterwarnings("ignore:.*clipped")  # the actuator rests at its stop for 5 ms
def test_friction_damper_loops_lose_energy(campaign_file):
    # Before it moves the damper of the last loop exerts 4.8 % of half the range of its force.
    with pytest.warns(UserWarning, match=r"30 lb, 1.5 in.* begins 4.8 % of its half range"):
        tests = loaded(campaign_file, "friction_damper").tests
    assert len(tests) == 3
    for test in tests:
        loop = forced_loop(test.records[0])
        assert loop.fs == 1024.0
        # The actuator reaches between 90 and 110 % of the amplitude that it was asked for.
        np.testing.assert_allclose(np.abs(loop.displacement).max(), test.level, rtol=0.1)
        period = slice(4096, 2 * 4096)  # the second of seven at 0.25 Hz
        assert enclosed_area(loop.displacement[period], loop.force[period]) > 0


def test_f16_motion_of_the_wing(campaign_file):
    campaign = loaded(campaign_file, "f16_multisine")
    assert [len(test.records[0].channels["force"]) for test in campaign.tests] == [9 * 8192] * 4
    with np.load(DATA / "f16_gvt_multisine" / "F16Data_FullMSine_Level5.npz") as archive:
        wing = np.float64(archive["Acceleration"][1])
    record = campaign.tests[2].records[0]
    np.testing.assert_array_equal(record.channels["acceleration"], wing)
    # From the description: force of 73.6 N rms at level 5.
    np.testing.assert_allclose(record.channels["force"].std(), 73.6, rtol=0.01)


def test_f16_sweeps_pass_the_mode(campaign_file):
    for test in loaded(campaign_file, "f16_sweep").tests:
        force = test.records[0].channels["force"]
        fs = test.records[0].fs
        crossings = np.flatnonzero(np.diff(np.sign(force)))
        cycles = np.array([np.diff(crossings[:21]).mean(), np.diff(crossings[-21:]).mean()])
        # From the description: 15.2 Hz less 0.05 Hz/s, a little above by level, from 80 to 195 s.
        np.testing.assert_allclose(fs / (2 * cycles), [11.2, 5.45], rtol=0.05)
