"""Units that nobody measured: far torques by the rig's law, one unit's own prediction, gains."""

import json

import numpy as np
import pytest
from scipy.signal import lsim
from scipy.stats import kstest
from scipy.stats import t as student
from test_fleet import MEANS, UNITS, a_run

import jbw
from jbw import rig
from jbw.cli import run
from jbw.errors import DataError
from jbw.measurement.files.hdf5 import write_hdf5
from jbw.measurement.records import Record
from jbw.population.basis import new_terms, new_unit, require_same_torque, terms_of
from jbw.population.coordinates import pooled
from jbw.population.fleet import fleet_of
from jbw.population.population import Population
from jbw.population.prediction import new_backbone, new_units
from jbw.population.prior import design_of, prior_of
from jbw.report.result import read_result
from jbw.rig.tightening import SCATTERING, Tightening, tightened
from jbw.verification.planned import planned_tones
from jbw.verification.predict import Request, predict, warnings_of
from jbw.verification.predictive_basis import basis_of

QUIET = {"scatter": dict.fromkeys(SCATTERING, 0.0)}
TORQUES = (4.0, 6.0, 8.0, 10.0, 12.0)
TESTS = {"weak": {"kind": "stepped", "source": "V", "response": "velocity", "level": 0.05}}


def parameters(joint):
    return {"omega_n": float(joint.omega_n), "zeta": float(joint.zeta), **{
        name: float(value) for name, value in joint.laws[0].parameters().items()
    }}  # fmt: skip


def population(fleet, scatter, line=None):
    """Of a fleet without NUTS: its regression on ln torque, and a scatter that is given."""
    pooling, root = pooled(fleet), fleet.to_dataset()
    design = design_of(root["torque"].values.tolist(), root["sequence"].values.tolist())
    if line is None:
        line = np.linalg.lstsq(design.x, pooling.mean, rcond=None)[0].T
    d = len(pooling.names)
    draws = {
        "line": np.broadcast_to(line, (1, 50, *line.shape)),
        "tau": np.full((1, 50, d), scatter),
        "scatter": np.broadcast_to(scatter**2 * np.eye(d), (1, 50, d, d)),
    }
    torque = [
        None if np.isnan(torque_of_unit) else torque_of_unit
        for torque_of_unit in root["torque"].values.tolist()
    ]
    record = {
        "torque": torque,
        "reference_torque": None if np.isnan(design.reference) else design.reference,
    }
    return Population(
        pooling, design, prior_of(pooling.names, {}, pooling.mean, design), draws, record
    )


def series(path, sds):
    """Units of the rig's joint in series at several torques, known to `sds` of a parameter."""
    rng, folders = np.random.default_rng(0), []
    for torque in TORQUES:
        true = parameters(tightened(rig.TRUTH, torque, Tightening(**QUIET)))
        off = {name: sds.get(name, 1e-4) * rng.standard_normal((2, 200)) for name in true}
        off["delta"] = off["delta"] - off["alpha"]  # a ridge: alpha delta, alpha gamma are known
        off["gamma"] = off["gamma"] - off["alpha"]
        draws = {name: value * np.exp(off[name]) for name, value in true.items()}
        stated, facts = {"torque": torque}, {"y_peak": 5e-3}
        folder, _ = a_run(path / f"at_{torque:g}", draws=draws, assembly=stated, attrs=facts,
                          inputs={"a": str(torque)}, box=False)  # fmt: skip
        folders.append(folder)
    return fleet_of(folders)


def test_a_torque_far_away_follows_the_rig_s_law_of_a_joint_in_series(tmp_path):
    """alpha ~ T^-p by itself: no product tells it, and at full amplitude the frequency does."""
    fleet, far = series(tmp_path, {}), 40.0
    fleet_population = population(fleet, 1e-3)
    assert "share" in fleet_population.pooled.names
    true = tightened(rig.TRUTH, far, Tightening(**QUIET))
    drawn = new_units(fleet_population, fleet, far)
    for name, value in parameters(true).items():
        # Scatter of 1e-3 a coordinate over 400 draws, a line that is known to 1e-4: 2e-3 at most.
        assert np.median(drawn[name]) == pytest.approx(value, rel=3e-3), name
    band = new_backbone(fleet_population, fleet, far)
    curve = jbw.backbone(true, band.amplitude.values)
    for name, values in (("frequency", curve.omega / (2 * np.pi)), ("damping", curve.zeta)):
        np.testing.assert_allclose(band[name].values[1], values, rtol=5e-3)


