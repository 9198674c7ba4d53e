"""Energy shares, the matrix B, inseparable joints and starts by non-negative least squares."""

import json
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp
from golden_beams import CASES, FILE, reduced

from jbw.assembly.matrices import matrix_model
from jbw.assembly.separability import energy_shares, joint_separability
from jbw.assembly.starts import joint_starts
from jbw.errors import ConfigError
from jbw.rig.assemblies import lapped_beams, plate_chain, portal_frame

BACKBONES = json.loads(FILE.read_text(encoding="utf-8"))["backbone"]["cases"]


@pytest.mark.parametrize("case", CASES, ids=[case["name"] for case in CASES])
def test_energy_shares_are_those_of_the_golden_beams(case):
    np.testing.assert_allclose(energy_shares(reduced(case, 5)), case["energy_share"], rtol=1e-8)


def test_energy_shares_are_how_the_joints_stiffness_moves_the_frequencies():
    """d ln omega_i^2 / d ln k_j = e_ji, by central differences of the eigenvalues."""
    model = reduced(CASES[0], 5)
    for j in range(2):
        step = np.zeros(2)
        step[j] = 1e-5
        up, down = (
            np.log(model.frequencies_at(model.stiffness * (1 + s * step)) ** 2) for s in (1, -1)
        )
        # The frequencies are eigenvalues of numbers that reach 1e6 times the first.
        slope = ((up - down) / 2e-5)[:5]
        np.testing.assert_allclose(slope, energy_shares(model)[j], atol=1e-6)


def test_rigid_body_modes_have_no_share():
    shares = energy_shares(plate_chain(clamped=False).reduced())
    np.testing.assert_array_equal(shares[:, :2], 0.0)
    assert np.all(shares.sum(axis=0) <= 1.0)


@pytest.mark.parametrize(("modes", "condition"), [((0, 1), 2.47), ((0, 2), 25.9)])
def test_the_condition_number_of_the_golden_beams(modes, condition):
    """As the specification states it: mode 2 splits the bolts although neither does much in it."""
    separability = joint_separability(reduced(CASES[0], 5), modes)
    assert separability.condition == pytest.approx(condition, rel=0.01)
    H = np.array(CASES[0]["abs_H"])[:, modes]
    np.testing.assert_allclose(separability.participation, H.T**3, rtol=1e-7)


def test_the_condition_number_multiplies_the_noise():
    """The largest relative error of joints over that of rows of unit length, by definition."""
    separability = joint_separability(reduced(CASES[0], 5), (0, 2))
    rows = separability.participation
    rows = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    assert separability.condition == pytest.approx(np.linalg.cond(rows), rel=1e-12)


def test_rows_over_their_largest_are_those_of_the_example():
    table = joint_separability(reduced(CASES[0], 5), (0, 1, 2)).over_largest
    np.testing.assert_allclose(table, [[0.97, 1], [0.003, 1], [1, 0.88]], atol=0.005)


def test_fewer_modes_than_joints_tell_nothing_of_each():
    separability = joint_separability(reduced(CASES[0], 5), (0,))
    assert separability.condition == np.inf
    (pair,) = separability.inseparable
    assert (pair.first, pair.second, pair.likeness) == (0, 1, "same motion")


@pytest.mark.parametrize("case", [c for c in BACKBONES if c["name"] == "bw+bw"])
def test_loss_shares_of_weak_motion_are_those_of_the_golden_backbone(case):
    system = case["system"]
    separability = joint_separability(np.array(system["H"]), (case["mode"],))
    opening = [law["alpha"] * law["gamma"] for law in system["joints"]]
    lowest = case["points"][0]["share_of_loss"]
    # First order in the amplitude: 3e-4 by the specification.
    np.testing.assert_allclose(separability.loss_shares(opening)[0], lowest, atol=3e-4)


def test_joints_of_a_symmetric_frame_are_mirror_images():
    separability = joint_separability(portal_frame(heights=(0.4, 0.4)).reduced())
    (pair,) = separability.inseparable
    assert pair.likeness == "mirror images"
    assert pair.degrees < 1e-4  # by symmetry 0; shapes of sparse algebra hold to 1e-8
    assert "mirror images" in repr(separability)
    assert joint_separability(portal_frame().reduced()).inseparable == ()


def test_joints_of_one_motion_are_told_as_such():
    H = np.array([[1.0, -2.0, 0.5], [-1.01, 2.0, -0.5]])
    (pair,) = joint_separability(H).inseparable
    assert pair.likeness == "same motion"
    mirrored = np.array([[1.0, -2.0, 0.5], [1.0, 2.0, 0.5]])
    (pair,) = joint_separability(mirrored).inseparable
    assert pair.likeness == "mirror images"


def test_the_angle_between_columns():
    """Of two columns, by their scalar product; 5 degrees are the limit."""
    alike = []
    for ratio in (1.02, 1.1, 1.3, 3.0):
        B = np.array([[1.0, 1.0], [1.0, ratio]])
        rows = B / np.linalg.norm(B, axis=1, keepdims=True)
        exact = np.degrees(
            np.arccos(rows[:, 0] @ rows[:, 1] / np.prod(np.linalg.norm(rows, axis=0)))
        )
        separability = joint_separability(B.T ** (1 / 3))
        assert separability.angles[0, 1] == pytest.approx(exact, rel=1e-6)
        assert bool(separability.inseparable) == (exact < 5.0)
        alike.append(exact < 5.0)
    assert set(alike) == {True, False}


