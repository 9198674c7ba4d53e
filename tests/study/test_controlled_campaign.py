"""A beam like Brake's and Reuss's by its backbone alone: the whole way from files to a report.

The points are the closed form of Bouc-Wen's loop, of which jbw has no part.
"""

import json

import numpy as np
import pytest
from describing import describing_function

import jbw
from jbw.report.charts import charts_of
from jbw.report.prediction import prediction

OMEGA_N, ZETA, ALPHA, DELTA, GAMMA = 2 * np.pi * 80.0, 0.0012, 90000.0, 300.0, 30.0
MASS = 1.9
TRUTH = {"omega_n": OMEGA_N, "zeta": ZETA, "alpha": ALPHA, "delta": DELTA, "gamma": GAMMA}
Y = np.geomspace(4e-6, 1.6e-4, 16)  # 0.6 % of softening at most, in microslip: delta Y = 0.05
FORCE_NOISE, FREQUENCY_NOISE = 0.01, 2e-5
TEST = """
[[test]]
kind = "backbone"
name = "{name}"
files = "{name}_*.csv"
locked_phase = {degrees}
channels = {{ frequency = "f", force = "F", displacement = "y" }}
units = {{ frequency = "Hz", force = "N", displacement = "um" }}
"""
SETTINGS = """
[identify]
hold_out = ["beside"]
sampler = "importance"
num_chains = 2
num_samples = 2000
offsets = "none"
"""


def points(degrees):
    """Frequency [rad/s] and force [N] at a phase by the first harmonic: its quadratic equation."""
    joint = jbw.BoucWen(OMEGA_N, ZETA, ALPHA, DELTA, GAMMA)
    cotangent = 1 / np.tan(np.radians(degrees))
    rows = []
    for y in Y:
        z, half = describing_function(joint, y), ZETA * OMEGA_N * cotangent
        omega = half + np.sqrt(half**2 + joint.k + z.real + cotangent * z.imag)
        lost = 2 * ZETA * OMEGA_N * omega + z.imag
        rows.append((omega, -MASS * lost * y / np.sin(np.radians(degrees))))
    return np.array(rows).T


@pytest.fixture(scope="module")
def beam(tmp_path_factory):
    """A finished run of it, with the folder."""
    folder, rng = tmp_path_factory.mktemp("beam"), np.random.default_rng(20)
    for name, degrees in (("resonance", -90.0), ("beside", -60.0)):
        omega, force = points(degrees)
        for repeat in range(2):
            e = rng.standard_normal((2, len(Y)))
            columns = [omega / (2 * np.pi) * (1 + FREQUENCY_NOISE * e[0]),
                       force * (1 + FORCE_NOISE * e[1]), 1e6 * Y]  # fmt: skip
            np.savetxt(folder / f"{name}_{repeat}.csv", np.column_stack(columns), delimiter=",",
                       header="f,F,y", comments="", fmt="%.10g")  # fmt: skip
    path = folder / "campaign.toml"
    tests = TEST.format(name="resonance", degrees=-90.0) + TEST.format(name="beside", degrees=-60.0)
    head = f'[campaign]\nname = "beam"\nmodal_mass = {MASS}\n'
    path.write_text(head + tests + SETTINGS, encoding="utf-8")
    study = jbw.identify(jbw.load_campaign(path), seed=1, truth=TRUTH, report=lambda _: None)
    study.save(folder / "run")
    return study, folder / "run"


@pytest.mark.release
def test_the_backbone_alone_knows_the_softening_to_one_per_cent(beam):
    study, _ = beam
    posterior = study.tree["posterior"].to_dataset()
    product = posterior["alpha"] * posterior["delta"]
    assert product.std() < 0.01 * ALPHA * DELTA
    assert abs(product.mean() - ALPHA * DELTA) < 4 * product.std()
    for name in ("omega_n", "zeta"):
        assert abs(posterior[name].mean() - TRUTH[name]) < 4 * posterior[name].std(), name
    assert posterior["omega_n"].std() < 1e-5 * OMEGA_N


@pytest.mark.release
def test_frequency_and_force_stand_beside_their_bands(beam):
    study, folder = beam
    for name, fitted in (("resonance", 1), ("beside", 0)):
        for quantity, unit in (("frequency", "Hz"), ("force", "N")):
            found = study.tree[f"verification/controlled/{name} {quantity}"].to_dataset()
            assert found.attrs["fitted"] == fitted
            assert found["measured"].attrs["units"] == unit
            assert found.attrs["coverage"] > 0.85  # of 16 values
            assert found.attrs["nrmse"] < 0.2 * found.attrs["nrmse_linear"]
    told = json.loads((folder / "summary.json").read_text(encoding="utf-8"))["predictions"]
    assert told["beside force"]["fitted"] is False
    headings = {chart.heading for chart in charts_of(study.tree)}
    assert {"Backbone resonance frequency", "Backbone resonance force"} <= headings
    assert "resonance force" in (folder / "report.html").read_text(encoding="utf-8")
    again = study.predict("beside")
    assert set(again["unit"].values) == {"Hz", "N"}
    assert again.attrs["num_values"] == 32
    assert len(prediction("beside", again).flat) == 2