def test_a_share_that_no_unit_knows_is_common_to_all_torques(tmp_path):
    fleet, far = series(tmp_path, {"alpha": 0.5}), 40.0
    fleet_population = population(fleet, 1e-3)
    assert "share" not in fleet_population.pooled.names
    drawn = new_units(fleet_population, fleet, far, num=4000)
    true = parameters(tightened(rig.TRUTH, far, Tightening(**QUIET)))
    for name in ("delta", "gamma"):
        product = np.median(drawn["alpha"] * drawn[name])
        assert product == pytest.approx(true["alpha"] * true[name], rel=3e-3)
    shares_by_unit = [
        fleet[f"at_{torque:g}"]["draws"].sel(parameter="share").values for torque in TORQUES
    ]
    share = np.log(drawn["alpha"] / drawn["omega_n"] ** 2)
    # Medians of 4,000 draws of sd 0.55: four of their errors.
    assert np.median(share) == pytest.approx(np.median(shares_by_unit), abs=0.05)


def driven(path, gains=(15.0, 15.0), terms=({}, {}), **facts):
    """Units that are known exactly, and driven by sources of some gain, with residual terms."""
    folders = []
    for name, gain, own in zip("ABCDE", gains, terms, strict=False):
        draws = {n: np.full((2, 50), m) for n, m in {**MEANS, "gain": gain, **own}.items()}
        seen = {"tests": json.dumps(TESTS), "y_peak": 5e-3, "substeps": 2, **facts}
        folders.append(a_run(path / name, draws=draws, attrs=seen, inputs={"a": name}, box=False,
                             units={**UNITS, "gain": "N/(kg V)"})[0])  # fmt: skip
    return folders


def test_units_that_do_not_scatter_predict_as_the_one_that_was_measured(tmp_path):
    folders = driven(tmp_path, terms=({"residual_upper": -2e-4},) * 2)
    fleet = fleet_of(folders)
    measured_basis = basis_of(read_result(folders[0])[1])
    test = planned_tones(measured_basis, (17.0, 18.5), 0.3)
    expected = predict(measured_basis, test, Request(20))
    prediction = jbw.new_prediction(population(fleet, 1e-12), fleet, test, num_draws=20)
    assert prediction.attrs["y_peak_fitted"] == expected.attrs["y_peak_fitted"]
    for name in ("model_magnitude", "model_magnitude_3"):
        np.testing.assert_allclose(prediction[name].values, expected[name].values, rtol=1e-8)
    # What scatters between units widens the band of one of them.
    wide = jbw.new_prediction(population(fleet, 0.05), fleet, test, num_draws=20)
    assert np.all(
        np.ptp(wide["model_magnitude"].values, axis=0)
        > 0.01 * expected["model_magnitude"].values[1]
    )


def test_gains_are_those_of_the_measured_units(tmp_path):
    fleet = fleet_of(driven(tmp_path / "two", gains=(14.0, 16.0)))
    assert set(new_units(population(fleet, 1e-3), fleet)["gain"]) == {14.0, 16.0}
    facts = {"held": json.dumps({"gain": 15.0})}
    held = [a_run(tmp_path / name, inputs={"a": name}, attrs=facts)[0] for name in "AB"]
    fleet = fleet_of(held)
    assert set(new_units(population(fleet, 1e-3), fleet)["gain"]) == {15.0}
    lacking = fleet_of([held[0], a_run(tmp_path / "C", inputs={"a": "C"})[0]])
    fleet_population = population(lacking, 1e-3)
    assert "gain" not in new_units(fleet_population, lacking)
    test = planned_tones(basis_of(new_unit(fleet_population, lacking)), (18.0,), 0.1)
    with pytest.raises(DataError, match="lacks gain") as caught:
        jbw.new_prediction(fleet_population, lacking, test)
    assert "State `gain`" in caught.value.remedy


