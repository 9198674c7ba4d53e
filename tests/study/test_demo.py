"""The whole demonstration, as a user runs it."""

import json

import pytest
import xarray as xr

from jbw.cli import run


@pytest.mark.slow
def test_demo_from_the_first_record_to_the_report(tmp_path, capsys):
    folder = tmp_path / "demo"
    assert run(["demo", "--out", str(folder)]) == 0
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["verdict"]["status"] == "ok"
    joint = summary["steps"]["joint"]["parameters"]
    for name in ("omega_n", "zeta", "alpha", "delta", "gamma", "gain"):
        assert joint[name]["r_hat"] < 1.01
        assert joint[name]["ess_bulk"] >= 400
        assert abs(joint[name]["z"]) < 4
    # Step 3 by the paper is expected to fail, and to say why.
    assert summary["steps"]["third_order_paper"]["verdict"]["status"] == "failed"
    assert any("alpha*delta" in s for s in summary["steps"]["third_order_paper"]["statements"])
    # 99 % bands over held-out repeats and levels never fitted, some of only ten values: four
    # standard errors of the share inside, and 0.5 % for the noise, which is itself estimated.
    for row in summary["predictions"].values():
        assert abs(row["coverage"] - 0.99) < 0.005 + 4 * (0.99 * 0.01 / row["num_values"]) ** 0.5
    assert {row["fitted"] for row in summary["predictions"].values()} == {True, False}
    for areas in summary["loops"].values():
        low, _, high = areas["model_area_viscous"]
        measured = areas["measured_area_viscous"][1]
        # Noise of the measured loop: 4 repeats of 16 s, differentiated; below 0.1 % of the area.
        assert 0.999 * low < measured < 1.001 * high
    with xr.open_datatree(folder / "posterior.nc", engine="h5netcdf") as tree:
        assert {"posterior", "sample_stats", "log_likelihood", "log_prior"} <= set(tree.children)
    assert len(list((folder / "figures").glob("*.png"))) >= 10
    assert "Report:" in capsys.readouterr().out
