"""Loads on several modes and joints: the balance of all modes, a Monte Carlo, refusals."""

import json
from pathlib import Path

import jax
import numpy as np
import pytest
from made_runs import a_test, a_tree

import jbw
from jbw.errors import ConfigError, ModelError
from jbw.forced.profiles import profile_of
from jbw.oscillator.modes.assembled import held_numbers
from jbw.study.study import Study

TAU = 2 * np.pi
# Made by `benchmarks/random_modes.py`, without jbw.
MONTE_CARLO = json.loads((Path(__file__).parents[1] / "golden_random_modes.json").read_text())
ONE_JOINT = {
    "omega_n": TAU * 20, "zeta": 0.004, "alpha": 1200.0, "delta": 300.0, "gamma": 60.0, "gain": 1.0,
    "omega_2": TAU * 47, "zeta_2": 0.005, "gain_ratio_2": 0.7, "shape_2": 0.8, "sign_2": -1.0,
    "coupling_2": 0.6,
}  # fmt: skip
LAWS = ("bouc_wen@one", "bouc_wen@two")


def study_of(theta, laws=("bouc_wen",), **changes):
    draws = {name: np.full(2, value) for name, value in {**theta, **changes}.items()}
    tree = a_tree(draws, seen=[a_test(0.1)])
    tree.attrs["laws"] = json.dumps(laws)
    # The displacement is measured, under a force per unit mass.
    seen = {"fitted": {"kind": "sweep", "source": "m/s^2", "response": "displacement"}}
    tree.attrs["tests"] = json.dumps(seen)
    return Study(tree, {})


def study_of_two_joints():
    """The structure of the Monte Carlo, as a run with matrices stores it."""
    stated = MONTE_CARLO["first mode"]["structure"]
    omega, zeta = TAU * np.array(stated["hz"]), np.array(stated["zeta"])
    h, b, c = (np.array(stated[name]) for name in "hbc")
    labels = ("one", "two")
    joints = dict(zip(labels, stated["joints"], strict=True))
    stiffness = {label: joint[0] for label, joint in joints.items()}
    held = held_numbers(omega, zeta, dict(zip(labels, h, strict=True)), stiffness, b, {"": c})
    laws = {
        f"{name}@{label}": value
        for label, joint in joints.items()
        for name, value in zip(("alpha", "delta", "gamma"), joint, strict=True)
    }
    driven = {"omega_n": omega[0], "zeta": zeta[0], "omega_2": omega[1], "zeta_2": zeta[1]}
    study = study_of({**driven, **laws, "gain": b[0] * c[0]}, LAWS)
    study.tree.attrs["held"] = json.dumps(held)
    return study


def balanced(study, hz, level):
    """Return the displacement under a force per unit mass, by harmonic balance of all modes."""
    one = jax.tree.map(lambda leaf: leaf[0], study.joints(2))
    found = jbw.steady_state(one, TAU * hz, level, num_harmonics=1)
    return np.abs(np.asarray(found.y)[..., 0]).reshape(len(hz), -1)[:, 0]


@pytest.mark.slow
@pytest.mark.parametrize("study", [study_of(ONE_JOINT), study_of_two_joints()], ids=["one", "two"])
def test_a_curve_across_two_modes_is_that_of_the_balance_of_all(study):
    level = 0.4
    found = study.response_curve(level, (12.0, 75.0), draws=2, harmonics=1)
    hz = found["freq"].values
    expected = balanced(study, hz[::10], level)
    # The amplitude is corrected to first order, from a table that is up to 1e-2 off.
    np.testing.assert_allclose(found["upward"].values[1][::10], expected, rtol=3e-4)
    assert np.all(np.isfinite(found["upward"].values))
    along = found["frequency"].values[0]
    near = np.nanargmin(np.abs(along - 30.0))
    np.testing.assert_allclose(
        found["amplitude"].values[0, near],
        balanced(study, along[near : near + 1], level),
        rtol=3e-3,
    )


