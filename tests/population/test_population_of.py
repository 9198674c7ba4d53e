"""Populations of made-up fleets: their truth, a torque's trend, new units, and what is refused."""

import json

import numpy as np
import pytest
import xarray as xr
from normal_populations import moments, scattered
from scipy.stats import chi2, norm
from test_fleet import MEANS, a_run

import jbw
from jbw.cli import run
from jbw.errors import ConfigError, DataError
from jbw.population.fleet import fleet_of, write_fleet
from jbw.population.prediction import new_backbone, new_coordinates, new_units
from jbw.population.trend import saturating
from jbw.report.messages.population import mostly_prior, outliers, saturates
from jbw.verification.predictive_basis import basis_of

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


def quick(units, design, prior, lengths):
    """In the place of the sampler: draws about the prior's line, of small scatter."""

    def drawn(key, kept):
        rng, (d, p) = np.random.default_rng(0), prior.sd.shape
        tau = prior.tau * rng.uniform(0.2, 0.4, (1, 1000, 1))
        return {
            "line": prior.mean + 0.02 * rng.standard_normal((1, 1000, d, p)),
            "tau": tau,
            "scatter": tau[..., None] ** 2 * np.eye(d),
            "diverging": np.zeros((1, 1000), bool),
        }

    return drawn


