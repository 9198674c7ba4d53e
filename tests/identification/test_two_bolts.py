"""Two bolts of two lapped beams, from sweeps of one mode or two: what is known, fitted and told."""

import json
from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
import two_bolts
import xarray as xr
from exported import rows
from full_model import joints_read, moved
from pasted import pasted
from scipy import stats
from sustained import sustained

import jbw
from jbw.campaign.load import load_campaign
from jbw.campaign.settings import Identify
from jbw.cli import run
from jbw.errors import ConfigError
from jbw.identification.assemble import assemble, measured_in
from jbw.identification.assembled import joint_bounds
from jbw.identification.coordinates import box_of
from jbw.identification.joint_answers import joints_finding, joints_group
from jbw.identification.joint_modes import joint_modes
from jbw.identification.laplace import fit_alone
from jbw.inference.space.box import bounds_by_name
from jbw.lab.calibration import sbc
from jbw.observables.decay import matched
from jbw.observables.drives import told_by
from jbw.oscillator.modes.parameters import structure_of
from jbw.oscillator.oscillator import oscillator_of
from jbw.rig.assemblies import lapped_beams
from jbw.study.numpyro_model import numpyro_model
from jbw.verification.predict import Request, predict
from jbw.verification.predictive_basis import basis_of

RARE = 1e-4  # probability that a test of a right fit fails


def quietly(_):
    pass


@pytest.fixture(scope="module")
def stuck():
    """Sweeps of bolts in full stick, which cost nothing."""
    return two_bolts.campaign(bolts=None)


@pytest.fixture(scope="module")
def data(stuck):
    return assemble(measured_in(stuck, quietly))


def test_the_parameters_have_the_joints_names_and_the_model_holds_the_rest(stuck, data):
    known = told_by(data.parts, data.held)
    prior = box_of(stuck.settings, data, known)
    assert set(prior.names) == set(two_bolts.truth())
    model = two_bolts.reduced()
    # A measured force pushes the first mode by b_1, and the tip sees it by c_1.
    assert data.held["gain"] == pytest.approx(model.b[0] * model.c[0, 0])
    for name, value in two_bolts.truth().items():
        low, high = bounds_by_name(prior)[name]
        assert low < value < high, name
    # Lines are 1 Hz apart and noise is 1 % of the motion.
    assert known["omega_n"] == pytest.approx(model.omega[0], rel=1e-3)
    assert known["omega_2"] == pytest.approx(model.omega[1], rel=1e-3)


def test_a_structure_by_names_is_the_reduced_model_with_its_laws(data):
    theta = {**data.held, **two_bolts.truth()}
    named = structure_of(theta, two_bolts.LAWS)
    stated = two_bolts.reduced(two_bolts.BOLTS).structure()
    np.testing.assert_allclose(named.omega_n, stated.omega_n, rtol=1e-12)
    np.testing.assert_array_equal(named.h, stated.h)
    np.testing.assert_array_equal(named.c, stated.c)
    np.testing.assert_allclose(float(theta["gain"]) * named.b, stated.b, rtol=1e-12)
    assert [len(laws) for laws in named.laws] == [1, 1]
    assert named.laws[1][0].parameters() == dict(
        zip(("alpha", "delta", "gamma"), two_bolts.BOLTS[1], strict=True)
    )


def test_the_first_mode_feels_the_sum_of_all_joints(data):
    theta = {**data.held, **two_bolts.truth()}
    model, y = two_bolts.reduced(two_bolts.BOLTS), jnp.array([1e-5, 1e-3])
    found = oscillator_of(theta, two_bolts.LAWS).loop(y)
    stiffness, damping = 0.0, 0.0
    for joint, row in zip(model.joints, model.H, strict=True):
        h, reach = row[0], abs(row[0] / model.c[0, 0])
        loop = joint.laws[0].loop(reach * y)
        stiffness, damping = stiffness + h**2 * loop.stiffness, damping + h**2 * loop.damping
    np.testing.assert_allclose(found.stiffness, stiffness, rtol=1e-12)
    np.testing.assert_allclose(found.damping, damping, rtol=1e-12)


def test_joints_of_a_tie_share_one_set_of_parameters():
    tied = two_bolts.campaign(("first",), laws=("bouc_wen@bolt_1=bolt_2",), bolts=None)
    data = assemble(measured_in(tied, quietly))
    prior = box_of(tied.settings, data, told_by(data.parts, data.held))
    assert [name for name in prior.names if "@" in name] == [
        f"{name}@bolt_1" for name in ("alpha", "delta", "gamma")
    ]
    theta = {**data.held, **{name: 1.0 for name in prior.names}}
    named = structure_of(theta, data.laws)
    assert named.laws[0] == named.laws[1]


