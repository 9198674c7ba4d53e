"""Predictions from a run's posterior, against integrations and closed forms made without jbw."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from made_runs import (
    FS,
    GAIN,
    JOINT,
    SILENT,
    SIZE,
    Z,
    a_test,
    a_tree,
    burst,
    integrated,
    same,
    spread,
)

from jbw.campaign.loading import Campaign
from jbw.errors import ConfigError, DataError
from jbw.study.basis import Request, basis_attrs, basis_of
from jbw.study.known_noise import ALIKE, LEFT_OUT, OWN, REPEATS, UNKNOWN
from jbw.study.planned import planned_sweep, planned_tones
from jbw.study.predicting import predict, row_of, warnings_of
from jbw.study.reach import mark_reach
from jbw.study.storage import save_result
from jbw.study.study import Study, load_study


def test_the_truth_predicts_an_integrated_record():
    test = a_test(0.3, JOINT)
    y, _ = integrated(burst(0.3), JOINT, np.arange(SIZE) / FS)
    found = predict(basis_of(a_tree(same(JOINT), y_peak=np.abs(y).max())), test)
    # The joint slips: 5 % of its stiffness are lost at this displacement.
    assert JOINT["delta"] * np.abs(y).max() > 0.5
    # Eight steps a sample of a step that is of fourth order in the input leave 1.3e-7.
    assert found.attrs["nrmse"] < 1e-6
    np.testing.assert_allclose(found.attrs["y_peak"], np.abs(y).max(), rtol=1e-6)
    assert found.attrs["extrapolation"] == pytest.approx(1.0, rel=1e-6)
    assert warnings_of(found) == []
    assert {"model_magnitude", "measured_magnitude"} <= set(found.data_vars)  # in frequency too
    assert found["model_band"].attrs["units"] == "m/s"


def test_a_gaussian_gain_has_the_band_of_its_closed_form():
    test, sigma = a_test(0.1, noise=0.02, repeats=4), 0.02
    clean = a_test(0.1).records[0].channels["velocity"]
    tree = a_tree(spread(), noise={"sweep": sigma}, seen=[test])
    found = predict(basis_of(tree), test, Request(400))
    low, middle, high = found["predictive_band"].values
    width = Z * np.sqrt((0.01 * clean) ** 2 + sigma**2)
    np.testing.assert_allclose(high - middle, width, rtol=1e-3)
    np.testing.assert_allclose(middle - low, width, rtol=1e-3)
    # Quantiles of 400 draws at the tail: off by a tenth of the spacing of the last two.
    alone = found["model_band"].values
    np.testing.assert_allclose(alone[2] - alone[1], Z * 0.01 * np.abs(clean), rtol=0.05, atol=1e-6)
    assert found.attrs["noise"] == OWN
    # Four standard errors of a share; the mean of the repeats is off by half the noise.
    count = found.attrs["num_values"]
    assert count == 4 * SIZE
    assert abs(found.attrs["coverage"] - 0.99) < 4 * np.sqrt(0.99 * 0.01 / count)
    left = 0.5 * sigma * np.sqrt(SIZE)
    expected = left / np.hypot(left, np.linalg.norm(clean))
    assert found.attrs["nrmse"] == pytest.approx(expected, rel=4 / np.sqrt(2 * SIZE))


def test_noise_is_of_its_kind_or_said_not_to_be_known():
    test = a_test(0.01, noise=0.02, name="new")
    fitted = a_test(0.02, name="old")
    basis = basis_of(a_tree(same(SILENT), noise={"old": 0.02}, seen=[fitted]))
    alike = predict(basis, test)
    assert (alike.attrs["noise"], alike.attrs["noise_std"]) == (ALIKE, 0.02)
    other = predict(basis, a_test(0.01, name="new", kind="multisine"))
    assert other.attrs["noise"] == UNKNOWN
    assert "predictive_band" not in other
    repeats = predict(basis, a_test(0.01, noise=0.02, repeats=3, name="new", kind="multisine"))
    assert repeats.attrs["noise"] == REPEATS
    assert repeats.attrs["noise_std"] == pytest.approx(0.02, rel=0.1)
    without = predict(basis, test, Request(noise=False))
    assert without.attrs["noise"] == LEFT_OUT
    assert "predictive_band" not in without
    assert without.attrs["coverage"] < 0.01  # draws that agree have no width


def test_a_level_beyond_what_was_fitted_is_flagged():
    test = a_test(0.02, name="strong")
    known = predict(basis_of(a_tree(same(SILENT))), a_test(0.01)).attrs["y_peak"][1]
    found = predict(basis_of(a_tree(same(SILENT), y_peak=known)), test)
    assert found.attrs["extrapolation"] == pytest.approx(2.0, rel=1e-9)  # a linear oscillator
    (said,) = warnings_of(found)
    assert all(part in said for part in ("`strong`", "2 times", "add a test of that level"))
    assert row_of(found)["beyond"]


def test_a_sweep_far_from_the_mode_is_said_to_hardly_move_it():
    basis = basis_of(a_tree(same(SILENT), seen=[a_test(0.01)]))
    found = predict(basis, planned_sweep(basis, (60.0, 90.0), 0.1, 3.0, FS))
    assert found.attrs["input_near_mode"] < 0.01
    assert "hardly moves the mode" in " ".join(warnings_of(found))
    assert not {"measured", "measured_band"} & set(found.data_vars)
    assert "coverage" not in found.attrs
    assert found.attrs["level_unit"] == "V"  # as the run's source


def test_a_source_in_another_unit_is_refused_unless_its_gain_is_stated():
    basis = basis_of(a_tree(same(SILENT), seen=[a_test(0.01)]))
    test = a_test(0.01, unit="N")
    with pytest.raises(DataError, match=r"`sweep` has its source in N, but .* per V") as caught:
        predict(basis, test)
    assert "modal_mass" in caught.value.remedy
    assert predict(basis, test, Request(gain=GAIN)).attrs["nrmse"] < 1e-3


def test_what_is_missing_is_named():
    draws = same(SILENT)
    del draws["gain"]
    with pytest.raises(DataError, match="lacks gain"):
        predict(basis_of(a_tree(draws)), a_test(0.01))
    with pytest.raises(ConfigError, match="at least 2"):
        predict(basis_of(a_tree(same(SILENT))), a_test(0.01), Request(1))
    with pytest.raises(DataError, match="no group /posterior"):
        basis_of(xr.DataTree())
    with pytest.raises(ConfigError, match="below fs/2"):
        planned_sweep(basis_of(a_tree(draws)), (10.0, 500.0), 0.1, 1.0, FS)
    with pytest.raises(ConfigError, match="`level` must be positive"):
        planned_tones(basis_of(a_tree(draws)), (10.0,), -1.0)


def test_a_study_predicts_by_name_or_by_test(tmp_path):
    test = a_test(0.01)
    campaign = Campaign("made up", tmp_path, (test,))
    study = Study(a_tree(same(SILENT), noise={"sweep": 1e-3}, seen=[test]), {}, campaign)
    by_name = study.predict("sweep")
    assert {"measured", "measured_band", "model_band", "predictive_band"} <= set(by_name.data_vars)
    xr.testing.assert_identical(by_name, study.predict(test))
    assert "predictive_band" not in study.predict(test, noise=False)
    with pytest.raises(ConfigError, match="Argument `test` must name") as caught:
        study.predict("swep")
    assert "sweep" in caught.value.remedy


def test_a_saved_study_is_loaded_and_predicts_the_same(tmp_path):
    test = a_test(0.01)
    finding = {"code": "series", "status": "failed", "reason": "R.", "number": None, "action": "A."}
    record = {"verdict": {"status": "failed", "findings": [finding]}, "steps": {}}
    made = Study(a_tree(same(SILENT), noise={"sweep": 1e-3}, seen=[test]), record)
    save_result(tmp_path, made.tree, record)
    loaded = load_study(tmp_path)
    # Stored as it was: the same arrays lead to the same bands to the last bit.
    xr.testing.assert_identical(loaded.predict(test), made.predict(test))
    assert loaded.verdict.status == "failed"
    assert np.isnan(loaded.verdict.findings[0].number)
    assert loaded.summary() == record
    with pytest.raises(ConfigError, match="campaign is not at hand"):
        loaded.predict("sweep")
    campaign = Campaign("made up", tmp_path, (test,))
    xr.testing.assert_identical(load_study(tmp_path, campaign).predict("sweep"), made.predict(test))
    with pytest.raises(DataError, match=r"no summary\.json"):
        load_study(tmp_path / "nowhere")


def test_a_run_writes_what_predictions_read_back(tmp_path):
    test = a_test(0.01)
    data = SimpleNamespace(scatter=np.array([0.3, 1e-3]), parts=())
    found: Any = SimpleNamespace(
        main=SimpleNamespace(held={"gain": 0.5}),
        data=data,
        decay_data=SimpleNamespace(worth=0.7, shift_std=0.02),
    )
    tree = a_tree(same(SILENT))
    tree.attrs.update(basis_attrs((test,), found))
    tree.to_netcdf(tmp_path / "posterior.nc", engine="h5netcdf")
    with xr.open_datatree(tmp_path / "posterior.nc", engine="h5netcdf") as stored:
        basis = basis_of(stored.load())
    assert basis.held == {"gain": 0.5}
    assert basis.seen == {"sweep": ("sweep", "V", "velocity")}
    assert basis.scatter == (0.3, 1e-3)
    assert basis.decay_facts == {"worth": 0.7, "shift_std": 0.02}


def test_held_out_tests_of_a_run_say_how_far_they_reach():
    quantiles = ("quantile", "time")
    sweep = xr.Dataset(
        {"model_band": (quantiles, 0.5 * np.ones((3, 4)))},
        attrs={"fitted": 0, "response": "velocity"},
    )
    fitted = sweep.assign_attrs(fitted=1)
    held = xr.Dataset(
        {"model_magnitude": (("quantile", "freq"), np.ones((3, 2)))},
        {"freq": [10.0, 20.0]},
        {"fitted": 0, "quantity": "force", "held": "acceleration", "level": 8.0},
    )
    groups = {
        "/verification/sweep/a": sweep,
        "/verification/sweep/b": fitted,
        "/verification/curve/c": held,
    }
    mark_reach(groups, [], 2e-3, 100.0)
    assert sweep.attrs["extrapolation"] == pytest.approx(0.5 / 100.0 / 2e-3)
    assert "extrapolation" not in fitted.attrs
    assert held.attrs["extrapolation"] == pytest.approx(8.0 / (20 * np.pi) ** 2 / 2e-3)
