"""A fleet from end to end: tightened by the rig, identified, collected, pooled, and the next one.

The rig's law of the torque and its integrator share nothing with what identifies and pools them.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

import jbw
from jbw import rig
from jbw.population.prediction import new_coordinates
from jbw.rig.generator import Sweep

TORQUES, NEW = (4.0, 8.0, 12.0), 10.0  # N m
PLANS = tuple(
    rig.Plan(name, "sweep", Sweep(12.0, 26.0, volts, burst=6.0, fade=0.3, duration=8.0), repeats=2)
    for name, volts in (("weak", 0.05), ("strong", 0.20))
)
PRESET = replace(rig.MIXED, name="fleet", source="input", gain=15.0, plans=PLANS, input_range=1.0)
LAW = rig.Tightening(wrench=0.03)
# Of a joint in series with its load: alpha ~ T^-1/2 and delta, gamma ~ T^-1.
SLOPES = {
    "omega_n": 0.01, "zeta": -0.1, "alpha_delta": -1.5, "alpha_gamma": -1.5, "share": -0.52,
}  # fmt: skip


def coordinates(names, campaign):
    truth = dict(campaign.truth["joint"])
    truth |= {f"alpha_{name}": truth["alpha"] * truth[name] for name in ("delta", "gamma")}
    truth["share"] = truth["alpha"] / truth["omega_n"] ** 2
    return np.log([truth[name] for name in names])


@pytest.mark.release
def test_a_fleet_is_measured_identified_pooled_and_the_next_torque_predicted(tmp_path, monkeypatch):
    monkeypatch.setattr("jbw.report.figures.draw_figures", lambda *_: None)
    monkeypatch.setattr("jbw.report.page.write_page", lambda *of: of[2].write_text("page"))
    conditions = {"how": LAW, "fs": 256.0, "noise_ratio": 0.05}
    fleet = rig.measure_fleet(PRESET, torques=TORQUES, assemblies=2, seed=1, **conditions)
    files = [rig.write(unit, tmp_path / f"unit_{i}") for i, unit in enumerate(fleet)]
    with ThreadPoolExecutor(1) as pool:  # one process compiles but once
        outcomes = jbw.identify_many(files, tmp_path / "runs", executor=pool)
    assert [(outcome.status, outcome.verdict) for outcome in outcomes] == [("done", "ok")] * 6

    units = jbw.fleet_of(outcome.folder for outcome in outcomes)
    assert sorted(units["torque"].values) == sorted(2 * TORQUES)
    population = jbw.population_of(units)
    names = population.pooled.names
    built = np.array([coordinates(names, unit) for unit in fleet])
    sd = np.sqrt(np.diagonal(population.pooled.cov, axis1=1, axis2=2))
    # 30 standardised errors: one beyond 3.5 is expected in seventy fleets.
    assert np.max(np.abs(population.pooled.mean - built) / sd) < 3.5
    assert list(names) == [*SLOPES]  # every unit knows alpha/omega_n^2 too
    assert population.record["status"] == "ok"
    assert abs(population.record["correlation"]) < 0.5
    ratio = population.record["ratios"]["gamma/delta"]
    assert ratio["q005"] < 0.0 < ratio["q995"]
    for name in names:
        row = population.record["parameters"][name]["slope_torque"]
        assert row["q005"] < SLOPES[name] < row["q995"]

    (new,) = rig.measure_fleet(PRESET, torques=[NEW], assemblies=1, seed=7, **conditions)
    ahead = new_coordinates(population, NEW, np.random.default_rng(0), 4000)
    low, high = np.quantile(ahead, (0.005, 0.995), axis=0)
    true = coordinates(names, new)
    assert np.all((low < true) & (true < high))
    backbone = jbw.new_backbone(population, units, NEW)
    curve = jbw.backbone(jbw.BoucWen(**new.truth["joint"]), backbone.amplitude.values)
    for name, values in (("frequency", curve.omega / (2 * np.pi)), ("damping", curve.zeta)):
        band = backbone[name].values
        assert np.all((band[0] < values) & (values < band[-1]))
    # The band is of scatter between units, far wider than noise: it holds a unit's sweep, or not.
    strong = next(test for test in new.tests if test.name == "strong")
    bands = jbw.new_prediction(population, units, strong, NEW)
    assert bands.attrs["coverage"] > 0.97
