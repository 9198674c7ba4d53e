"""From beliefs to a plan: ranges, limits, repeats, what stays undetermined, what to combine."""

from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

from jbw.errors import ConfigError, DataError
from jbw.inference.space.box import bounds_by_name, box
from jbw.planning import proposals
from jbw.planning import prospects as planning_prospects
from jbw.planning.beliefs import Beliefs, Mode, after, before
from jbw.planning.description import parse
from jbw.planning.making import combine, ordered, plan_tests, rig_of, row
from jbw.planning.plan import PlannedSweep, ResponseNoise, Wish
from jbw.planning.proposals import (
    Reach,
    SteppedTable,
    SweepTable,
    TonesTable,
    displacement_for,
    propose,
)
from jbw.planning.prospects import Prospect, cost_sentence, peak_displacements, prospects
from jbw.report.messages.identified import undetermined
from jbw.report.messages.planning import cost

RANGES = {
    "omega_n": (110.0, 120.0),
    "zeta": (0.002, 0.008),
    "alpha": (200.0, 800.0),
    "delta": (100.0, 400.0),
    "gamma": (10.0, 40.0),
}
TONES = """
[plan]
natural_hz = 18.8
zeta = [0.004, 0.02]
alpha = [300.0, 800.0]
delta = [150.0, 600.0]
gamma = [15.0, 60.0]
gain = 15.0
noise = 5e-6
joints = 4
max_input = 0.5
max_repeats = 10
[tones]
levels = [0.2, 1.0]
frequencies = [5.0, 5.5, 6.0, 6.5]
dwell = 64.0
settle = 48.0
"""


def plain_beliefs(precision, num_joints=3):
    names = ("alpha", "delta")[: len(precision)]
    return Beliefs(
        joints={name: np.full(num_joints, 2.0) for name in names},
        names=names,
        scale=np.full((num_joints, len(names)), 2.0),
        precision=precision,
        box=box({name: (1.0, 4.0) for name in names}),
    )


def plain_prospect(information, seconds, level=1.0, y_peak=1e-3, num_joints=3):
    candidate = PlannedSweep(level, 10.0, 20.0, 10.0 / seconds, 0.0, 512.0)
    every = np.tile(np.asarray(information, float), (num_joints, 1, 1))
    return Prospect(candidate, every, np.full(num_joints, y_peak))


def test_draws_lie_in_their_ranges_and_the_prior_is_theirs():
    beliefs = before(RANGES, held={"gain": 3.0}, num_joints=4000, seed=1)
    for name, (low, high) in RANGES.items():
        assert low <= beliefs.joints[name].min() < beliefs.joints[name].max() <= high
    logs = np.log(np.stack([beliefs.joints[name] for name in beliefs.names]))
    # A Latin hypercube of 4000 points has the moments of a uniform law to a part in a thousand.
    np.testing.assert_allclose(
        np.sqrt(np.diag(np.linalg.inv(beliefs.precision))), logs.std(axis=1), rtol=1e-3
    )
    assert set(beliefs.joints["gain"]) == {3.0}


def test_a_share_ties_alpha_to_the_frequency():
    ranges = {**RANGES, "share": (0.02, 0.08)}
    del ranges["alpha"]
    beliefs = before(ranges, held={"gain": 1.0}, num_joints=4000, seed=1)
    assert beliefs.names == ("omega_n", "zeta", "alpha", "delta", "gamma")
    low, high = RANGES["omega_n"]
    expected_bounds = 0.02 * low**2, 0.08 * high**2
    assert bounds_by_name(beliefs.box)["alpha"] == pytest.approx(expected_bounds, rel=1e-12)
    logs = np.log(np.stack([beliefs.joints[name] for name in beliefs.names]))
    expected = np.cov(logs)
    # Correlations of 4000 points are known to 1/sqrt(4000), four of which are admitted.
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.abs((np.linalg.inv(beliefs.precision) - expected) / size).max() < 0.064


