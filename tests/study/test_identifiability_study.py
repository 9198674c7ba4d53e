"""Which parameters a campaign's data know: loops strong and weak, written by the law itself."""

import json

import jax
import numpy as np
import pytest
import xarray as xr
from damper_campaign import TRUTH, write_campaign

import jbw.cli.progress
from jbw import rig
from jbw.campaign.load import load_campaign
from jbw.campaign.settings import Identify
from jbw.cli import run
from jbw.identification.coordinates import combinations
from jbw.identification.prepare import prepare
from jbw.inference.space.box import value_of
from jbw.observables.dataset import Dataset
from jbw.observables.line_fit import LineReading
from jbw.oscillator.oscillator import oscillator_of
from jbw.report.messages import identified
from jbw.study.identifiability import as_group, identifiability, look, look_again, reached

PRODUCTS = {"alpha_delta": TRUTH["alpha"] * TRUTH["delta"]}
PRODUCTS |= {"alpha_gamma": TRUTH["alpha"] * TRUTH["gamma"]}


@pytest.fixture(scope="module")
def weak(tmp_path_factory):
    path = write_campaign(tmp_path_factory.mktemp("weak"), amplitude=2e-4)
    return identifiability(load_campaign(path), profiles=True)


def test_strong_loops_know_every_parameter(tmp_path):
    found = identifiability(load_campaign(write_campaign(tmp_path, amplitude=0.01)))
    known = found.information.known
    assert found.profiles == {}
    for name, truth in {**TRUTH, **PRODUCTS}.items():
        assert known[name].relative < 0.01
        assert abs(known[name].value - truth) < 4 * known[name].sd
    row = known["omega_n"]
    shown = identified.with_error("omega_n", row.value, row.sd, row.relative)
    (grade,) = (each for each in found.statements if shown in each)
    assert grade.startswith(identified.GRADES["known"].partition("{")[0])


def test_weak_loops_know_the_products_and_not_the_factors(weak):
    known = weak.information.known
    for name, truth in PRODUCTS.items():
        assert known[name].relative < 0.05
        # Along the ridge the products bend by the second order of its width.
        assert abs(known[name].value / truth - 1) < 0.05
    assert all(known[name].relative > 0.15 for name in ("alpha", "delta", "gamma"))
    factor = min(known["alpha"].relative, known["delta"].relative)
    tied = identified.tie("alpha*delta", factor / known["alpha_delta"].relative)
    assert {tied, identified.waterfall(1, 1)} <= set(weak.statements)


def test_profiles_hold_the_truth_and_are_far_wider_than_the_products(weak):
    for name, truth in TRUTH.items():
        low, high = weak.profiles[name].interval
        assert low < truth < high
    low, high = weak.profiles["alpha"].interval
    assert high / low > 2
    along = weak.profiles["alpha"].path
    product = along["alpha"] * along["delta"]
    assert np.ptp(product) / product.mean() < 0.2 * np.ptp(along["alpha"]) / along["alpha"].mean()


def test_noise_alone_knows_nothing_of_the_joint():
    mean, sd = np.array([118.1, 0.00444, 15.0]), np.array([0.01, 2e-5, 0.01])
    data = Dataset.of([LineReading.of(mean, np.diag(sd**2), 2e-5, "noise")])
    prior = {name: list(rig.PRIOR[name]) for name in ("alpha", "delta", "gamma")}
    settings = Identify(prior=prior, coordinates="paper")
    found = look(prepare(jax.random.split(jax.random.key(0)), data, settings), with_profiles=False)
    known = found.information.known
    assert all(known[name].ratio < 0.1 for name in ("omega_n", "zeta", "gain"))
    for name in (*prior, "alpha_delta", "alpha_gamma"):
        assert known[name].ratio > 0.99
    said = "Not identified by the data, only limited by the prior: "
    assert f"{said}alpha, delta, gamma, alpha*delta and alpha*gamma." in found.statements


def test_starts_that_differ_by_nothing_reached_the_same_optimum():
    assert reached(np.array([1e-20, 1e-12, 0.01, 3.0])) == 3
    assert reached(np.array([200.0, 201.9, 202.1, np.inf])) == 2


def after(weak, draws):
    """The answer after sampling, from draws made here."""
    shaped = {name: (("chain", "draw"), values.reshape(2, -1)) for name, values in draws.items()}
    return look_again(weak.fitted, xr.Dataset(shaped), Identify())


