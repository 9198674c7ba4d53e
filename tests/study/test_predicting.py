"""Predictions from a run's posterior, against integrations and closed forms made without jbw."""

from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from dialect import unreadable_units
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

from jbw.campaign.load import Campaign
from jbw.errors import ConfigError, DataError
from jbw.identification.discrepancy import NO_SCATTER, Discrepancy, Missed, Scatter
from jbw.measurement.records import Test
from jbw.report.result import read_result
from jbw.run.netcdf import read_tree, write_tree
from jbw.study.collect import run_attrs
from jbw.study.store import save_result
from jbw.study.study import Study, basis_of_run, load_study
from jbw.verification.planned import planned_sweep, planned_tones
from jbw.verification.predict import Request, predict, row_of, warnings_of
from jbw.verification.predicted import (
    ALIKE,
    LEFT_OUT,
    NOT_KNOWN,
    OWN,
    REPEATS,
    UNKNOWN,
    Predicted,
    RepeatNoise,
    noise_of,
)
from jbw.verification.predictive_basis import AS_RECORDED, GROUPS_OF_BASIS, basis_of


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


def test_a_model_discrepancy_widens_the_band_about_the_law_s_own_prediction():
    """A measured frequency 1 % off: the error is that of the law, by two linear oscillators."""
    off = {**SILENT, "omega_n": 1.01 * SILENT["omega_n"]}
    measured = integrated(burst(0.3), off, np.arange(SIZE) / FS)[1]
    by_law = a_test(0.3).records[0].channels["velocity"]
    error = np.linalg.norm(measured - by_law) / np.linalg.norm(measured)
    test, fitted = a_test(0.3, off, name="unseen"), a_test(0.2)
    bare = basis_of(a_tree(same(SILENT, 200), noise={"sweep": 1e-4}, seen=[fitted]))
    missed = Missed(Scatter(0.02), NO_SCATTER)
    misses = replace(bare, discrepancy=Discrepancy(missed, missed, {}, 1e-9, 1.0))
    before, after = (predict(basis, test, Request(200)) for basis in (bare, misses))
    # The input is straight between 32 points a sample: off by (omega h)^2 / 12 = 2e-5 of it.
    assert before.attrs["nrmse"] == pytest.approx(error, rel=1e-4)
    assert after.attrs["nrmse"] == pytest.approx(error, rel=1e-4)
    assert float(after["nrmse_of_repeat"][0]) == pytest.approx(error, rel=1e-4)
    assert after.attrs["half_width"] > 5 * before.attrs["half_width"]
    assert before.attrs["coverage"] < 0.2 < 0.99 < after.attrs["coverage"]
    # The middle of the bands is what the law predicts; frequencies that scatter would shrink it.
    for name in ("model_band", "predictive_band"):
        np.testing.assert_allclose(after[name][1], before[name][1], atol=1e-12)


def test_repeats_are_named_and_their_numbers_are_variables():
    """Three repeats of a linear oscillator with noise: the error of each by hand."""
    test = a_test(0.3, noise=0.02, repeats=3)
    named = [replace(one, name=f"sweep_{i}.h5") for i, one in enumerate(test.records)]
    found = predict(basis_of(a_tree(same(SILENT), noise={"sweep": 0.02}, seen=[test])),
                    replace(test, records=tuple(named)))  # fmt: skip
    assert found["repeat"].values.tolist() == ["sweep_0.h5", "sweep_1.h5", "sweep_2.h5"]
    model = found["model_band"].values[1]
    for i, record in enumerate(named):
        x = record.channels["velocity"]
        expected = np.linalg.norm(x - model) / np.linalg.norm(x)
        assert float(found["nrmse_of_repeat"].sel(repeat=record.name)) == pytest.approx(expected)
        assert float(found["nrmse_of_repeat"][i]) > float(found.attrs["nrmse"])  # of the mean
    np.testing.assert_array_equal(found["peak_displacement"], found.attrs["y_peak"])
    assert unreadable_units(xr.DataTree(found)) == {}
    # Records in memory have no names, and are numbered.
    assert predict(basis_of(a_tree(same(SILENT))), test)["repeat"].values.tolist() == [*"123"]
    planned = predict(basis_of(a_tree(same(SILENT), seen=[test])),
                      planned_sweep(basis_of(a_tree(same(SILENT), seen=[test])), (14, 24), 0.2,
                                    4.0, FS))  # fmt: skip
    assert not [name for name in planned.variables if "nrmse" in str(name) or name == "repeat"]


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
    assert all(part in said for part in ("`strong`", "2 times", "Add a test of that level"))
    assert row_of(found)["beyond"]


def test_a_sweep_far_from_the_mode_is_said_to_hardly_move_it():
    basis = basis_of(a_tree(same(SILENT), seen=[a_test(0.01)]))
    found = predict(basis, planned_sweep(basis, (60.0, 90.0), 0.1, 3.0, FS))
    assert found.attrs["input_near_mode"] < 0.01
    assert "hardly moves the identified mode" in " ".join(warnings_of(found))
    assert not {"measured", "measured_band"} & set(found.data_vars)
    assert "coverage" not in found.attrs
    assert found.attrs["level_unit"] == "V"  # as the run's source


def test_a_source_in_another_unit_is_refused_unless_its_gain_is_stated():
    basis = basis_of(a_tree(same(SILENT), seen=[a_test(0.01)]))
    test = a_test(0.01, unit="N")
    with pytest.raises(DataError, match=r"`sweep` has the unit N, but .* per V") as caught:
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


