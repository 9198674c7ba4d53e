"""Published measurements through the door; skipped where the files are not at hand."""

from pathlib import Path

import numpy as np
import pytest
import scipy.io
from measured_data import DATA

from jbw.measurement.files.read import read


def measured(name: str) -> Path:
    path = DATA / name
    if not path.exists():
        pytest.skip(f"{name} is not in {DATA}; set JBW_DATA to the folder of measured data")
    return path


def test_double_beam_decays_from_a_cell_array():
    path = measured("bolted_double_beam/data.mat")
    repeats = read(path, {"time": "xData[:][0]", "velocity": "xData[:][1]"}, {"velocity": "m/s"})
    # From the data set's description: 9 records of 15719 samples at 5120 Hz.
    assert len(repeats) == 9
    assert {(record.fs, record.num_samples) for record in repeats} == {(5120.0, 15719)}
    # Column 4 is the authors' own peak of each record.
    peaks = scipy.io.loadmat(path)["xData"][:, 3]
    for record, peak in zip(repeats, peaks, strict=True):
        np.testing.assert_allclose(np.abs(record.channels["velocity"]).max(), peak.item())


def test_brake_reuss_levels_from_a_struct_array():
    fields = {"force": "force", "acceleration": "amplitude", "frequency": "frequency"}
    roles = {role: f"FRdata.ResponseControl[:].{name}" for role, name in fields.items()}
    units = {"force": "N", "acceleration": "m/s^2", "frequency": "Hz", "phase": "rad"}
    roles["phase"] = "FRdata.ResponseControl[:].phase"
    levels = read(measured("brake_reuss_beam/ForcedFrequencyResponses.mat"), roles, units)
    # From the description: 8 response-controlled levels, 41 lines of 0.05 Hz.
    mean = [np.mean(level.channels["acceleration"]) for level in levels]
    np.testing.assert_allclose(mean, [5, 20, 30, 40, 50, 60, 70, 80], rtol=0.05)
    assert np.isnan(levels[0].fs)
    np.testing.assert_allclose(np.diff(levels[3].channels["frequency"]), 0.05, rtol=1e-9)


def test_hysteretic_benchmark():
    folder = "boucwen_benchmark_synthetic"
    (u,) = read(measured(f"{folder}/uest_multisine.mat"), {"force": "u"}, {"force": "N"}, fs=750)
    (y,) = read(
        measured(f"{folder}/yest_multisine.mat"),
        {"displacement": "y"},
        {"displacement": "m"},
        fs=750,
    )
    # From the description: 50 N rms, four periods of 8192.
    assert u.num_samples == y.num_samples == 4 * 8192
    np.testing.assert_allclose(np.std(u.channels["force"]), 50.0, rtol=0.01)


def test_silverbox():
    path = measured("silverbox/SNLS80mV.mat")
    roles, units = {"input": "V1", "displacement": "V2"}, {"input": "V", "displacement": "m"}
    (record,) = read(path, roles, units, fs=1e7 / 2**14)
    assert (record.num_samples, record.fs) == (131072, 610.3515625)


def test_f16_row_of_a_matrix_and_rate_from_the_file():
    path = measured("f16_gvt_multisine/F16Data_FullMSine_Level3.npz")
    roles = {"force": "Force", "acceleration": "Acceleration[1]"}
    (record,) = read(path, roles, {"force": "N", "acceleration": "m/s^2"}, fs="Fs")
    assert (record.fs, record.num_samples) == (400.0, 9 * 8192)
    # From the description: force of 36.8 N rms at level 3.
    np.testing.assert_allclose(np.std(record.channels["force"]), 36.8, rtol=0.01)


def test_friction_damper_columns_in_inches_and_kips():
    path = measured("friction_damper_brfd/dataset2_characterization.npz")
    test = "1Hz0lbtension1.5amplitude"
    roles = {"displacement": f"{test}[:, 0]", "restoring_force": f"{test}[:, 1]"}
    units = {"displacement": "in", "restoring_force": "kip"}
    (record,) = read(path, roles, units, fs="_fs_hz")
    # The test's name says an amplitude of 1.5 in; the actuator reaches 97 % of it.
    np.testing.assert_allclose(np.abs(record.channels["displacement"]).max(), 0.0381, rtol=0.04)