def test_the_resonance_of_the_second_mode():
    study, level = study_of(ONE_JOINT), 5.0
    found = study.resonance([level], draws=2, harmonics=1, mode=2)
    peak = float(found["frequency"].values[1, 0])
    assert 46.0 < peak < 47.0
    hz = peak * (1 + 2e-3 * np.linspace(-1, 1, 9))
    # The measured point also moves in the first mode, by 1e-3 of the second.
    assert found["peak"].values[1, 0] == pytest.approx(balanced(study, hz, level).max(), rel=2e-3)


@pytest.mark.parametrize("case", ["first mode", "second mode", "both modes, weak"])
def test_random_vibration_is_that_of_a_monte_carlo(case):
    stated = MONTE_CARLO[case]
    rows = [(str(hz), str(stated["density"])) for hz in stated["band_hz"]]
    found = study_of_two_joints().random(profile_of(rows, "(m/s^2)^2/Hz"), draws=2)
    mean, error = stated["rms_y"]
    assert found["rms"].values[1] == pytest.approx(mean, abs=max(3 * error, 3e-3 * mean))
    both = "frequency_2" in found
    assert both == (case == "both modes, weak")


def test_modes_that_move_the_joint_at_the_same_time_are_refused():
    """In the Monte Carlo, the rms is 6 % below that of modes that move one by one."""
    stated = MONTE_CARLO["both modes, strong"]
    rows = [(str(hz), str(stated["density"])) for hz in stated["band_hz"]]
    with pytest.raises(ModelError, match="one mode at a time"):
        study_of_two_joints().random(profile_of(rows, "(m/s^2)^2/Hz"), draws=2)


def test_a_limit_holds_the_response_at_both_modes():
    study, limit = study_of(ONE_JOINT), 1e-4
    found = study.notch(1.0, limit, (15.0, 60.0), draws=2, harmonics=1)
    hz, allowed = found["freq"].values[::40], found["allowed"].values[1][::40]
    for one, level in zip(hz, allowed, strict=True):
        assert balanced(study, np.array([one]), level)[0] == pytest.approx(limit, rel=1e-4)


def test_uncoupled_modes_have_the_curve_of_each_alone():
    """Laws for each mode: near one mode, the other adds its response to a force."""
    law = {name: 2.0 * ONE_JOINT[name] for name in ("alpha", "delta", "gamma")}
    own = {f"{name}_mode_2": value for name, value in law.items()}
    theta = {
        name: x for name, x in ONE_JOINT.items() if name[:5] not in ("shape", "sign_", "coupl")
    }
    found = study_of({**theta, **own}).resonance([4.0], draws=2, harmonics=1, mode=2)
    alone = jbw.Oscillator(TAU * 47, 0.005, (jbw.laws.BoucWenLaw(**law),))
    motion = jbw.forced.equivalent_motion(alone)
    expected = jbw.forced.resonance(motion, np.array([[4.0 * 0.7]]))
    assert found["frequency"].values[1, 0] == pytest.approx(
        expected.peak.omega[0, 0] / TAU, rel=1e-6
    )


@pytest.mark.parametrize(
    ("call", "error", "match"),
    [
        (lambda s: s.shock("20 m/s^2,11ms"), ModelError, "one mode"),
        (lambda s: s.resonance([0.1], draws=2, mode=3), ConfigError, "mode"),
        (lambda s: s.resonance([0.1], draws=2, drive="base"), ConfigError, "participation"),
    ],
)
def test_what_does_not_hold_for_several_modes_is_refused(call, error, match):
    with pytest.raises(error, match=match):
        call(study_of(ONE_JOINT))


def test_modes_within_ten_widths_are_refused():
    with pytest.raises(ModelError, match="half-power widths"):
        study_of(ONE_JOINT, omega_2=TAU * 20.5).resonance([0.1], draws=2)


def test_an_internal_resonance_is_said():
    study = study_of(ONE_JOINT, omega_2=TAU * 59.0)
    found = study.resonance([1.0], draws=2, harmonics=1)
    assert any("odd multiple" in sentence for sentence in jbw.warnings_of(found))
