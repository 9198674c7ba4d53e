"""The rig's several modes and armature, against what is not the rig's."""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import lsim

import jbw
from jbw import rig
from jbw.campaign.schema import read_spec
from jbw.errors import ConfigError
from jbw.oscillator.laws import law_named
from jbw.rig.forces import BoucWenForce
from jbw.rig.integrator import GRID
from jbw.rig.structure import Armature, Assembled, Shapes, law_of_mode, modal_truth, move

GOLDEN = json.loads((Path(__file__).parents[1] / "golden_shaker.json").read_text())
FS, SIZE = 512.0, 512
SHAPES = Shapes(
    omega=2 * np.pi * np.array([18.8, 57.2]), zeta=np.array([0.0044, 0.006]),
    drive=np.array([0.9, 0.6]), joint=np.array([1.2, -0.7]), output=np.array([0.8, 0.5]),
)  # fmt: skip
BOUC_WEN = {"alpha": 500.0, "delta": 340.0, "gamma": 33.0}
SHAKER = Armature(gain=8.0, mass=0.08, damping=1.5, stiffness=900.0)


def chirp(points):
    """Source at points of the rig's grid, which begins at zero with zero slope."""
    t = points / (GRID * FS)
    return 30.0 * np.sin(np.pi * t) ** 2 * np.sin(2 * np.pi * (15 * t + 15 * t**2))


def between(i, j):
    return chirp(np.arange(i, j))


@pytest.mark.parametrize("case", GOLDEN["cases"], ids=["wing", "two modes"])
def test_its_poles_with_an_armature_are_the_golden_ones(case):
    armature, system = case["armature"], case["system"]
    phi = np.array(system["phi_drive"])
    shapes = Shapes(np.array(system["w"]), np.array(system["ze"]), phi, 0 * phi, phi)
    structure = Assembled(shapes, (), Armature(1.0, **armature))
    num = len(phi)

    def rate(y):
        state = (0.0, y[:num], y[num:], ())
        return jnp.concatenate(structure.state_rate(state, 0.0)[1:3])

    poles = np.linalg.eigvals(np.asarray(jax.jacfwd(rate)(jnp.zeros(2 * num))))
    poles = poles[poles.imag > 0]
    poles = poles[np.argsort(np.abs(poles))]
    # Eigenvalues of the same matrices by another route: the golden ones' accuracy is 1e-12.
    np.testing.assert_allclose(np.abs(poles), case["omega"], rtol=1e-10)
    np.testing.assert_allclose(-poles.real / np.abs(poles), case["zeta"], rtol=1e-9)


def test_without_a_joint_it_is_mass_damping_and_stiffness():
    """Motion and the force cell beside scipy's exact solution between the points of the grid."""
    motion = move(Assembled(SHAPES, (), SHAKER), between, SIZE, FS)
    phi, num = SHAPES.drive, 2
    tied = np.outer(phi, phi)
    mass = np.eye(num) + SHAKER.mass * tied
    damping = np.diag(2 * SHAPES.zeta * SHAPES.omega) + SHAKER.damping * tied
    stiffness = np.diag(SHAPES.omega**2) + SHAKER.stiffness * tied
    inner = np.linalg.solve(mass, np.hstack([stiffness, damping]))
    a = np.block([[np.zeros((num, num)), np.eye(num)], [-inner]])
    b = np.concatenate([np.zeros(num), np.linalg.solve(mass, SHAKER.gain * phi)])[:, None]
    t = np.arange(GRID * SIZE) / (GRID * FS)
    _, _, state = lsim((a, b, np.eye(2 * num), np.zeros((2 * num, 1))), chirp(np.arange(len(t))), t)
    state, source = state[::GRID], chirp(np.arange(len(t)))[::GRID]
    q, rate = state[:, :num], state[:, num:]
    change = state @ a.T[:, num:] + source[:, None] * b[num:, 0]
    # There the source is straight between 32 points a sample, (w h)^2 / 12 = 2.5e-5 off at 45 Hz.
    for name, rows in {"displacement": q, "velocity": rate, "acceleration": change}.items():
        expected = rows @ SHAPES.output
        np.testing.assert_allclose(
            getattr(motion, name), expected, atol=2.5e-5 * np.abs(expected).max()
        )
    cell = (change + 2 * SHAPES.zeta * SHAPES.omega * rate + SHAPES.omega**2 * q)[:, 0] / phi[0]
    np.testing.assert_allclose(motion.force, cell, atol=2.5e-5 * np.abs(cell).max())
    np.testing.assert_allclose(
        motion.drive_point, change @ phi, atol=2.5e-5 * np.abs(change @ phi).max()
    )