def test_prior_bounds_reach_no_further_than_the_joint_in_full_stick():
    stated = {"prior": {"alpha@bolt_1": (1e6, 2e7)}}
    campaign = two_bolts.campaign(("first",), settings=stated, bolts=None)
    data = assemble(measured_in(campaign, quietly))
    with pytest.raises(ConfigError, match=r"`alpha@bolt_1`: the upper bound must be below 1\.5e"):
        box_of(campaign.settings, data, told_by(data.parts, data.held))


def test_two_laws_at_a_joint_share_its_stiffness(data):
    alone, both = (
        joint_bounds(data.modes, SimpleNamespace(laws=laws, parts=data.parts), {}, 0.01)[
            "alpha@bolt_1"
        ]
        for laws in (("bouc_wen@bolt_1",), ("bouc_wen@bolt_1", "jenkins_1@bolt_1"))
    )
    assert both == (alone[0], alone[1] / 2)


def test_too_few_steps_for_the_residual_modes_are_refused_and_the_remedy_cures():
    campaign = two_bolts.campaign(("first",), settings={"substeps": 1}, bolts=None)
    with pytest.raises(ConfigError, match="the residual mode at 600 Hz") as caught:
        assemble(measured_in(campaign, quietly))
    cured = replace(campaign, settings=pasted(caught.value.remedy).settings)
    # 600 Hz moves by 0.92 rad in an eighth of a sample.
    assert assemble(measured_in(cured, quietly)).parts[0].substeps == 8


def test_other_kinds_of_tests_and_laws_are_refused(stuck):
    loop = replace(stuck, tests=(replace(stuck.tests[0], kind="loop"),))
    with pytest.raises(ConfigError, match="must be a sweep, a multisine or free") as caught:
        measured_in(loop, quietly)
    assert "Leave the test out" in caught.value.remedy
    free = replace(stuck.tests[0], kind="decay", band_hz=(18.0, 130.0), point="slip")
    with pytest.raises(ConfigError, match="must be measured at the first point"):
        measured_in(replace(stuck, tests=(*stuck.tests, free)), quietly)
    narrow = replace(free, point="", band_hz=(18.0, 60.0))
    with pytest.raises(
        ConfigError, match=r"must contain all modes.* 32\.16, 90\.47 Hz, but is 18 to"
    ):
        measured_in(replace(stuck, tests=(*stuck.tests, narrow)), quietly)
    slips = tuple(replace(test, point="tip") for test in stuck.tests)
    with pytest.raises(ConfigError, match="measured at the first point, `tip`, but"):
        measured_in(replace(stuck, tests=slips), quietly)
    products = Identify.of({"coordinates": "products"})
    with pytest.raises(ConfigError, match="coordinates must be auto or paper"):
        measured_in(replace(stuck, settings=products), quietly)
    damped = ("quadratic_damping@bolt_1", "bouc_wen@bolt_2")
    joints = replace(stuck.joints, laws=damped)
    with pytest.raises(ConfigError, match="is a damper"):
        measured_in(replace(stuck, laws=damped, joints=joints), quietly)


def test_springs_of_one_joint_are_no_reference_and_the_remedy_is_taken(stuck):
    settings = Identify.of({"compare_with": ["linear", "cubic"]})
    with pytest.raises(ConfigError, match="compare_with must be linear") as caught:
        measured_in(replace(stuck, settings=settings), quietly)
    cured = pasted(caught.value.remedy).settings
    measured_in(replace(stuck, settings=cured), quietly)


def standardised(fit):
    """Squared distance of the truth from a fit, in its covariance."""
    away = np.array([fit.theta[name] - x for name, x in two_bolts.truth().items()])
    order = [list(fit.theta).index(name) for name in two_bolts.truth()]
    covariance = fit.covariance[np.ix_(order, order)]
    return float(away @ np.linalg.solve(covariance, away))


@pytest.mark.release  # the run below identifies them from a file on
def test_a_fit_of_two_modes_finds_the_truth_of_both_bolts():
    seen = measured_in(two_bolts.campaign(), quietly)
    found = fit_alone(seen, seed=0, report=quietly)
    fit = found.joint.fitted.fit
    # Of ten parameters, chi-square by chance.
    assert standardised(fit) < stats.chi2.isf(RARE, len(fit.theta))
    draws, data = found.joint.draws, found.joint.fitted.data
    modes = joint_modes(draws, data, fit.theta)
    assert modes is not None
    group = joints_group(draws, data, modes)
    assert group["identified"].values.all()
    assert joints_finding(group).status == "ok"
    # Energy shares are those of the model; mode 2 hardly moves the first bolt.
    assert float(group["energy_share"].sel(joint="bolt_1", mode=2)) < 0.001
    assert float(group["loss_share"].sel(joint="bolt_2", mode=2, quantile=0.5)) > 0.98


