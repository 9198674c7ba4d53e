"""Populations of made-up fleets: their truth, a torque's trend, new units, and what is refused."""

import json

import numpy as np
import pytest
from test_fleet import MEANS, a_run

import jbw
from jbw.cli import run
from jbw.errors import ConfigError, DataError
from jbw.population.fleet import fleet_of, write_fleet
from jbw.population.normal import moments, scattered
from jbw.population.prediction import new_backbone, new_units

TORQUES = (2.0, 2.0, 5.0, 5.0, 12.0, 12.0)
# Powers of torque and scatter of logarithms, of the truth.
POWER = {"omega_n": 0.0, "zeta": -0.3, "alpha": 0.0, "delta": -1.0, "gamma": -1.0}
SCATTER = {"omega_n": 2e-3, "zeta": 0.1, "alpha": 0.05, "delta": 0.1, "gamma": 0.1}
OWN = {"omega_n": 2e-4, "zeta": 0.02, "alpha": 0.02, "delta": 0.02, "gamma": 0.02}


def made(path, torques=TORQUES, seed=0, **records):
    """A fleet of runs whose joints scatter about powers of torque."""
    rng = np.random.default_rng(seed)
    folders = []
    for k, torque in enumerate(torques):
        draws = {
            name: np.exp(
                np.log(mean) + POWER[name] * np.log(np.nan_to_num(torque, nan=5.0) / 5.0)
                + SCATTER[name] * rng.standard_normal()
                + OWN[name] * rng.standard_normal((2, 100))
            )
            for name, mean in MEANS.items()
        }  # fmt: skip
        stated = {"assembly": {"torque": torque}} if np.isfinite(torque) else {}
        folder, _ = a_run(path / f"unit_{k}", seed=k, draws=draws, **stated, **records)
        folders.append(folder)
    return fleet_of(folders)


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    fleet = made(tmp_path_factory.mktemp("fleet"))
    return fleet, jbw.population_of(fleet)


def test_slopes_and_scatters_hold_the_truth(found):
    _, pooled = found
    record = pooled.record
    assert record["status"] == "ok"
    assert list(record["parameters"]) == ["omega_n", "zeta", "alpha_delta", "alpha_gamma"]
    truth = {"omega_n": 0.0, "zeta": -0.3, "alpha_delta": -1.0, "alpha_gamma": -1.0}
    for name, slope in truth.items():
        row = record["parameters"][name]
        assert row["slope_torque"]["q005"] < slope < row["slope_torque"]["q995"]
    spread = {"omega_n": 2e-3, "zeta": 0.1, "alpha_delta": 0.112, "alpha_gamma": 0.112}
    for name, tau in spread.items():
        row = record["parameters"][name]
        assert row["scatter"]["q005"] < tau < row["scatter"]["q995"]
    assert any("alpha_delta falls with torque" in one for one in record["statements"])


@pytest.mark.slow  # each samples a population of its own
def test_one_coordinate_alone_is_that_of_the_quadrature(found):
    fleet, _ = found
    alone = jbw.population_of(fleet, parameters=["zeta"])
    exact = scattered(
        alone.pooled.mean[:, 0], np.sqrt(alone.pooled.cov[:, 0, 0]), alone.design.x,
        alone.prior.mean[0], np.diag(alone.prior.sd[0] ** 2), float(alone.prior.tau[0]),
    )  # fmt: skip
    mean, sd = moments(exact)
    tau = alone.draws["tau"].ravel()
    # Monte Carlo of 2,000 draws, a few hundred of which count: five of their standard errors.
    assert abs(tau.mean() - mean) < 5 * sd / np.sqrt(300)
    slope = alone.draws["line"][..., 0, 1].ravel()
    expected = np.sum(exact.weight * exact.mean[:, 1])
    assert abs(slope.mean() - expected) < 5 * slope.std() / np.sqrt(300)