def test_the_gain_of_a_new_unit_is_that_of_the_draw_that_was_moved(tmp_path):
    """No unit knows the share of the joint, and a move leaves it: so it marks the draws."""
    folders = []
    for seed, name in enumerate("AB"):
        rng = np.random.default_rng(seed)
        draws = {n: m * np.exp(1e-3 * rng.standard_normal((2, 50))) for n, m in MEANS.items()}
        along = np.exp(0.5 * rng.standard_normal((2, 50)))  # the ridge: alpha delta, alpha gamma
        draws = draws | {"alpha": draws["alpha"] * along}
        draws |= {n: draws[n] / along for n in ("delta", "gamma")}
        draws["gain"] = 100.0 * draws["alpha"] / draws["omega_n"] ** 2
        folders.append(a_run(tmp_path / name, draws=draws, inputs={"a": name}, box=False,
                             units={**UNITS, "gain": "N/(kg V)"})[0])  # fmt: skip
    fleet = fleet_of(folders)
    drawn = new_units(population(fleet, 0.05), fleet, seed=7, num=400)
    np.testing.assert_allclose(drawn["gain"], 100.0 * drawn["alpha"] / drawn["omega_n"] ** 2)
    assert len(set(drawn["gain"])) > 100
    assert np.std(np.log(drawn["omega_n"])) > 0.02  # the draws were moved


def test_noise_and_run_scatter_of_the_units_go_with_a_new_one(tmp_path):
    folders = driven(tmp_path, scatter=[0.3, 2e-4])
    fleet = fleet_of(folders)
    for k, name in enumerate("AB"):
        held = fleet[name].to_dataset()
        held["noise"] = ("label", [1e-3 * (k + 1)])
        fleet[name].dataset = held.assign_coords(label=np.array(["weak"], object))
    basis = basis_of(new_unit(population(fleet, 1e-3), fleet))
    assert basis.scatter == (0.3, 2e-4)
    test = planned_tones(basis, (17.0, 18.5), 0.05)
    prediction = predict(basis, test, Request(20))
    # The mean of both units' tests alike, 1 and 2 mm/s; none of them is this one.
    assert prediction.attrs["noise_std"] == pytest.approx(1.5e-3, rel=1e-12)
    assert prediction.attrs["noise"] == "median of the fitted tests of the test's kind"


def test_residual_constants_scatter_as_student_s_t_says(tmp_path):
    """Of five units known exactly: mean + s sqrt(1 + 1/5) t_4, both terms along one line."""
    upper = np.array([-1.0, 0.5, 2.0, 0.0, 1.0]) * 1e-5
    terms = [{"residual_upper": u, "residual_lower": 1.0 - 2e4 * u} for u in upper]
    fleet = fleet_of(driven(tmp_path, gains=(15.0,) * 5, terms=terms))
    drawn = new_terms(fleet, np.random.default_rng(0), 4000)
    expected = student(4, upper.mean(), upper.std(ddof=1) * np.sqrt(1.2))
    assert kstest(drawn["residual_upper"], expected.cdf).pvalue > 1e-3
    np.testing.assert_allclose(drawn["residual_lower"], 1.0 - 2e4 * drawn["residual_upper"])


def test_terms_that_not_every_unit_has_are_left_out_and_said(tmp_path):
    mode = {"neighbour_1_omega": 140.0, "neighbour_1_zeta": 0.01, "neighbour_1_share": 0.1}
    terms = (
        {"residual_upper": 1e-5, "residual_lower": 0.5, **mode},
        {"residual_upper": 2e-5, **mode},
    )
    fleet = fleet_of(driven(tmp_path, terms=terms))
    assert terms_of(fleet) == (["residual_upper"], ["residual_lower", *mode])
    basis = basis_of(new_unit(population(fleet, 1e-3), fleet))
    assert "residual_upper" in basis.posterior
    assert not {*mode, "residual_lower"} & set(basis.posterior)
    prediction = predict(basis, planned_tones(basis, (17.0, 18.5), 0.3), Request(20))
    assert prediction.attrs["lacking"] == ", ".join(["residual_lower", *mode])
    assert "is predicted without residual_lower" in " ".join(warnings_of(prediction))