def test_after_sampling_the_box_is_told_from_the_data(weak):
    rng, box = np.random.default_rng(0), weak.fitted.box
    bounds = zip(np.asarray(box.lower), np.asarray(box.upper), strict=True)
    draws = {n: rng.uniform(a, b, 4000) for n, (a, b) in zip(box.names, bounds, strict=True)}
    draws["omega_n"] = 60 + 0.01 * rng.standard_normal(4000)
    found = after(weak, draws)
    assert found.contraction["omega_n"] > 0.99
    for name in ("alpha", "delta", "gamma", "alpha_delta"):
        # The variance of 4000 draws is right to some per cent.
        assert abs(found.contraction[name]) < 0.1
    # A uniform variable's mean moves by 0.05 sqrt(12); 4000 draws are right to 0.01.
    assert found.sensitivity["alpha"].shift == pytest.approx(0.173, abs=0.03)
    assert found.sensitivity["omega_n"].shift < 0.05
    (said,) = (each for each in found.statements if each.startswith("The prior bounds affect"))
    assert "alpha (by 0.1" in said
    # Which are identified is for the draws' grades to say, and not for the fit beside them.
    grades = tuple(grade.partition("{")[0] for grade in identified.GRADES.values())
    assert not [each for each in found.statements if each.startswith(grades)]


def test_the_record_is_plain_and_the_group_survives_a_file(weak, tmp_path):
    draws = {name: np.linspace(0.9, 1.1, 100) * v for name, v in weak.fitted.fit.theta.items()}
    full = after(weak, draws)
    for found in (weak, full):
        record = json.loads(json.dumps(found.summary(), allow_nan=False))
        assert list(record["parameters"]) == list(weak.fitted.box.names)
        assert list(record["combinations"]) == ["alpha_delta", "alpha_gamma"]
        assert record["waterfall"]["reached"] >= 1
        group = as_group(found)
        assert all({"units", "long_name"} <= set(each.attrs) for each in group.data_vars.values())
        path = tmp_path / f"{len(found.contraction)}.nc"
        group.to_netcdf(path, engine="h5netcdf")
        with xr.open_dataset(path, engine="h5netcdf") as stored:
            xr.testing.assert_identical(stored.load(), group)
    assert set(weak.summary()["profiles"]) == set(TRUTH)
    assert "parameter_contraction" in as_group(full)


def test_combinations_are_the_same_in_either_coordinates():
    theta = {"omega_n": 118.0, "zeta": 0.004, "softening": 12.0, "opening": 1.2, "share": 0.04}
    joint = oscillator_of(theta, ["bouc_wen"])  # pyright: ignore[reportArgumentType]
    expected = {name: joint.parameters()[name] for name in ("alpha", "delta", "gamma")}
    expected["alpha_delta"] = expected["alpha"] * expected["delta"]
    expected["alpha_gamma"] = expected["alpha"] * expected["gamma"]
    found = {each.name: value_of(each, theta) for each in combinations(theta)}
    assert found == pytest.approx(expected, rel=1e-12)
    paper = {each.name: value_of(each, expected) for each in combinations(("alpha", "gamma"))}
    assert paper == pytest.approx({"alpha_gamma": expected["alpha_gamma"]}, rel=1e-12)


@pytest.fixture
def quiet_jax(monkeypatch):
    """The tests have set up JAX already."""
    monkeypatch.setattr(jbw.cli.progress, "prepare_process", lambda: None)


def test_the_command_prints_spectrum_and_words(tmp_path, capsys, quiet_jax):
    path = write_campaign(tmp_path, amplitude=2e-4)
    assert run(["identifiability", str(path), "--profiles"]) == 0
    streams = capsys.readouterr()
    for word in (
        "Information spectrum",
        "alpha*delta",
        "of the profile",
        identified.ONE_START,
    ):
        assert word in streams.out
    assert "Profile of gamma" in streams.err
    assert run(["identifiability", str(path), "--json", "--seed", "1"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["profiles"] == record["contraction"] == {}
    assert record["spectrum"][0]["ratio"] < 1e-3


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        ([], 2, "Missing argument"),
        (["none.toml"], 2, "none.toml"),
        (["CAMPAIGN", "--seed", "x"], 2, "--seed"),
        (["HELD"], 3, "no test to which the joint can be fitted"),
    ],
)
def test_bad_input_of_the_command(tmp_path, capsys, quiet_jax, arguments, code, says):
    for name, settings in (("CAMPAIGN", ""), ("HELD", 'hold_out = ["loop"]')):
        (tmp_path / name).mkdir()
        path = str(write_campaign(tmp_path / name, 1e-3, settings=settings))
        arguments = [path if each == name else each for each in arguments]
    assert run(["identifiability", *arguments]) == code
    streams = capsys.readouterr()
    assert says in streams.err
    assert "Traceback" not in streams.err