@pytest.mark.release  # test_joint_backbones.py has the sum by scipy, and the finding
def test_weak_sweeps_of_one_mode_tell_the_sum_of_the_bolts_alone():
    bolts = (two_bolts.BOLTS[0],) * 2
    weak = two_bolts.campaign(("first",), bolts=bolts, weaker=8.0)
    found = fit_alone(measured_in(weak, quietly), seed=0, report=quietly)
    fitted = found.joint.fitted
    modes = joint_modes(found.joint.draws, fitted.data, fitted.fit.theta)
    assert modes is not None
    group = joints_group(found.joint.draws, fitted.data, modes)
    assert not group["identified"].values.any()
    finding = joints_finding(group)
    assert finding is not None
    assert finding.status == "usable"
    assert "bolt_1, bolt_2" in finding.reason
    # The mode by itself at its largest motion, by scipy, the shape free.
    model, a = two_bolts.reduced(bolts), float(group["amplitude"].values[0])
    exact = sustained(model, bolts, [a / 2, a], 0)[-1]
    # The sum of both bolts within 2 %.
    change = float(group["frequency_change"].sel(mode=1, quantile=0.5))
    assert change == pytest.approx(exact.omega / model.omega[0] - 1, rel=0.02)
    # Damping trades with that of the structure: within four standard errors.
    low, added, high = group["damping_added"].sel(mode=1).values
    std = (high - low) / (2 * stats.norm.ppf(0.995))
    assert std < 0.05 * added
    assert added == pytest.approx(exact.damping.sum(), abs=4 * std)


@pytest.fixture(scope="module")
def identified(tmp_path_factory):
    """Return the campaign file of tight bolts, the folder of its run, and what was printed."""
    folder = tmp_path_factory.mktemp("tight")
    path, out = two_bolts.written(folder), folder / "run"
    with redirect_stdout(StringIO()) as printed:
        run(["identify", str(path), "--quick", "--out", str(out)])
    return path, out, printed.getvalue()


@pytest.mark.slow
def test_a_campaign_file_is_identified_from_end_to_end(identified):
    path, out, printed = identified
    assert "mode 2 is damped mainly by bolt_2" in printed.replace("\n", " ")
    summary = json.loads((out / "summary.json").read_text())
    assert [row["verdict"] for row in summary["joints"]["joints"]] == ["identified"] * 2
    run(["report", str(out), "--figures", "png"])
    page = (out / "report.html").read_text()
    assert "softening in every mode" in page
    for drawn in ("extra_assembly", "extra_joint_loops"):
        assert (out / "figures" / f"{drawn}.png").is_file()
    assert "position" in xr.open_datatree(out / "posterior.nc")["assembly"]
    assert run(["export", str(out), "--to", "opensees"]) == 0
    joints = joints_read((out / "export" / "joints.tcl").read_text())
    assert [set(joint.weights) for joint in joints] == [{"3:ry", "101:ry"}, {"4:ry", "102:ry"}]
    study = jbw.load_study(out)
    assert study.tree["posterior"]["alpha@bolt_1"].attrs["units"] == "N/m"
    # What the model leaves of a record is its noise, 1 % of the motion.
    assert study.predict("first at 0.3 N").attrs["nrmse"] == pytest.approx(0.01, rel=0.2)
    # Free decays from sweeps: modes that do not ring begin where the joints hold them, which costs
    # 0.2 % of the motion, and the parameters are known to as much.
    free = predict(basis_of(study.tree), two_bolts.impacts(noise_ratio=1e-6), Request(num_draws=50))
    assert free.attrs["nrmse"] < 5e-3
    assert free.attrs["coverage"] > 0.9  # by the parameters' band alone
    assert load_campaign(path).laws == two_bolts.LAWS


@pytest.mark.slow
def test_free_decays_tell_modes_and_motion_of_the_bolts():
    campaign = replace(two_bolts.campaign(bolts=None), tests=(two_bolts.impacts(),))
    data = assemble(measured_in(campaign, quietly))
    assert data.modes is not None
    assert data.modes.hz == pytest.approx([32.158, 90.469], abs=1e-3)
    assert data.held["gain"] == 1.0
    (part,) = data.parts
    # Bolts that slip lower the frequencies by less than a per cent.
    first = part.shown().first_values()
    model = two_bolts.reduced()
    assert first["omega_n"] == pytest.approx(model.omega[0], rel=0.01)
    assert first["omega_2"] == pytest.approx(model.omega[1], rel=0.01)
    assert part.shown().peaks_of_modes == pytest.approx(np.asarray(part.amplitude).max(axis=0))