def test_a_mode_that_moves_the_joint_twice_as_far_is_swept_at_half_the_motion(monkeypatch):
    modes = [Mode(np.array([100.0]), np.array([1.0])), Mode(np.array([300.0]), np.array([2.0]))]
    monkeypatch.setattr(proposals, "modes_of", lambda _: modes)
    monkeypatch.setattr(proposals, "_decay", lambda _: 1.0)
    monkeypatch.setattr(proposals, "_steady_levels", lambda _, reach: [1.0] * len(reach.goals))
    monkeypatch.setattr(proposals, "_aimed", lambda shape, level, y, beliefs: y)
    reach = proposals.Reach(1024.0, 8e-3)
    found = proposals._sweeps(proposals.SweepTable(), SimpleNamespace(joints={}), reach)
    levels = [{c.level for c in found if (c.start_hz < 30.0) == first} for first in (True, False)]
    assert sorted(levels[0]) == pytest.approx(sorted(reach.goals))
    assert sorted(levels[1]) == pytest.approx(sorted(y / 2.0 for y in reach.goals))


def test_information_of_a_linear_residual_is_that_of_its_slopes(monkeypatch):
    """Of r = A theta about relative changes x of theta = t (1 + x) it is (A t)^T (A t)."""
    slopes = np.array([[3.0, -1.0], [0.5, 2.0], [1.0, 1.0]])  # value parameter
    joints = {"a": np.array([2.0, 4.0]), "b": np.array([-1.0, 0.5])}

    def linear(_, points, __):
        return np.stack([points["a"], points["b"]], axis=1) @ slopes.T

    monkeypatch.setattr(planning_prospects, "at_points", linear)
    scale = np.stack([joints["a"], joints["b"]], axis=1)
    found = planning_prospects.fisher(joints, ("a", "b"), scale, None, np.array([1.0, 1.0, 0.0]))
    for one, size in zip(found, scale, strict=True):
        jacobian = slopes[:2] * size  # the third value only fills up the record
        np.testing.assert_allclose(one, jacobian.T @ jacobian, rtol=1e-7)


def test_a_joint_slides_at_the_length_of_its_law():
    """Bouc-Wen's delta is one over a length, and a slip is one."""
    by_delta = SimpleNamespace(
        laws=("bouc_wen",), joints={"delta": np.array([200.0, 400.0, 250.0])}
    )
    assert displacement_for(by_delta) == 1 / 250.0
    by_slip = SimpleNamespace(laws=("jenkins_1",), joints={"slip_1": np.array([3e-3])})
    assert displacement_for(by_slip) == 3e-3


def test_a_single_value_is_a_guess_known_to_a_factor():
    beliefs = before({**RANGES, "delta": (340.0, 340.0)}, held={"gain": 1.0}, num_joints=3, seed=0)
    assert set(beliefs.joints["delta"]) == {340.0}
    assert np.linalg.inv(beliefs.precision)[3, 3] == pytest.approx(np.log(4.0) ** 2 / 12)


def test_ranges_through_zero_are_refused():
    with pytest.raises(ConfigError, match=r"`gamma`.*one sign.*\[-1, 2\]") as caught:
        before({**RANGES, "gamma": (-1.0, 2.0)}, held={"gain": 1.0}, num_joints=2, seed=0)
    assert "one side of zero" in str(caught.value)


def posterior_tree(**drop):
    rng = np.random.default_rng(0)
    centre = np.array([118.0, 0.0045, 500.0, 340.0, 33.0])
    mixing = 0.01 * rng.normal(size=(5, 5))
    draws = centre * np.exp(rng.normal(size=(2, 600, 5)) @ mixing.T)
    names = ("omega_n", "zeta", "alpha", "delta", "gamma")
    columns = {n: (("chain", "draw"), draws[..., i]) for i, n in enumerate(names) if n not in drop}
    noise = (("chain", "draw", "level"), np.full((2, 600, 1), 4e-5), {"units": "m/s"})
    time = {"time": np.arange(100) / 512.0}
    record = xr.Dataset({"measured": ("time", np.zeros(100))}, time, {"level_unit": "V"})
    tree = xr.DataTree.from_dict(
        {
            "/posterior": xr.Dataset({**columns, "noise_std": noise}),
            "/verification/sweep/one": record,
        }
    )
    tree.attrs["y_peak"] = 2e-3
    return tree, mixing @ mixing.T