def test_a_study_plans_a_sweep_that_it_predicts():
    study = Study(a_tree(same(SILENT), noise={"sweep": 1e-3}, seen=[a_test(0.01)]), {})
    planned = study.planned_sweep((14.0, 24.0), 0.01, duration=3.0, fs=FS)
    given = planned.records[0].channels["input"]
    assert np.abs(given).max() == pytest.approx(0.01, rel=1e-2)  # its top may lie between samples
    assert study.predict(planned).attrs["level_unit"] == "V"
    with pytest.raises(ConfigError, match="below fs/2"):
        study.planned_sweep((14.0, FS), 0.01, duration=3.0, fs=FS)


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
    with pytest.raises(ConfigError, match="campaign of the run is not available"):
        loaded.predict("sweep")
    campaign = Campaign("made up", tmp_path, (test,))
    xr.testing.assert_identical(load_study(tmp_path, campaign).predict("sweep"), made.predict(test))
    with pytest.raises(DataError, match=r"no summary\.json"):
        load_study(tmp_path / "nowhere")


def test_a_run_writes_what_predictions_read_back(tmp_path):
    test, tree = a_test(0.01), a_tree(same(SILENT))
    data = SimpleNamespace(parts=(), scatter=(0.3, 1e-3), laws=("bouc_wen",), modes=None)
    decays = SimpleNamespace(fraction=0.7, shift_std=0.02, substeps=3)
    draws = tree["posterior"].to_dataset()
    joint = SimpleNamespace(draws=draws, held={"gain": 0.5}, fitted=SimpleNamespace(data=data))
    tree.attrs = run_attrs([test], joint, decays)  # pyright: ignore
    tree.to_netcdf(tmp_path / "posterior.nc", engine="h5netcdf")
    with xr.open_datatree(tmp_path / "posterior.nc", engine="h5netcdf") as stored:
        basis = basis_of(stored.load())
    assert basis.held == {"gain": 0.5}
    assert basis.seen == {"sweep": ("sweep", "V", "velocity", 0.01, "", "voltage", "")}
    assert basis.scatter == (0.3, 1e-3)
    assert basis.decay_facts.plain() == {"worth": 0.7, "shift_std": 0.02, "substeps": 3}
    assert basis.laws == ("bouc_wen",)


def test_all_that_predictions_start_from_is_read(toy, tmp_path):
    """Predictions read some groups of a run, which give the same basis as all groups."""
    _, run = read_result(toy / "run")
    draws = run["posterior"].to_dataset()
    run[AS_RECORDED], run["steps/decay/posterior"] = xr.DataTree(draws + 1), xr.DataTree(draws + 2)
    write_tree(tmp_path / "posterior.nc", run)
    some = read_tree(tmp_path / "posterior.nc", *GROUPS_OF_BASIS)
    assert "verification" not in some.children
    found, expected = basis_of(some), basis_of(run)
    for field in fields(expected):
        part, same_part = getattr(found, field.name), getattr(expected, field.name)
        if isinstance(same_part, xr.Dataset):
            xr.testing.assert_identical(part, same_part)
        else:
            assert part == same_part, field.name
    assert basis_of_run(toy / "run").laws == expected.laws


def test_a_prediction_reaches_as_far_as_the_edge_of_its_peaks():
    basis = basis_of(a_tree(same(SILENT), y_peak=2e-3))
    peaks = np.linspace(1e-3, 3e-3, 201)
    found = Predicted(xr.Dataset(), peaks, NOT_KNOWN)
    assert found.extrapolation(basis) == pytest.approx((3e-3 - 0.005 * 2e-3) / 2e-3)
    assert Predicted(xr.Dataset(), None, NOT_KNOWN).extrapolation(basis) is None
    assert found.extrapolation(basis_of(a_tree(same(SILENT), y_peak=0.0))) is None


@pytest.mark.parametrize(("reached", "said"), [(1.04, 0), (1.06, 1)])
def test_five_percent_beyond_what_was_fitted_is_said(reached, said):
    attrs = {"test": "t", "extrapolation": reached, "y_peak": np.ones(3), "y_peak_fitted": 1.0}
    assert len(warnings_of(xr.Dataset(attrs=attrs))) == said
    assert row_of(xr.Dataset(attrs=attrs))["beyond"] == bool(said)


def test_the_noise_of_a_harmonic_is_of_its_order_and_where_there_is_one_of_its_level():
    tones = [
        Test("tones", a_test(0.1).records, f"tone {f:g} at {level:g}", level=level, tones_hz=(f,))
        for level in (1.0, 2.0)
        for f in (5.0, 6.0)
    ]
    known = {"tones 1 order 1": 0.1, "tones 1 order 3": 0.01, "tones 2 order 1": 0.3}
    basis = basis_of(a_tree(same(SILENT), noise=known, seen=tones))
    assert noise_of(basis, tones[0], order=1) == (0.1, ALIKE)
    assert noise_of(basis, tones[0], order=3) == (0.01, ALIKE)
    assert noise_of(basis, tones[0], label="tones 1 order 1", order=1) == (0.1, OWN)
    other = replace(tones[0], name="new", level=5.0)
    assert noise_of(basis, other, order=1) == (pytest.approx(0.2), ALIKE)
    assert noise_of(basis, other, RepeatNoise(0.7, REPEATS), order=1) == (0.7, REPEATS)
    # A sweep called as a tone is, with a number of its own, has another noise.
    assert noise_of(basis, replace(other, kind="stepped"), order=1) == NOT_KNOWN