@pytest.mark.release  # the identified run predicts them, above
def test_the_truth_leaves_little_of_free_decays_but_noise():
    """Modes that do not ring begin where the joints hold them: 0.2 % of the motion is missed."""
    campaign = replace(two_bolts.campaign(bolts=None), tests=(two_bolts.impacts(noise_ratio=1e-6),))
    data = assemble(measured_in(campaign, quietly))
    left = np.asarray(matched({**data.held, **two_bolts.truth()}, data.parts[0]).residual)
    measured = np.asarray(data.parts[0].mean)
    missed = np.linalg.norm(left, axis=1) / np.linalg.norm(measured, axis=1)
    assert np.all(missed < 2e-3)


@pytest.mark.release
def test_a_fit_of_free_decays_alone_finds_the_truth_of_both_bolts():
    campaign = replace(two_bolts.campaign(bolts=None), tests=(two_bolts.impacts(),))
    found = fit_alone(measured_in(campaign, quietly), seed=0, report=quietly)
    fit = found.joint.fitted.fit
    truth = two_bolts.truth()
    assert set(fit.theta) == set(truth)
    # In logarithms: alpha and delta are known to a tenth, along a ridge of one product.
    values = np.array(list(fit.theta.values()))
    away = np.log(values / np.array([truth[name] for name in fit.theta]))
    covariance = fit.covariance / np.outer(values, values)
    square = float(away @ np.linalg.solve(covariance, away))
    assert square < stats.chi2.isf(RARE, len(values))


@pytest.mark.slow
def test_two_runs_name_the_bolt_that_was_loosened(identified, tmp_path, capsys):
    """A tenth less preload, and slip at a tenth less of motion: delta and gamma are larger."""
    first, (alpha, delta, gamma) = two_bolts.BOLTS
    loosened = (first, (alpha, delta / 0.9, gamma / 0.9))
    path, loose = two_bolts.written(tmp_path, bolts=loosened, seed=1), tmp_path / "run"
    run(["identify", str(path), "--quick", "--out", str(loose)])
    capsys.readouterr()
    run(["diff", str(identified[1]), str(loose), "--json"])
    record = json.loads(capsys.readouterr().out)
    assert {row["joint"]: row["changed"] for row in record["joints"]} == {
        "bolt_1": False,
        "bolt_2": True,
    }
    assert record["statements"][0].startswith("bolt_2 has changed: ")


@pytest.mark.release  # test_exporting_joints.py moves the whole matrices
def test_the_whole_matrices_with_the_exported_joints_move_within_the_predicted_bands(
    tmp_path, monkeypatch
):
    """18 degrees of freedom by another integrator, with the frequencies that were identified.

    The reduction to 320 Hz costs 4e-4 of the tip's motion, and a prediction fits how a record
    begins, which its noise moves by 8e-4. Bands of the parameters alone are narrower than that
    where the bolts hardly slip yet, and wider where they slip.
    """
    monkeypatch.setattr(two_bolts, "TO_HZ", 320.0)
    path, out = two_bolts.written(tmp_path), tmp_path / "run"
    assert run(["identify", str(path), "--quick", "--out", str(out)]) == 0
    assert run(["export", str(out)]) == 0
    joints = joints_read((out / "export" / "joints.tcl").read_text())
    of_modes = [float(r["value"]) for r in rows(out / "export" / "parameters.csv")[:4]]
    modes = [of_modes[:2], of_modes[2:]]
    study = jbw.load_study(out)
    for name, (band_hz, forces) in two_bolts.SWEEPS.items():
        u = two_bolts.sweep(band_hz, forces[1])
        velocity, _ = moved(
            lapped_beams(), joints, u, two_bolts.FS, zeta=two_bolts.ZETA, factor=512, modes=modes
        )
        low, middle, high = study.predict(f"{name} at {forces[1]:g} N")["model_band"].values
        rms = np.std(velocity)
        assert np.std(velocity - middle) < 2e-3 * rms
        slips = high - low > 2e-3 * rms
        assert np.mean(slips) > 0.3
        assert np.mean(((low <= velocity) & (velocity <= high))[slips]) > 0.95
        noise = two_bolts.NOISE * rms * stats.norm.ppf(0.995)
        assert np.all((low - noise <= velocity) & (velocity <= high + noise))


def test_what_knows_one_joint_refuses_several(stuck):
    for asked in (sbc, numpyro_model):
        with pytest.raises(ConfigError, match=r"one joint, but the campaign has .* 2 \[\["):
            asked(stuck)
