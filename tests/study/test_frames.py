"""Data frames of a study: the numbers of its record and its tree, by name."""

import numpy as np
import pytest
import xarray as xr

from jbw.errors import ConfigError, DataError
from jbw.study.study import Study, load_study


@pytest.fixture(scope="module")
def study(toy):
    return load_study(toy / "run")


def test_parameters_are_those_of_the_draws(study):
    table = study.table()
    draws = study.tree["posterior"].to_dataset()
    assert table.index.name == "parameter"
    assert {"omega_n", "zeta", "alpha", "delta", "gamma", "alpha_delta"} <= set(table.index)
    for name in ("omega_n", "gamma"):
        values = draws[name].values.ravel()
        # The same draws; a weighted summary may differ by round-off alone.
        assert table.loc[name, "mean"] == pytest.approx(values.mean(), rel=1e-9)
        assert table.loc[name, "q005"] == pytest.approx(np.quantile(values, 0.005), rel=1e-9)
    assert table.loc["omega_n", "unit"] == "rad/s"
    assert table["mean"].dtype == float
    assert study.table("joint").equals(table)


def test_a_step_that_was_not_taken_is_named(study):
    with pytest.raises(ConfigError, match=r"'jont'.*[\s\S]*Did you mean `joint`"):
        study.table("jont")


def test_the_backbone_has_bands_and_ends_of_what_was_fitted(study):
    backbone = study.backbone()
    group = study.tree["verification/backbone"].to_dataset()
    np.testing.assert_array_equal(backbone.index, group["amplitude"])
    np.testing.assert_array_equal(backbone["frequency_hz"], group["frequency"].sel(quantile=0.5))
    assert np.all(backbone["damping_low"] <= backbone["damping_high"])
    assert backbone.index[backbone["fitted"]].max() == pytest.approx(group.attrs["y_fitted"])
    assert not backbone["fitted"].iloc[-1]
    # To first order the frequency falls by alpha delta Y, and delta is positive.
    assert backbone["frequency_hz"].is_monotonic_decreasing


def test_the_backbones_of_several_joints_have_a_mode_before_the_amplitude():
    bands = ("mode", "amplitude", "quantile"), np.arange(12.0).reshape(2, 2, 3)
    group = xr.Dataset(
        {
            "displacement": (("mode", "amplitude"), [[1e-4, 2e-4], [3e-4, 4e-4]]),
            "frequency_hz": bands,
            "damping": bands,
        },
        {"mode": [1, 3]},
    )
    backbone = Study(xr.DataTree.from_dict({"/backbones": group}), {}).backbone()
    assert backbone.index.names == ["mode", "amplitude_m"]
    assert backbone.loc[(3, 4e-4), "frequency_hz"] == 10.0
    assert backbone.loc[(1, 1e-4), "damping_high"] == 2.0


def test_a_study_without_a_backbone_says_so():
    with pytest.raises(DataError, match="no backbone"):
        Study(xr.DataTree(), {}).backbone()


def test_predictions_have_a_row_per_test(study):
    predictions = study.predictions()
    assert sorted(predictions.index) == ["pull", "strong", "weak"]
    assert predictions.loc["weak", "nrmse"] == study.record["predictions"]["weak"]["nrmse"]
    assert predictions["fitted"].tolist() == [
        row["fitted"] for row in study.record["predictions"].values()
    ]
    assert np.isnan(predictions.loc["strong", "extrapolation"])
    assert len(Study(xr.DataTree(), {}).predictions()) == 0
