"""Names as people write them, through what is written of a run and read again."""

import tempfile
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from hypothesis import example, given, settings
from hypothesis import strategies as st

from jbw.report.result import read_result, verified
from jbw.study.store import save_predictions, save_result
from jbw.verification.places import place, safe

PRINTABLE = st.text(
    st.characters(blacklist_categories=("Cc", "Cs", "Cn", "Co")), min_size=1, max_size=40
).filter(lambda name: name.isprintable() and name.strip())
TIME = {"time": ("time", np.arange(8.0), {"units": "s"})}
QUANTILES = ("quantile", np.array([0.005, 0.5, 0.995]))


def compared(name):
    """A sweep beside its bands, as a run stores it."""
    wave = np.sin(np.arange(8.0))
    unit = {"units": "m/s", "long_name": "velocity"}
    bands = ("quantile", "time"), np.stack([wave - 1, wave, wave + 1]), unit
    variables = {"measured": ("time", wave, unit), "model_band": bands, "predictive_band": bands}
    attrs = {
        "level": 1.0, "level_unit": "V", "fitted": 0, "nrmse": 0.1, "coverage": 1.0,
        "response": "velocity", "test": name, "kind": "sweep", "num_repeats": 1, "noise": "",
    }  # fmt: skip
    return xr.Dataset(variables, {**TIME, "quantile": QUANTILES}, attrs)


@settings(max_examples=25, deadline=None)
@given(name=PRINTABLE)
@example("noise 4 mV/rms")
@example("weak <1> & 'ü'")
@example('strong $x_/\\"q"')
@example("../pull:%s{0} ß 一")
@example(".")
@example("..")
@example("$")
@example("</script><b>")
def test_any_printable_name_is_written_and_read_again(name):
    draws = (("chain", "draw"), np.arange(8.0).reshape(2, 4), {"units": "1"})
    density = xr.Dataset({safe(f"line fit of {name}"): draws, safe(name): draws})
    tree = xr.DataTree.from_dict(
        {
            "/": xr.Dataset(attrs={"laws": '["bouc_wen"]'}),
            "/posterior": xr.Dataset({"gamma": draws}),
            "/log_prior": density,
            place("verification/sweep", name): compared(name),
            place("look", name): xr.Dataset(attrs={"test": name}),
        }
    )
    summary = {"campaign": name, "steps": {}, "verdict": {}, "predictions": {name: {"kind": name}}}
    with tempfile.TemporaryDirectory() as folder:
        save_result(Path(folder), tree, summary)
        found, stored = read_result(Path(folder))
    assert found.plain() == summary
    ((group, called, test),) = verified(stored, "nrmse")
    assert (group, called, test.attrs["test"]) == ("sweep", safe(name), name)
    np.testing.assert_array_equal(test["measured"], np.sin(np.arange(8.0)))
    assert set(stored["log_prior"].data_vars) == {safe(f"line fit of {name}"), safe(name)}


@pytest.mark.parametrize("name", ["a/b $x_ <i>", '"ü"', "..", "%s{0}"])
def test_predictions_of_any_name_are_drawn_and_written(tmp_path, name):
    save_predictions(tmp_path, {name: compared(name)}, [{"test": name}])
    assert len(list((tmp_path / "figures").glob("*.png"))) == 1
    with xr.open_datatree(tmp_path / "predictions.nc", engine="h5netcdf") as stored:
        assert list(stored.children) == [safe(name)]