def test_a_joint_that_no_mode_moves_is_like_no_other():
    separability = joint_separability(np.array([[1.0, 2.0], [0.0, 0.0], [0.0, 0.0]]))
    assert separability.condition == np.inf
    assert separability.inseparable == ()
    np.testing.assert_array_equal(separability.angles[1:, 1:], 90.0)
    with pytest.raises(ConfigError, match="there is none"):
        joint_separability(np.zeros((2, 2)))


def test_modes_that_are_not_there_are_refused():
    with pytest.raises(ConfigError, match="indices from 0 to 4, but one is 7"):
        joint_separability(reduced(CASES[0], 5), (0, 7))
    with pytest.raises(ConfigError, match="mode 2 moves none"):
        joint_separability(np.array([[1.0, 0.0], [1.0, 0.0]]), (0, 1))


def test_a_mode_that_moves_no_joint_tells_nothing():
    """A mass on a spring beside the beams, at 50 Hz: what its mode moves of them is round-off."""
    beams = lapped_beams()
    mass = sp.block_diag((beams.model.mass, sp.csc_array([[0.1]])))
    spring = sp.csc_array([[0.1 * (2 * np.pi * 50) ** 2]])
    stiffness = sp.block_diag((beams.model.stiffness, spring)).toarray()
    stiffness[0, -1] = stiffness[-1, 0] = 1e-9
    model = matrix_model(mass, stiffness, units="SI", dofs=[*beams.model.dofs, ("999", "y")])
    found = replace(beams, model=model).reduced()
    assert found.frequencies_hz[1] == pytest.approx(50.0, rel=1e-9)
    assert joint_separability(found).modes == (0, 2, 3, 4, 5)
    with pytest.raises(ConfigError, match="mode 2 moves none"):
        joint_separability(found, (0, 1))


COVARIANCE = np.diag([0.04, 0.01, 0.02]) + 0.005
TRUE = np.array([4.0, 7.0])
MOTION = np.array([[1.0, 0.3, 1.2], [0.9, 1.1, -1.3]])


def test_starts_without_noise_are_the_joints():
    separability = joint_separability(MOTION)
    starts = joint_starts(separability, separability.participation @ TRUE, COVARIANCE)
    np.testing.assert_allclose(starts.estimate, TRUE, rtol=1e-12)
    assert starts.chi_square < 1e-20
    assert starts.degrees_of_freedom == 1


def test_starts_away_from_zero_are_generalised_least_squares():
    separability = joint_separability(MOTION)
    B, noise = separability.participation, np.array([0.1, -0.05, 0.08])
    starts = joint_starts(separability, B @ TRUE + noise, COVARIANCE)
    weight = np.linalg.inv(COVARIANCE)
    normal = np.linalg.inv(B.T @ weight @ B)
    exact = normal @ B.T @ weight @ (B @ TRUE + noise)
    np.testing.assert_allclose(starts.estimate, exact, rtol=1e-10)
    np.testing.assert_allclose(starts.standard_error, np.sqrt(np.diag(normal)), rtol=1e-10)
    residual = B @ exact - B @ TRUE - noise
    assert starts.chi_square == pytest.approx(residual @ weight @ residual, rel=1e-9)


def test_a_joint_that_readings_make_negative_is_at_zero():
    separability = joint_separability(MOTION)
    starts = joint_starts(separability, separability.participation @ [4.0, -1.0], COVARIANCE)
    assert starts.estimate[1] == 0.0
    assert starts.estimate[0] > 0.0
    assert np.isnan(starts.standard_error[1])


def test_the_test_of_the_joints_errs_as_often_as_it_says():
    """Of 2000 sets of readings 1 % are rejected, within four standard deviations of a binomial."""
    separability = joint_separability(MOTION)
    rng = np.random.default_rng(0)
    lower = scipy.linalg.cholesky(COVARIANCE, lower=True)
    draws = separability.participation @ TRUE + rng.standard_normal((2000, 3)) @ lower.T
    rejected = sum(not joint_starts(separability, r, COVARIANCE).explains for r in draws)
    assert abs(rejected - 20) < 4 * np.sqrt(2000 * 0.01 * 0.99)


def test_readings_of_another_joint_are_rejected():
    """A third joint that moves in mode 2 alone, most of which the two can take for theirs."""
    separability = joint_separability(MOTION)
    readings = separability.participation @ TRUE + np.array([0.0, 3.0, 0.0])
    assert joint_starts(separability, readings, COVARIANCE).explains is False
    two = joint_separability(MOTION, (0, 1))
    starts = joint_starts(two, readings[:2], COVARIANCE[:2, :2])
    assert starts.explains is None  # as many modes as joints: nothing is left to test


def test_faulty_readings_are_refused():
    separability = joint_separability(MOTION)
    with pytest.raises(ConfigError, match="must be 3 numbers"):
        joint_starts(separability, np.ones(2), np.eye(2))
    with pytest.raises(ConfigError, match="positive definite"):
        joint_starts(separability, np.ones(3), np.zeros((3, 3)))
    with pytest.raises(ConfigError, match="at least 2 modes"):
        joint_starts(joint_separability(MOTION, (0,)), np.ones(1), np.eye(1))