CAMPAIGN = """
[campaign]
name = "the next one"
[[test]]
name = "weak"
kind = "sweep"
files = "weak.h5"
level = 1e-4
channels = { input = "input", velocity = "velocity" }
units = { input = "V", velocity = "m/s" }
"""


def campaign_of(path):
    """A burst so weak that the joint sticks: a linear oscillator of gain 15, by SciPy."""
    t = np.arange(32 * 256) / (32 * 128.0)
    u = 1e-4 * np.sin(2 * np.pi * 18.0 * t) * np.sin(np.pi * t / 2.0) ** 4
    omega_n, zeta = MEANS["omega_n"], MEANS["zeta"]
    v = lsim(([15.0, 0.0], [1.0, 2 * zeta * omega_n, omega_n**2]), u, t)[1]
    samples, units = {"input": u[::32], "velocity": v[::32]}, {"input": "V", "velocity": "m/s"}
    path.mkdir()
    write_hdf5(path / "weak.h5", Record(128.0, samples, units))
    (path / "campaign.toml").write_text(CAMPAIGN)
    return path / "campaign.toml"


def test_the_tests_of_a_campaign_are_predicted_from_the_folder_of_a_population(tmp_path, capsys):
    """Typed as a user does: collected units, their population's folder, the next one's campaign."""
    fleet = fleet_of(driven(tmp_path))
    folder = tmp_path / "population"
    folder.mkdir()
    new_unit(population(fleet, 0.01), fleet).to_netcdf(folder / "population.nc", engine="h5netcdf")
    (folder / "population.json").write_text(json.dumps({"new_unit": {"torque": 8.0}}))
    file = campaign_of(tmp_path / "new")
    arguments = ["predict", str(folder), "--draws", "20", "--json", "--campaign", str(file)]
    assert run(arguments) == 0
    (row,) = json.loads(capsys.readouterr().out)["predictions"]
    # Units scatter by a part in a hundred about the one that was measured, bands are of that.
    assert row["test"] == "weak"
    assert row["coverage"] > 0.9
    assert row["half_width"] > 0.02
    file_names = {path.name for path in (folder / "predictions").iterdir()}
    assert file_names == {"predictions.nc", "predictions.json", "figures"}
    assert row["y_peak"]["0.005"] < row["y_peak"]["0.995"]
    # Another torque than that of the population is refused, whatever the tests.
    file.write_text(CAMPAIGN + "[assembly]\ntorque = 12\n")
    assert run([*arguments, "--out", str(tmp_path / "again")]) == 3
    assert "tightened to 12 N m" in " ".join("".join(capsys.readouterr()).split())


def test_what_the_folder_of_a_population_cannot_predict_is_said(tmp_path, capsys):
    fleet = fleet_of(driven(tmp_path))
    folder = tmp_path / "population"
    folder.mkdir()
    tree = new_unit(population(fleet, 0.01), fleet)
    tree.to_netcdf(folder / "population.nc", engine="h5netcdf")
    (folder / "population.json").write_text(json.dumps({"new_unit": {"torque": 8.0}}))
    arguments = ["predict", str(folder), "--tone", "18", "--level", "0.05", "--json"]
    assert run(["predict", str(folder)]) == 2
    assert "the campaign of the unit to predict" in " ".join(capsys.readouterr().err.split())
    assert require_same_torque(folder, 8.0) == 8.0
    assert require_same_torque(tmp_path / "A", 12.0) is None  # a run is for its own joint
    with pytest.raises(DataError, match=r"tightened to 12 N m, but .* units at 8 N m") as caught:
        require_same_torque(folder, 12.0)
    assert "jbw population FLEET --torque 12" in caught.value.remedy
    (folder / "population.nc").write_text("cut by a crash")
    assert run([*arguments, "--out", str(tmp_path / "again")]) == 3
    assert "cannot be read" in capsys.readouterr().out