def test_new_units_have_the_pooled_coordinates_and_frequencies_of_their_torque(found):
    fleet, pooled = found
    weak, strong = (new_units(pooled, fleet, torque, num=2000) for torque in (2.0, 12.0))
    ratio = np.median(strong["alpha"] * strong["delta"]) / np.median(weak["alpha"] * weak["delta"])
    slope = pooled.record["parameters"]["alpha_delta"]["slope_torque"]["median"]
    # Medians of 2,000 draws that scatter by some 0.2: 0.6 % each.
    np.testing.assert_allclose(np.log(ratio), slope * np.log(6.0), atol=0.05)
    band = new_backbone(pooled, fleet, 5.0)
    assert band.sizes == {"quantile": 3, "amplitude": 40}
    frequency = band["frequency"].values
    assert np.all(np.diff(frequency, axis=0) > 0)
    np.testing.assert_allclose(frequency[1, 0], MEANS["omega_n"] / (2 * np.pi), rtol=5e-3)


def test_the_command_writes_table_figure_and_prediction(found, tmp_path, capsys):
    fleet, _ = found
    path = tmp_path / "fleet.nc"
    write_fleet(path, fleet)
    assert run(["population", str(path), "--torque", "8", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["new_unit"]["torque"] == 8.0
    row = record["new_unit"]["alpha_delta"]
    truth = MEANS["alpha"] * MEANS["delta"] * (8.0 / 5.0) ** -1
    assert row["q005"] < truth < row["q995"]
    out = tmp_path / "fleet-population"
    assert {p.name for p in out.iterdir()} == {
        "population.html", "population.json", "population.nc", "population.png",
    }  # fmt: skip
    page = (out / "population.html").read_text(encoding="utf-8")
    assert "Population of 6 units" in page
    assert all(page.count(name) for name in record["units"])
    assert page.count("<svg") == 1
    assert " src=" not in page  # nothing comes from elsewhere


@pytest.mark.slow  # each samples a population of its own
def test_a_unit_that_is_another_is_told(tmp_path):
    fleet = made(tmp_path, torques=(np.nan,) * 8)
    mean = fleet.to_dataset()["mean"].copy(deep=True)
    mean[3, 1] += 3.0  # a damping twenty times that of the others
    fleet.dataset = fleet.to_dataset().assign(mean=mean)
    record = jbw.population_of(fleet, parameters=["omega_n", "zeta"]).record
    assert record["columns"] == ["mean"]
    assert min(record["belongs"], key=lambda unit: record["belongs"][unit]) == "unit_3"


@pytest.mark.slow  # each samples a population of its own
def test_two_units_are_not_assessed(tmp_path):
    record = jbw.population_of(made(tmp_path, torques=(np.nan, np.nan))).record
    assert record["status"] == "not assessed"
    assert "too little" in record["statements"][0]


def test_what_cannot_be_pooled_is_named(tmp_path, found):
    fleet, pooled = found
    with pytest.raises(ConfigError, match="holds no softenin"):
        jbw.population_of(fleet, parameters=["softenin"])
    with pytest.raises(ConfigError, match="above zero"):
        new_units(pooled, fleet, -1.0)
    same = made(tmp_path / "same", torques=(5.0, 5.0, 5.0))
    alone = jbw.population_of(same, parameters=["zeta"])
    with pytest.raises(DataError, match="no trend"):
        new_units(alone, same, 8.0)
    failed = made(tmp_path / "failed", torques=(2.0, 5.0, 8.0), verdict={"status": "failed"})
    with pytest.raises(DataError, match="3 of 3 runs failed") as caught:
        jbw.population_of(failed)
    assert "--all-verdicts" in caught.value.remedy
    cut = fleet.copy(deep=True)
    beyond = fleet.to_dataset()["beyond"].copy(deep=True)
    beyond.loc[{"unit": "unit_1", "parameter": "zeta"}] = 0.05
    cut.dataset = fleet.to_dataset().assign(beyond=beyond)
    with pytest.raises(DataError, match="cuts the posterior of zeta in unit_1"):
        jbw.population_of(cut)
