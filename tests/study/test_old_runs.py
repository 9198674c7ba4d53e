"""Runs that version 0.1 wrote: its units, its facts of tests, no names of laws."""

import json

import numpy as np
import pytest
import xarray as xr
from made_runs import GAIN, JOINT, SILENT, a_test, same

from jbw.errors import DataError
from jbw.export.one_joint import export
from jbw.study.store import save_report
from jbw.study.study import load_study
from jbw.verification.predicted import ALIKE, OWN

OLD = {"omega_n": "rad s-1", "zeta": "1", "alpha": "s-2", "delta": "m-1", "gamma": "m-1"}
TESTS = {"sweep": {"kind": "sweep", "source": "V", "response": "velocity"}}


def old_run(folder, draws, **attrs):
    """A folder as 3c7f4fa left it: posterior.nc with its groups and attributes, summary.json."""
    posterior = xr.Dataset(
        {
            name: (("chain", "draw"), values.reshape(2, -1), {"units": OLD.get(name, "")})
            for name, values in draws.items()
        }
    )
    noise = np.full((2, posterior.sizes["draw"], 1), 2e-3)
    posterior["noise_std"] = (("chain", "draw", "level"), noise, {"units": "m s-1"})
    posterior = posterior.assign_coords(level=["sweep"])
    time, quantile = np.arange(8) / 256.0, [0.005, 0.5, 0.995]
    wide = (("quantile", "time"), np.linspace(-1, 1, 24).reshape(3, 8), {"units": "m s-1"})
    sweep = xr.Dataset(
        {
            "measured": ("time", np.linspace(-1, 1, 8), {"units": "m s-1"}),
            **{name: wide for name in ("measured_band", "model_band", "predictive_band")},
        },
        {"time": time, "quantile": quantile},
        {"level": 0.01, "level_unit": "V", "response": "velocity", "fitted": 1, "nrmse": 0.1},
    )
    tree = xr.DataTree.from_dict({"/posterior": posterior, "/verification/sweep/sweep": sweep})
    facts = {"tests": json.dumps(TESTS), "held": json.dumps({"gain": GAIN}), "substeps": 2}
    tree.attrs = {"sampler": "nuts", "y_peak": 1e-3, **facts, **attrs}
    tree.to_netcdf(folder / "posterior.nc", engine="h5netcdf")
    record = {
        "campaign": "old", "verdict": {"status": "ok", "findings": []}, "main": "joint",
        "steps": {}, "predictions": {}, "loops": {}, "comparison": {}, "seed": 0, "inputs": {},
        "command": "jbw identify", "wall_time_s": 1.0, "versions": {"jbw": "0.1.0"},
    }  # fmt: skip
    (folder / "summary.json").write_text(json.dumps(record))
    return folder


def drawn(**more):
    draws = same(SILENT, **more)
    del draws["gain"]
    return draws


def test_an_old_run_still_predicts(tmp_path):
    study = load_study(old_run(tmp_path, drawn()))
    seen, new = a_test(0.01), a_test(0.02, name="new")
    assert study.predict(seen).attrs["noise"] == OWN
    found = study.predict(new)
    assert found.attrs["nrmse"] < 1e-3  # the source's convolution is good to 1e-4
    assert (found.attrs["noise"], found.attrs["noise_std"]) == (ALIKE, pytest.approx(2e-3))


def test_an_old_run_with_a_cubic_spring_still_has_it(tmp_path):
    weak = load_study(old_run(tmp_path, drawn(cubic=0.0))).predict(a_test(0.01))
    (other := tmp_path / "stiff").mkdir()
    stiff = load_study(old_run(other, drawn(cubic=1e9))).predict(a_test(0.01))
    assert stiff.attrs["nrmse"] > 10 * weak.attrs["nrmse"]


def test_an_old_run_is_still_reported_and_exported(tmp_path):
    draws = {name: np.full(4, value) for name, value in {**JOINT, "gain": GAIN}.items()}
    study = load_study(old_run(tmp_path, draws))
    save_report(tmp_path, study.tree, study.result)
    assert "old" in (tmp_path / "report.html").read_text(encoding="utf-8")
    with pytest.raises(DataError, match="lacks the log density of its draws") as caught:
        export(study.tree)
    assert "--draw" in caught.value.remedy
    found = export(study.tree, draw=3)
    rows = {row["parameter"]: row for row in found.parameters if row["unit"]}
    assert rows["omega_n"]["value"] == pytest.approx(JOINT["omega_n"])


def changed_summary(folder, **entries):
    """An old run whose summary has other entries."""
    old_run(folder, drawn())
    record = json.loads((folder / "summary.json").read_text()) | entries
    (folder / "summary.json").write_text(json.dumps(record))
    return record


def test_entries_of_another_version_are_kept_and_nulls_are_defaults(tmp_path):
    step = {"parameters": {"zeta": {"mean": 0.01, "shade": "dark"}}, "colour": None}
    record = changed_summary(tmp_path, hue=[1, {"a": None}], steps={"joint": step})
    study = load_study(tmp_path)
    assert study.record == record
    assert study.result.parameters["zeta"].mean == 0.01
    changed_summary(tmp_path, look=None, tests=None, verdict={"status": "ok", "findings": None})
    study = load_study(tmp_path)
    assert (study.result.look.tests, study.result.verdict.against) == ([], [])


def test_a_summary_that_cannot_be_read_names_the_entry_and_the_version(tmp_path):
    changed_summary(tmp_path, seed="seven")
    with pytest.raises(DataError, match=r"cannot be read: seed: ") as caught:
        load_study(tmp_path)
    assert "version 0.1.0" in caught.value.why


def test_a_run_that_cannot_be_read_says_which_version_made_it(tmp_path):
    tests = json.dumps({"sweep": {**TESTS["sweep"], "colour": "blue"}})
    with pytest.raises(DataError, match=r"cannot be read: .*colour") as caught:
        load_study(old_run(tmp_path, drawn(), tests=tests))
    assert "version 0.1.0" in caught.value.why
    assert "identify again" in caught.value.remedy
