"""A joint of sliders, measured by the rig and identified from the campaign's file to the export."""

import json
from dataclasses import replace

import numpy as np
import pytest
from exported import column, rows

import jbw
from jbw import rig
from jbw.cli import run

# A second whole campaign: test_guests.py has one of another law, from records to the export.
pytestmark = [pytest.mark.release, pytest.mark.filterwarnings("ignore")]

TESTS = ["sweep_1p50N", "sweep_6p00N", "pull_4p00mm"]
# Importance sampling compiles least; of three levels of sweeps the rig's campaign fits two.
SETTINGS = {
    "sampler": "importance", "num_chains": 2, "num_samples": 200, "substeps": 2,
    "offsets": "none", "fit_levels": (1.5, 6.0), "fit_repeats": 2,
}  # fmt: skip


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The study, the truth and the folder of its run."""
    folder = tmp_path_factory.mktemp("sliders")
    measured = rig.measure("mixed", joint=rig.SLIDERS, tests=TESTS, repeats=4, seed=2)
    path = rig.write(measured, folder / "campaign")
    truth = json.loads((path.parent / "truth.json").read_text(encoding="utf-8"))
    loaded = jbw.load_campaign(path)
    campaign = replace(loaded, settings=loaded.settings.model_copy(update=SETTINGS))
    truth = {**truth["joint"], "gain": truth["gain"]}
    study = jbw.identify(campaign, seed=1, truth=truth, report=lambda _: None)
    study.save(folder / "run")
    return study, truth, folder / "run"


def test_the_truth_lies_in_the_posterior(finished):
    study, truth, _ = finished
    posterior = study.tree["posterior"].to_dataset()
    assert json.loads(study.tree.attrs["laws"]) == ["jenkins_3"]
    names = [name for name in truth if name in posterior]
    assert {"omega_n", "zeta", "stiffness_1", "slip_1", "slip_ratio_3"} <= {*names}
    for name in names:
        z = (posterior[name].mean() - truth[name]) / posterior[name].std()
        assert abs(z) < 4, f"{name}: {z:.1f}"
    assert posterior["stiffness_1"].std() < 0.2 * truth["stiffness_1"]
    for test in ("sweep/sweep_1p50N", "sweep/sweep_6p00N"):
        attrs = study.tree[f"verification/{test}"].attrs
        assert attrs["coverage"] > 0.95
        assert attrs["nrmse"] < attrs["nrmse_linear"]


def test_the_run_is_reported_and_exported(finished):
    study, _, folder = finished
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "Jenkins array" in page
    assert "stiffness of slider 2" in page
    assert "α₁" in page
    assert run(["export", str(folder)]) == 0
    table = {row["parameter"]: row for row in rows(folder / "export" / "parameters.csv")}
    draws = study.tree["posterior"]["slip_1"].values
    assert float(table["slip_1"]["value"]) in draws
    assert float(table["slip_1"]["q500"]) == pytest.approx(np.median(draws), rel=1e-12)
    frequency = column(folder / "export" / "backbone.csv", "frequency_hz_q500")
    # All stick below the first slip, and soften from there on.
    assert np.all(np.diff(frequency) < 1e-9)
    assert frequency[-1] < 0.99 * frequency[0]
    assert (folder / "export" / "jbw.mat").is_file()
