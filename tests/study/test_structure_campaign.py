"""Two modes with one joint, swept by the rig and identified from the campaign's file."""

from dataclasses import replace

import numpy as np
import pytest
from two_modes import at_two_points, swept, truth, truth_at_wing

import jbw
from jbw import rig
from jbw.errors import DataError

# Importance sampling compiles least; the middle level of either mode is predicted.
SETTINGS = {
    "sampler": "importance", "num_chains": 2, "num_samples": 250, "substeps": 4,
    "hold_out": ("low_1", "high_1"), "model_error": "none",
}  # fmt: skip


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """Of two levels of each mode, written and read again."""
    taken = swept(["low_0", "low_1", "low_2", "high_0", "high_1", "high_2"])
    path = rig.write(taken, tmp_path_factory.mktemp("two_modes") / "campaign")
    loaded = jbw.load_campaign(path)
    assert loaded.structure == taken.structure
    campaign = replace(loaded, settings=loaded.settings.model_copy(update=SETTINGS))
    return jbw.identify(campaign, seed=1, report=lambda _: None)


@pytest.mark.release  # test_two_bolts.py has two modes from a file on
def test_the_truth_of_both_modes_lies_in_the_posterior(study):
    posterior, true = study.tree["posterior"].to_dataset(), truth()
    names = [name for name in true if name in posterior]
    assert {"omega_n", "omega_2", "zeta_2", "gain_ratio_2", "shape_2", "coupling_2"} <= {*names}
    for name in names:
        low, high = np.quantile(posterior[name], [0.005, 0.995])
        assert low < true[name] < high, f"{name}: {low:.6g} {true[name]:.6g} {high:.6g}"
    # As section 2.2 of the theory promises of both modes swept beyond delta x = 0.3.
    for name in ("shape_2", "coupling_2", "delta"):
        assert posterior[name].std() < 0.03 * true[name]
    said = study.record["steps"]["joint"]["statements"]
    said_of_motion = ("moves the joint h = -1.1", "sign of h is determined")
    assert any(all(words in one for words in said_of_motion) for one in said)


@pytest.mark.release  # test_two_bolts.py has two modes from a file on
def test_a_level_that_no_fit_saw_is_predicted_to_its_noise(study):
    for test in ("low_1", "high_1"):
        attrs = study.tree[f"verification/sweep/{test}"].attrs
        assert attrs["fitted"] == 0
        # One per cent of noise, over the root of two repeats.
        assert attrs["nrmse"] == pytest.approx(0.01 / np.sqrt(2), rel=0.15)
        assert attrs["coverage"] > 0.97
        assert attrs["nrmse"] < 0.5 * attrs["nrmse_linear"]


@pytest.mark.release  # a second campaign of two modes
def test_two_points_tell_the_shapes_there_and_of_a_test_that_was_held_out():
    taken = at_two_points(["low_0", "low_2", "high_0", "high_2"])
    own = {**SETTINGS, "hold_out": ("low_0 at wing", "high_0")}
    campaign = replace(taken, settings=taken.settings.model_copy(update=own))
    study = jbw.identify(campaign, seed=1, report=lambda _: None)
    posterior, true = study.tree["posterior"].to_dataset(), truth() | truth_at_wing()
    for name in ("omega_2", "shape_2", "coupling_2", "delta", "point_2_1", "point_2_2"):
        low, high = np.quantile(posterior[name], [0.005, 0.995])
        assert low < true[name] < high, f"{name}: {low:.6g} {true[name]:.6g} {high:.6g}"
        assert posterior[name].std() < 0.03 * abs(true[name])
    for test in own["hold_out"]:
        attrs = study.tree[f"verification/sweep/{test}"].attrs
        assert attrs["nrmse"] == pytest.approx(0.01 / np.sqrt(2), rel=0.15)
    with pytest.raises(DataError, match="is measured at `nose`, but the run has wing"):
        study.predict(replace(taken.tests[0], point="nose"))
