"""The command `jbw predict`: a run and a campaign in, bands, table and figures out."""

import json
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.signal import lsim

from jbw.cli import run
from jbw.measurement.files.hdf5 import write_hdf5
from jbw.measurement.records import Record

OMEGA_N, ZETA, GAIN, FS = 118.0, 0.05, 15.0, 256.0
NOISE = 1e-3
CAMPAIGN = """\
[campaign]
name = "another day"
{gain}
[[test]]
name = "weak"
kind = "sweep"
files = "weak_*.h5"
level = 0.1
channels = {{ {role} = "{role}", velocity = "velocity" }}
units = {{ {role} = "{unit}", velocity = "m/s" }}

[[test]]
name = "strong"
kind = "sweep"
files = "strong_*.h5"
level = 0.2
channels = {{ {role} = "{role}", velocity = "velocity" }}
units = {{ {role} = "{unit}", velocity = "m/s" }}
"""


def motion(level, size=1024):
    """A tone burst, and displacement and velocity that a linear oscillator makes of it."""
    t = np.arange(32 * size) / (32 * FS)
    u = level * np.sin(2 * np.pi * 18.0 * t) * np.sin(np.pi * t * FS / size) ** 4
    below = [1.0, 2 * ZETA * OMEGA_N, OMEGA_N**2]
    y, v = (lsim((above, below), u, t)[1][::32] for above in ([GAIN], [GAIN, 0.0]))
    return u[::32], y, v


def write_campaign(folder, role="input", unit="V", gain=""):
    rng = np.random.default_rng(2)
    for name, level in (("weak", 0.1), ("strong", 0.2)):
        u, _, v = motion(level)
        for i in range(2):
            samples = {role: u, "velocity": v + NOISE * rng.standard_normal(len(v))}
            write_hdf5(
                folder / f"{name}_{i}.h5", Record(FS, samples, {role: unit, "velocity": "m/s"})
            )
    path = folder / "campaign.toml"
    path.write_text(CAMPAIGN.format(role=role, unit=unit, gain=gain))
    return path


@pytest.fixture
def finished(tmp_path):
    """The folder of a run on a linear oscillator, and a campaign that it never saw."""
    folder = tmp_path / "run"
    folder.mkdir()
    values = dict(omega_n=OMEGA_N, zeta=ZETA, alpha=1e-6, delta=1.0, gamma=1.0, gain=GAIN)
    draws: dict[str, Any] = {
        name: (("chain", "draw"), np.full((2, 4), value)) for name, value in values.items()
    }
    draws["noise_std"] = (("chain", "draw", "level"), np.full((2, 4, 1), NOISE))
    posterior = xr.Dataset(draws, {"level": ["fitted"]})
    tree = xr.DataTree.from_dict({"/": xr.Dataset(), "/posterior": posterior})
    y = motion(0.1)[1]
    seen = {"fitted": {"kind": "sweep", "source": "V", "response": "velocity"}}
    tree.attrs.update(y_peak=np.abs(y).max(), tests=json.dumps(seen), held="{}")
    tree.to_netcdf(folder / "posterior.nc", engine="h5netcdf")
    (folder / "summary.json").write_text("{}")
    data = tmp_path / "data"
    data.mkdir()
    return folder, data