def test_a_posterior_is_taken_as_what_is_known():
    tree, covariance = posterior_tree()
    beliefs = after(tree, held={"gain": 15.0}, num_joints=7)
    assert beliefs.num_joints == 7
    # Sample covariance of 1200 draws: 3/sqrt(600) of the variances.
    size = np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    assert np.abs(np.linalg.inv(beliefs.precision) - covariance).max() < 0.13 * size.max()
    with pytest.raises(DataError, match=r"lacks delta"):
        after(posterior_tree(delta=1)[0], held={}, num_joints=2)
    with pytest.raises(DataError, match=r"zeta.*0"):
        after(posterior_tree(zeta=1)[0], held={"zeta": 0.0}, num_joints=2)


def test_a_row_counts_repeats_time_and_limits():
    beliefs = plain_beliefs(np.diag([1.0, 1.0]))
    wish = Wish(wanted=("alpha",), cv=0.1, max_displacement=2e-3, max_input=1.5)
    candidate = row(plain_prospect(np.diag([10.0, 50.0]), 5.0), beliefs, wish)
    # 1 + 10 R >= 1 / 0.1^2
    assert (candidate.repeats, candidate.status) == (10, "ok")
    assert candidate.seconds == pytest.approx(50.0)
    assert candidate.cv["alpha"].worst_decile == pytest.approx(1 / np.sqrt(101))
    assert list(candidate.cv) == ["alpha"]
    assert candidate.information_gain == pytest.approx(0.5 * np.log(11 * 51))
    far = row(plain_prospect(np.diag([10.0, 50.0]), 5.0, level=2.0, y_peak=3e-3), beliefs, wish)
    assert far.status == "not feasible"
    assert "0.003 m exceeds 0.002 m" in far.notes[0]
    assert "input exceeds 1.5 N/kg" in far.notes[1]
    lost = row(plain_prospect(np.diag([10.0, 50.0]), 1.0, y_peak=np.nan), beliefs, wish)
    assert lost.status == "not predicted"
    assert "3 of 3 joints" in lost.notes[0]
    few = row(plain_prospect(np.diag([0.01, 50.0]), 1.0), beliefs, wish)
    assert (few.status, few.repeats, few.seconds) == ("too few", None, None)
    assert ordered([far, lost, few, candidate]) == (candidate, few, lost, far)


def test_tests_are_combined_where_none_does_it_alone():
    """Each test tells of one parameter; the strong one of both is dear, the weak one needless."""
    beliefs = plain_beliefs(np.diag([1.0, 1.0]))
    wish = Wish(wanted=("alpha", "delta"), cv=0.1)
    first, second = (
        plain_prospect(np.diag([50.0, 0.0]), 5.0),
        plain_prospect(np.diag([0.0, 40.0]), 4.0),
    )
    dear = plain_prospect(np.diag([60.0, 60.0]), 500.0)
    combination = combine([first, second, dear], beliefs, wish)
    assert combination.met
    # 1 + 50 R >= 100 and 1 + 40 R >= 100
    assert [chosen.repeats for chosen in combination.tests] == [2, 3]
    assert combination.seconds == pytest.approx(2 * 5.0 + 3 * 4.0)
    of_first = combine([first], beliefs, wish)
    assert not of_first.met
    assert of_first.notes == (undetermined(["delta"]),)
    with_prior = combine([first], plain_beliefs(np.diag([200.0, 200.0])), wish)
    assert with_prior.met
    assert with_prior.tests == ()


@pytest.fixture(scope="module")
def tones():
    return plan_tests(parse(TONES))


def test_tones_far_below_resonance_know_products_only(tones):
    weak = tones.rows[0]
    assert (weak.level, weak.status, weak.repeats) == (0.2, "too few", None)
    # To first order Y(3 omega) and the damping of small motion hold alpha delta and alpha gamma.
    assert weak.notes == ("only the products alpha*delta and alpha*gamma are determined",)
    # alpha moves by half of what its product leaves open; zeta and omega_n are known far better.
    assert 0.1 < weak.cv["alpha"].median < tones.before["alpha"].median
    assert not tones.combination.met
    assert any("alpha*delta" in note for note in tones.combination.notes)