@pytest.fixture
def without_nuts(monkeypatch):
    monkeypatch.setattr("jbw.population.population.sampler", quick)
    monkeypatch.setattr("jbw.population.population.sampler", quick)


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    fleet = made(tmp_path_factory.mktemp("fleet"))
    return fleet, jbw.population_of(fleet, summaries=True)  # weighed ones are slow


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """The same fleet without NUTS: about the mean of its units, and the priors' slopes."""
    fleet = made(tmp_path_factory.mktemp("quick"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("jbw.population.population.sampler", quick)
        patch.setattr("jbw.population.population.sampler", quick)
        return fleet, jbw.population_of(fleet, summaries=True)


@pytest.mark.slow  # samples a population of five coordinates
def test_slopes_and_scatters_hold_the_truth(found):
    _, pooled = found
    record = pooled.record
    assert record["status"] == "ok"
    # Every unit knows alpha/omega_n^2 to 2 %: with it all that the law has is pooled.
    assert list(record["parameters"]) == ["omega_n", "zeta", "alpha_delta", "alpha_gamma", "share"]
    truth = {"omega_n": 0.0, "zeta": -0.3, "alpha_delta": -1.0, "alpha_gamma": -1.0}
    for name, slope in truth.items():
        row = record["parameters"][name]
        assert row["slope_torque"]["q005"] < slope < row["slope_torque"]["q995"]
    spread = {"omega_n": 2e-3, "zeta": 0.1, "alpha_delta": 0.112, "alpha_gamma": 0.112}
    for name, tau in spread.items():
        row = record["parameters"][name]
        assert row["scatter"]["q005"] < tau < row["scatter"]["q995"]
    assert any("alpha_delta falls with torque" in statement for statement in record["statements"])


@pytest.mark.release  # units weighed anew are, below
def test_one_coordinate_alone_is_that_of_the_quadrature(found):
    fleet, _ = found
    of_zeta = jbw.population_of(fleet, parameters=["zeta"])
    exact = scattered(
        of_zeta.pooled.mean[:, 0], np.sqrt(of_zeta.pooled.cov[:, 0, 0]), of_zeta.design.x,
        of_zeta.prior.mean[0], np.diag(of_zeta.prior.sd[0] ** 2), float(of_zeta.prior.tau[0]),
    )  # fmt: skip
    mean, sd = moments(exact)
    tau = of_zeta.draws["tau"].ravel()
    # Monte Carlo of 2,000 draws, a few hundred of which count: five of their standard errors.
    assert abs(tau.mean() - mean) < 5 * sd / np.sqrt(300)
    slope = of_zeta.draws["line"][..., 0, 1].ravel()
    expected = np.sum(exact.weight * exact.mean[:, 1])
    assert abs(slope.mean() - expected) < 5 * slope.std() / np.sqrt(300)


def test_new_units_have_the_pooled_coordinates_and_frequencies_of_their_torque(plain):
    fleet, pooled = plain
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


def test_the_command_writes_table_figure_and_prediction(plain, tmp_path, capsys, monkeypatch):
    fleet, pooled = plain
    monkeypatch.setattr("jbw.population.population.population_of", lambda *_, **__: pooled)
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
    with xr.open_datatree(out / "population.nc", engine="h5netcdf") as tree:
        assert tree.attrs["torque"] == 8.0
        assert tree["frequency"].dims == ("quantile", "amplitude")
        assert basis_of(tree).laws == ("bouc_wen",)
        assert tree["posterior"].sizes["draw"] == 400
    page = (out / "population.html").read_text(encoding="utf-8")
    assert "normal summary" in page
    assert "Population of 6 units" in page
    assert all(page.count(name) for name in record["units"])
    assert page.count("<svg") == 1
    assert " src=" not in page  # nothing comes from elsewhere


def test_the_command_takes_a_fleet_without_torques(tmp_path, capsys, without_nuts):
    """Names of units in the figure's place of torques, None in the file's, scatter of runs."""
    fleet = made(tmp_path, torques=(np.nan,) * 4, scatter=[0.1, 1e-3])
    path = tmp_path / "fleet.nc"
    write_fleet(path, fleet)
    assert run(["population", str(path), "--json"]) in (0, 4)
    record = json.loads(capsys.readouterr().out)
    assert record["torque"] == [None] * 4
    assert record["new_unit"]["torque"] is None
    assert record["parameters"]["zeta"]["run_scatter"] == pytest.approx(0.1, rel=0.2)
    stored = json.loads((tmp_path / "fleet-population" / "population.json").read_text())
    assert stored == record
    page = (tmp_path / "fleet-population" / "population.html").read_text(encoding="utf-8")
    assert "between runs [%]" in page


@pytest.mark.slow  # each samples a population of its own
def test_units_weighed_anew_are_rid_of_what_their_runs_took_for_a_prior(tmp_path):
    """A likelihood N(y, s^2) of ln zeta under a prior uniform in zeta is drawn about y + s^2."""
    s, tau, num = 0.3, 0.6, 16
    rng = np.random.default_rng(1)
    y = np.log(0.01) + tau * rng.standard_normal(num) + s * rng.standard_normal(num)
    folders = []
    for k in range(num):
        draws = {name: np.full((2, 200), mean) for name, mean in MEANS.items()}
        draws["zeta"] = np.exp(y[k] + s**2 + s * rng.standard_normal((2, 200)))
        folders.append(a_run(tmp_path / f"unit_{k}", draws=draws, inputs={"a": f"{k}"})[0])
    fleet = fleet_of(folders)
    weighed = jbw.population_of(fleet, parameters=["zeta"])
    plain = jbw.population_of(fleet, parameters=["zeta"], summaries=True)
    exact = scattered(
        y, np.full(num, s), weighed.design.x, weighed.prior.mean[0],
        np.diag(weighed.prior.sd[0] ** 2), float(weighed.prior.tau[0]),
    )  # fmt: skip
    mean = np.sum(exact.weight * exact.mean[:, 0])
    # Draws of the units move their mean by s / sqrt(16 x 400) = 0.004, those of the population, sd
    # 0.17, by some 0.006 of their mean: four of them together. The prior moved it by s^2 = 0.09.
    for population in (weighed, plain):
        assert abs(population.draws["line"][..., 0, 0].mean() - mean) < 0.03
    assert weighed.draws["tau"].mean() == pytest.approx(moments(exact)[0], rel=0.1)
    # Kish share of a unit by hand: its draws under the median population, over zeta, the prior's
    # density over ln zeta.
    logs = fleet["unit_3"]["draws"].sel(parameter="zeta").values
    middle = np.median(weighed.draws["line"])
    spread = np.sqrt(np.median(weighed.draws["scatter"]))
    w = norm.pdf(logs, middle, spread) / np.exp(logs)
    share = w.sum() ** 2 / (len(w) * np.sum(w**2))
    assert weighed.record["weighed"]["unit_3"] == pytest.approx(share, rel=1e-9)
    assert not plain.record["weighed"]
    assert "16 of 16 units are represented by re" in " ".join(weighed.record["statements"])


def test_a_saturating_curve_is_an_exponential_of_slope_one():
    """a - d exp(-T/T_0), whose slope on ln T at the reference is d (T_ref/T_0) exp(-T_ref/T_0)."""
    reference, scale, d = 5.0, 3.0, 0.02
    torque = np.array([2.0, 5.0, 12.0, 40.0])
    slope = d * reference / scale * np.exp(-reference / scale)
    curve = slope * np.asarray(saturating(torque / reference, scale / reference))
    expected = d * (np.exp(-reference / scale) - np.exp(-torque / scale))
    np.testing.assert_allclose(curve, expected, rtol=1e-12, atol=1e-18)


@pytest.mark.release  # slopes and scatters are in this file
def test_a_frequency_that_saturates_is_predicted_beyond_the_torques(tmp_path):
    """omega_n by its curve; a power through the same units goes on to rise."""
    torques = np.repeat([1.5, 3.0, 6.0, 12.0], 2)
    rng = np.random.default_rng(2)

    def curve(torque):
        return np.log(118.0) - 0.05 * np.exp(-torque / 2.5)

    folders = []
    for k, torque in enumerate(torques):
        middle = curve(torque) + 1e-3 * rng.standard_normal()
        draws = {name: np.full((2, 50), mean) for name, mean in MEANS.items()}
        draws["omega_n"] = np.exp(middle + 2e-4 * rng.standard_normal((2, 50)))
        stated = {"assembly": {"torque": float(torque)}, "inputs": {"a": f"{k}"}}
        folders.append(a_run(tmp_path / f"unit_{k}", draws=draws, **stated)[0])
    fleet = fleet_of(folders)
    bent, power = (
        jbw.population_of(fleet, parameters=["omega_n"], saturating=names)
        for names in (("omega_n",), ())
    )
    far = 40.0
    drawn = {
        name: new_coordinates(population, far, np.random.default_rng(0), 4000)[:, 0]
        for name, population in (("bent", bent), ("power", power))
    }
    low, high = np.quantile(drawn["bent"], [0.005, 0.995])
    assert low < curve(far) < high
    # The power's line overshoots: it is past the curve by several of its own scatters.
    assert np.median(drawn["power"]) - curve(far) > 3 * abs(np.median(drawn["bent"]) - curve(far))
    saturation = bent.record["saturation_torque"]
    assert saturation["q005"] < 2.5 < saturation["q995"]
    assert saturates(["omega_n"], saturation) in bent.record["statements"]


@pytest.mark.release  # as the others alone tell below
def test_a_unit_that_is_another_is_told(tmp_path):
    fleet = made(tmp_path, torques=(np.nan,) * 8)
    mean = fleet.to_dataset()["mean"].copy(deep=True)
    mean[3, 1] += 3.0  # a damping twenty times that of the others
    fleet.dataset = fleet.to_dataset().assign(mean=mean)
    record = jbw.population_of(fleet, parameters=["omega_n", "zeta"]).record
    assert record["columns"] == ["mean"]
    assert outliers(["unit_3"]) in record["statements"]


@pytest.mark.slow  # samples two populations
def test_a_unit_is_judged_by_the_others_alone(tmp_path):
    """The scatter of the others by quadrature: a mixture of normals over tau, of one coordinate."""
    fleet = made(tmp_path, torques=(np.nan,) * 7)
    mean = fleet.to_dataset()["mean"].copy(deep=True)
    mean[3, 1] += 1.0  # ten times the scatter, which that unit makes four times as large itself
    fleet.dataset = fleet.to_dataset().assign(mean=mean)
    population = jbw.population_of(fleet, parameters=["zeta"], summaries=True)
    y, s = population.pooled.mean[:, 0], np.sqrt(population.pooled.cov[:, 0, 0])
    # Their own prior is uniform in zeta: N(m, s^2) / e^x is N(m - s^2, s^2).
    y = y - s**2
    prior = (
        population.prior.mean[0],
        np.diag(population.prior.sd[0] ** 2),
        float(population.prior.tau[0]),
    )
    for k, unit in enumerate(population.record["units"]):
        rest = np.arange(7) != k
        exact = scattered(y[rest], s[rest], population.design.x[rest], *prior)
        spread = exact.tau**2 + exact.cov[:, 0, 0] + s[k] ** 2
        far = chi2.sf((y[k] - exact.mean[:, 0]) ** 2 / spread, 1)
        expected = np.sum(exact.weight * far)
        if unit != "unit_3":
            assert population.record["belongs"][unit] == pytest.approx(expected, rel=0.2)
        else:  # 1.3e-4 is the average over few of the draws; in its own scatter it has 2.8e-2
            assert expected / 5 < population.record["belongs"][unit] < 5 * expected
    assert outliers(["unit_3"]) in population.record["statements"]


def test_two_units_are_not_assessed(tmp_path, without_nuts):
    record = jbw.population_of(made(tmp_path, torques=(np.nan, np.nan))).record
    assert record["status"] == "not assessed"
    assert record["statements"][0] == mostly_prior(2, 1, trend=False)


def test_what_cannot_be_pooled_is_named(tmp_path, plain, without_nuts):
    fleet, pooled = plain
    with pytest.raises(ConfigError, match="has no softenin"):
        jbw.population_of(fleet, parameters=["softenin"])
    with pytest.raises(ConfigError, match="omega cannot saturate"):
        jbw.population_of(fleet, saturating=["omega"])
    with pytest.raises(ConfigError, match="above zero"):
        new_units(pooled, fleet, -1.0)
    same = made(tmp_path / "same", torques=(5.0, 5.0, 5.0))
    with pytest.raises(DataError, match="no parameter can saturate"):
        jbw.population_of(same, saturating=["omega_n"])
    of_zeta = jbw.population_of(same, parameters=["zeta"])
    with pytest.raises(DataError, match="no trend"):
        new_units(of_zeta, same, 8.0)
    few = fleet.copy(deep=True)
    verdict = np.array(["ok"] * 4 + ["failed"] * 2, object)
    few.dataset = fleet.to_dataset().assign(verdict=("unit", verdict))
    statements = " ".join(jbw.population_of(few).record["statements"])
    assert (
        "The population includes 2 of 6 units whose runs failed: unit_4 and unit_5." in statements
    )
    failed = made(tmp_path / "failed", torques=(2.0, 5.0, 8.0), verdict={"status": "failed"})
    with pytest.raises(DataError, match="3 of 3 runs failed") as caught:
        jbw.population_of(failed)
    assert "--all-verdicts" in caught.value.remedy
    all_the_same = jbw.population_of(failed, all_verdicts=True).record
    assert all_the_same["failed"] == ["unit_0", "unit_1", "unit_2"]
    cut = fleet.copy(deep=True)
    beyond = fleet.to_dataset()["beyond"].copy(deep=True)
    beyond.loc[{"unit": "unit_1", "parameter": "zeta"}] = 0.05
    cut.dataset = fleet.to_dataset().assign(beyond=beyond)
    with pytest.raises(DataError, match="cuts the posterior of zeta in unit_1"):
        jbw.population_of(cut)


def test_covariates_and_units_that_are_too_few_are_refused(plain, tmp_path, capsys, without_nuts):
    """One unit in a file, a number of the tightening for some, a slope asked at one torque."""
    fleet, _ = plain
    without_covariates = fleet.copy(deep=True)
    without_covariates.dataset = fleet.to_dataset().isel(unit=[0])
    with pytest.raises(DataError, match="One unit makes no population"):
        jbw.population_of(without_covariates)
    some = fleet.copy(deep=True)
    sequence = ("unit", [1.0, 2.0, np.nan, 1.0, 2.0, 3.0])
    some.dataset = fleet.to_dataset().assign(sequence=sequence)
    with pytest.raises(DataError, match="Every unit or no unit must state a positive sequence"):
        jbw.population_of(some)
    path = tmp_path / "same.nc"
    write_fleet(path, made(tmp_path / "same", torques=(5.0, 5.0, 5.0)))
    assert run(["population", str(path), "--torque", "8"]) == 3
    assert "no trend with torque" in " ".join("".join(capsys.readouterr()).split())
    assert not (tmp_path / "same-population").exists()