def test_a_campaign_never_seen_is_predicted(finished, capsys):
    folder, data = finished
    path = write_campaign(data)
    assert run(["predict", str(folder), "--campaign", str(path)]) == 0
    streams = capsys.readouterr()
    lines = [line.strip(" ─") for line in streams.out.splitlines()]
    header, weak, strong, noise, place = filter(None, lines)
    assert header.split()[0] == "test"
    assert weak.startswith("weak ")
    assert "BEYOND" not in weak
    assert "BEYOND" in strong
    assert "variation between the test's repeats (weak, strong)" in noise
    assert place.endswith("predictions.nc")
    assert streams.err.count("largest fitted displacement") >= 1
    out = folder / "predictions"
    assert {p.name for p in out.iterdir()} == {"figures", "predictions.json", "predictions.nc"}
    assert len(list((out / "figures").glob("*.png"))) == 2
    with xr.open_datatree(out / "predictions.nc", engine="h5netcdf") as tree:
        prediction = tree["strong"].to_dataset().load()
    assert prediction["predictive_band"].attrs["units"] == "m/s"
    v = motion(0.2)[2]
    # Straight lines of the reference's input at 455 points a period: (2 pi / 455)^2 / 12 = 2e-5.
    np.testing.assert_allclose(prediction["model_band"][1], v, atol=2e-5 * np.abs(v).max())
    assert prediction.attrs["extrapolation"] == pytest.approx(2.0, rel=1e-3)
    assert abs(prediction.attrs["coverage"] - 0.99) < 4 * np.sqrt(0.99 * 0.01 / 2048)
    rows = json.loads((out / "predictions.json").read_text())
    assert [row["test"] for row in rows] == ["weak", "strong"]
    assert rows[1]["warnings"]


def test_planned_tests_need_no_campaign(finished, tmp_path, capsys):
    folder, _ = finished
    out = tmp_path / "planned"
    arguments = ["--sweep", "10:25", "--duration", "4", "--fs", "256", "--level", "0.1"]
    assert run(["predict", str(folder), *arguments, "--json", "--out", str(out)]) == 0
    (row,) = json.loads(capsys.readouterr().out)["predictions"]
    assert (row["kind"], row["level_unit"], row["coverage"]) == ("sweep", "V", None)
    assert row["y_peak"]["0.5"] > 0
    with xr.open_datatree(out / "predictions.nc", engine="h5netcdf") as tree:
        (name,) = tree.children
        assert "model_band" in tree[name].data_vars
        assert "measured" not in tree[name].data_vars


def test_the_tests_are_those_of_the_runs_own_campaign_where_no_other_is_given(finished, capsys):
    folder, data = finished
    (folder / "summary.json").write_text(json.dumps({"campaign_file": str(write_campaign(data))}))
    assert run(["predict", str(folder), "--test", "weak", "--json"]) == 0
    assert [r["test"] for r in json.loads(capsys.readouterr().out)["predictions"]] == ["weak"]


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["--campaign", "none.toml"], 2, "`none.toml` does not exist"),
        (["--campaign", "CAMPAIGN", "--test", "wek"], 2, "The tests are weak, strong."),
        (["--sweep", "10-25", "--level", "1"], 2, "10:25"),
        (["--sweep", "10:25"], 2, "--level goes with"),
        ([], 2, "does not state the path of its campaign"),
        (["--tone", "18", "--level", "1", "--draws", "1"], 2, "at least 2"),
    ],
)
def test_what_cannot_be_meant_is_said(finished, capsys, arguments, code, says):
    folder, data = finished
    path = str(write_campaign(data))
    command = [path if argument == "CAMPAIGN" else argument for argument in arguments]
    assert run(["predict", str(folder), *command]) == code
    streams = capsys.readouterr()
    assert says in streams.err
    assert "Traceback" not in streams.err


def test_a_source_in_newtons_needs_a_mass(finished, capsys):
    folder, data = finished
    path = write_campaign(data, "force", "N")
    assert run(["predict", str(folder), "--campaign", str(path), "--test", "weak"]) == 3
    stderr = capsys.readouterr().err
    assert "has the unit N, but the run's gain is per V" in stderr
    assert "modal_mass" in stderr
    path = write_campaign(data, "force", "N", gain=f"modal_mass = {1 / GAIN}")
    assert run(["predict", str(folder), "--campaign", str(path), "--test", "weak"]) == 0


def test_a_folder_without_a_run_is_refused(tmp_path, capsys):
    assert run(["predict", str(tmp_path), "--tone", "18", "--level", "1"]) == 3
    assert "finished run" in capsys.readouterr().err