def test_a_level_beyond_the_input_is_not_feasible(tones):
    assert tones.rows[1].level == 1.0
    assert tones.rows[1].status == "not feasible"
    assert all(chosen.level == 0.2 for chosen in tones.combination.tests)


def test_a_plan_after_a_run_reads_its_rig():
    tree, covariance = posterior_tree()
    shape = TONES[TONES.index("[tones]") :]
    sentences = []
    text = f"[plan]\ngain = 15.0\ncv = 0.001\nwanted = ['delta']\njoints = 2\n{shape}"
    plan = plan_tests(parse(text, of_run=True), tree, report=sentences.append)
    assert plan.wish.input_unit == "V"
    assert plan.num_joints == 2
    assert len(sentences) == 4  # what is timed, what it costs, and two candidates
    # Known before as the posterior has it: 1200 draws tell a spread to 2 %.
    expected = np.sqrt(covariance[3, 3])
    assert plan.before["delta"].median == pytest.approx(expected, rel=0.07)
    assert all(
        candidate.cv["delta"].median < plan.before["delta"].median for candidate in plan.rows
    )
    assert "draws of the run's posterior" in plan.notes[0]


def test_what_a_run_tells_of_its_rig():
    tree = posterior_tree()[0]
    rig = rig_of(tree)
    assert (rig.noise.std, rig.noise.response) == (pytest.approx(4e-5), "velocity")
    assert (rig.fs, rig.input_unit, rig.y_peak) == (512.0, "V", 2e-3)
    assert rig.held == {}
    tree.attrs["held"] = '{"gain": 15.0}'
    tree.attrs["tests"] = '{"one": {"kind": "frf", "source": "N", "response": "velocity"}}'
    del tree["verification"], tree.attrs["y_peak"]
    rig = rig_of(tree)
    assert (rig.fs, rig.input_unit, rig.y_peak) == (None, "N", None)
    assert rig.held == {"gain": 15.0}
    # In a filtered decay the noise is none of a sample.
    posterior = tree["posterior"].to_dataset().rename(level="record")
    tree["posterior"] = xr.DataTree(posterior)
    assert rig_of(tree).noise is None


def test_a_run_that_lacks_what_a_plan_needs():
    tree = posterior_tree()[0]
    quiet = tree.copy()
    quiet["posterior"] = xr.DataTree(tree["posterior"].to_dataset().drop_vars("noise_std"))
    with pytest.raises(ConfigError, match=r"`noise` must be given") as caught:
        plan_tests(None, quiet)
    assert "--limits" in str(caught.value)
    posterior = tree["posterior"].to_dataset()
    tree["posterior"] = xr.DataTree(posterior.assign(gain=15.0 + 0.0 * posterior["zeta"]))
    with pytest.raises(ConfigError, match=r"which inferred the gain, but one of them gives 0.5"):
        plan_tests(parse("[plan]\nmodal_mass = 2.0\n", of_run=True), tree)


def test_neither_a_joint_nor_a_run():
    for described in (None, parse("[plan]\nwanted = ['zeta']\n", of_run=True)):
        with pytest.raises(ConfigError, match="description of the joint") as caught:
            plan_tests(described)
        assert "jbw plan --example" in str(caught.value)


def test_tones_need_a_sampling_that_holds_their_third_harmonic():
    text = TONES.replace("[tones]", "fs = 36.0\n[tones]")
    with pytest.raises(ConfigError, match=r"third harmonic of the tones, 19.5 Hz, but is 36 Hz"):
        plan_tests(parse(text))


def test_default_levels_aim_below_the_limits():
    beliefs = before({**RANGES, "alpha": (450.0, 550.0)}, held={"gain": 15.0}, num_joints=3, seed=0)
    reach = Reach(fs=256.0, max_displacement=4e-3, max_input=0.1)
    grid = SweepTable(span=(14.0, 24.0), rates=(4.0,), rest=1.0)
    proposals = propose({"sweep": grid}, beliefs, reach)
    levels = [proposal.level for proposal in proposals]
    assert levels == sorted(levels)
    assert levels[-1] == 0.1  # the largest input, where 0.9 of the largest displacement needs more
    peaks = [
        peak_displacements(proposal, beliefs).max() for proposal in (proposals[0], proposals[-1])
    ]
    # 0.2 of the limit at the joint that responds most: three tries come within a few per cent.
    assert peaks[0] == pytest.approx(0.8e-3, rel=0.05)
    assert peaks[1] < 4e-3


