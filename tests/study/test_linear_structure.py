"""A structure without a joint that slips, `laws = []`: identified, judged, reported, exported."""

import csv
import json

import numpy as np
import pytest
from exported import rows as rows_of
from scipy.signal import StateSpace, lsim

import jbw
from jbw.cli import run

pytestmark = pytest.mark.slow

FS, SIZE, GAIN, NOISE = 256.0, 512, 15.0, 1e-3
OMEGA_N, ZETA = 118.0, 0.01
CAMPAIGN = """
[campaign]
gain = 15.0
[joint]
laws = []
[[test]]
kind = "sweep"
files = "sweep_*.csv"
channels = { input = "u", velocity = "v" }
units = { input = "V", velocity = "m/s" }
fs = 256.0
[identify]
fit_repeats = 2
sampler = "importance"
num_chains = 2
num_samples = 400
substeps = 1
"""


def write_sweeps(folder, num_repeats=3):
    """Repeats of the velocity from rest, by scipy's state space, with noise."""
    rng = np.random.default_rng(0)
    t = np.arange(16 * SIZE) / (16 * FS)
    fade = np.sin(np.pi * np.clip(t / (0.8 * t[-1]), 0, 1)) ** 2
    u = fade * np.sin(2 * np.pi * (14 * t + 2.5 * t**2))
    motion = StateSpace([[0, 1], [-(OMEGA_N**2), -2 * ZETA * OMEGA_N]], [[0], [GAIN]], [0, 1], 0)
    velocity = np.ravel(lsim(motion, u, t)[1])
    for i in range(num_repeats):
        columns = (u[::16], velocity[::16] + NOISE * rng.standard_normal(SIZE))
        rows = [("u", "v"), *zip(*map(np.ndarray.tolist, columns), strict=True)]
        with (folder / f"sweep_{i}.csv").open("w", newline="") as file:
            csv.writer(file).writerows(rows)


def test_a_linear_structure_from_the_campaign_to_the_export(tmp_path, capsys):
    write_sweeps(tmp_path)
    path = tmp_path / "campaign.toml"
    path.write_text(CAMPAIGN)
    study = jbw.identify(jbw.load_campaign(path), seed=1, report=lambda _: None)
    assert json.loads(study.tree.attrs["laws"]) == []
    rows = study.record["steps"]["joint"]["parameters"]
    assert {name for name in rows if not name.startswith("noise")} == {"omega_n", "zeta"}
    for name, truth in {"omega_n": OMEGA_N, "zeta": ZETA}.items():
        assert abs(rows[name]["mean"] - truth) < 4 * rows[name]["sd"]
        assert rows[name]["sd"] < 0.01 * truth
    # The oscillator that it would be compared with is the same one, and is not fitted again.
    (errors,) = study.record["predictions"].values()
    assert errors["nrmse_linear"] is None
    assert errors["coverage"] > 0.95
    study.save(tmp_path / "run")
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert "vibration records: a linear structure" in page
    assert run(["export", str(tmp_path / "run"), "--json"]) == 0
    written = rows_of(tmp_path / "run" / "export" / "parameters.csv")
    assert [row["parameter"] for row in written] == ["omega_n", "zeta"]
    assert not (tmp_path / "run" / "export" / "joint.tcl").exists()