def test_an_identification_s_truth_moves_as_the_structure_does():
    """The same in the other code, in its gauge: which has other shapes, units and solver."""
    structure = Assembled(SHAPES, (BoucWenForce(**BOUC_WEN),), Armature(gain=8.0))
    motion = move(structure, between, SIZE, FS)
    law = law_named("bouc_wen").build(BOUC_WEN)
    modal_law = law_named("bouc_wen").build(law_of_mode(law, SHAPES))
    truth = modal_truth(SHAPES)
    truth["b"] = 8.0 * truth["b"]
    structure_of_modes = jbw.Structure(**truth, laws=(modal_law,))
    other = jbw.simulate(structure_of_modes, between(0, GRID * SIZE)[:: GRID // 8], 8 * FS)
    y = np.asarray(other.y)[::8]
    assert BOUC_WEN["delta"] * np.abs(motion.joint).max() > 0.3  # the joint slips
    # Straight between eight samples of one: 1e-5 of the rms.
    assert np.sqrt(np.mean((motion.displacement - y) ** 2)) < 1e-4 * np.sqrt(np.mean(y**2))


def test_a_law_takes_the_units_of_the_mode():
    """By hand: phi_J = 1.2, phi_J / phi_r = 1.5."""
    modal_law = law_of_mode(law_named("bouc_wen").build(BOUC_WEN), SHAPES)
    assert modal_law == pytest.approx({"alpha": 720.0, "delta": 510.0, "gamma": 49.5})
    cubic = law_of_mode(law_named("cubic").build({"cubic": 2.0}), SHAPES)
    assert cubic == pytest.approx({"cubic": 2.0 * 1.44 * 2.25})
    slider = law_of_mode(law_named("jenkins_1").build({"stiffness_1": 3.0, "slip_1": 0.3}), SHAPES)
    assert slider == pytest.approx({"stiffness_1": 4.32, "slip_1": 0.2})


@pytest.fixture(scope="module")
def campaign():
    return rig.measure("modes", tests=["sweep_0p20V", "decay_shaker"], repeats=1, fs=512.0)


def test_a_campaign_of_modes_says_what_drives_each_test(campaign, tmp_path):
    sweep, decay = campaign.tests
    assert set(sweep.records[0].channels) == {"input", "force", "drive_point", "velocity"}
    assert (sweep.records[0].source, decay.drive) == ("input", "voltage")
    spec = read_spec(rig.write(campaign, tmp_path / "written"))
    assert [test.drive for test in spec.tests] == ["voltage", "voltage"]


def test_the_truth_by_voltage_is_that_of_the_structure_with_its_shaker(campaign):
    """By hand, of the first mode alone: the others change it by a hundredth of the change."""
    true, shaker, push = campaign.truth["joint"], rig.MODES.armature, 0.7**2
    share = 1 + shaker.mass * push
    omega = np.sqrt((true["omega_n"] ** 2 + shaker.stiffness * push) / share)
    rate = (2 * true["zeta"] * true["omega_n"] + shaker.damping * push) / share
    change = omega - true["omega_n"]
    assert true["omega_n_voltage"] - true["omega_n"] == pytest.approx(change, rel=0.01)
    assert true["zeta_voltage"] == pytest.approx(rate / (2 * omega), rel=0.01)
    assert true["gain_voltage"] == pytest.approx(0.7 * shaker.gain / share)


def test_a_lag_of_one_channel_is_refused():
    with pytest.raises(ConfigError, match="`delay` must be 0"):
        rig.measure("modes", tests="sweep_0p20V", repeats=1, delay=1e-3)