def test_a_turned_channel_moves_a_joint_as_far():
    """A run may have found a gain below zero: levels and motion are those of its size."""
    grids = {
        "tones": TonesTable(dwell=64.0, settle=48.0),
        "stepped": SteppedTable(dwell=9.0, settle=5.0, frequencies=(18.0, 19.0)),
    }
    reach = Reach(fs=1024.0, max_displacement=1e-3)
    peaks = {
        gain: before(RANGES, held={"gain": gain}, num_joints=2, seed=0) for gain in (15.0, -15.0)
    }
    plain, turned = (propose(grids, beliefs, reach) for beliefs in peaks.values())
    assert turned == plain
    noise = ResponseNoise(5e-6, "displacement")
    ahead, behind = (prospects(plain[-1:], beliefs, noise)[0] for beliefs in peaks.values())
    assert ahead.num_lost == 0
    np.testing.assert_allclose(behind.y_peak, ahead.y_peak, rtol=1e-12)
    scale = np.abs(ahead.information).max()
    np.testing.assert_allclose(behind.information, ahead.information, atol=1e-6 * scale)


def test_levels_that_are_given_are_kept():
    beliefs = before(RANGES, held={"gain": 15.0}, num_joints=2, seed=0)
    grids = {
        "sweep": SweepTable(levels=(0.1, 0.2), rates=(1.0, 2.0)),
        "stepped": SteppedTable(levels=(0.01,), frequencies=(18.0, 19.0), dwell=9.0, settle=5.0),
    }
    proposals = propose(grids, beliefs, Reach(fs=1024.0, max_displacement=1e-3))
    assert [(proposal.level, proposal.rate) for proposal in proposals[:4]] == [
        (0.1, 1.0), (0.2, 1.0), (0.1, 2.0), (0.2, 2.0),
    ]  # fmt: skip
    assert (proposals[4].level, proposals[4].seconds, proposals[4].num_samples) == (
        0.01,
        18.0,
        4096,
    )


def test_tests_of_a_joint_of_sliders_are_planned_by_its_own_parameters():
    text = """
    [joint]
    laws = "jenkins_1"
    [plan]
    natural_hz = 18.8
    zeta = 0.005
    stiffness_1 = [400.0, 600.0]
    slip_1 = [1e-3, 1.5e-3]
    gain = 15.0
    noise = 5e-6
    joints = 2
    max_repeats = 10
    [stepped]
    frequencies = [17.0, 18.0, 18.5, 19.0]
    dwell = 20.0
    settle = 15.0
    levels = [0.5]
    """
    plan = plan_tests(parse(text))
    assert plan.wish.wanted == ("stiffness_1", "slip_1")
    (row,) = plan.rows
    assert row.information_gain > 0.0
    assert row.cv["slip_1"].median < plan.before["slip_1"].median
    # The middle of the range of slips, drawn by a Latin hypercube of two.
    beliefs = before(parse(text).ranges, held={"gain": 15.0}, num_joints=8, seed=0,
                     laws=("jenkins_1",))  # fmt: skip
    assert 1e-3 < displacement_for(beliefs) < 1.5e-3


def test_the_cost_of_a_plan_is_the_first_of_each_form_times_their_number():
    """Three sweeps of 8 s and two sets of tones of 2 s, at four joints: 24 + 4 s."""
    kinds = [int, int, int, str, str]
    joints = SimpleNamespace(num_joints=4)
    candidates = [kind() for kind in kinds]
    sentence = cost_sentence(candidates, {int: 8.0, str: 2.0}, joints)  # pyright: ignore
    assert sentence == cost(5, 4, 28.0)
    sentence = cost_sentence(candidates, {int: 800.0, str: 2.0}, joints)  # pyright: ignore
    assert sentence == cost(5, 4, 2400.0)
