"""A reduced model as a `jbw.Structure`: its motion is that of the matrices with the joint's law."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jbw
from jbw.assembly.joint import Joint
from jbw.assembly.matrices import matrix_model
from jbw.assembly.reduce import reduce
from jbw.oscillator.laws.bouc_wen import BoucWenLaw
from jbw.rig.assemblies import lapped_beams

ALPHA, DELTA, GAMMA, ZETA = 300.0, 40.0, 15.0, 0.01
MASS = np.diag([2.0, 1.0, 0.5])
BARE = np.array([[900.0, -400.0, 0.0], [-400.0, 400.0, 0.0], [0.0, 0.0, 200.0]])
ACROSS = np.array([0.0, -1.0, 1.0])
STUCK = 500.0  # of the joint: 200 N/m beyond the law stay linear
FS, NUM = 64.0, 129


def push(t):
    return 20.0 * np.sin(2 * np.pi * 2.0 * t) * np.sin(np.pi * t / 2.0) ** 2


def motion_of_the_matrices(damping=None):
    """Displacement of mass 1 and of the joint, by DOP853 on the matrices; u in straight lines."""
    stuck = BARE + STUCK * np.outer(ACROSS, ACROSS)
    values, shapes = np.linalg.eigh(MASS**0.5 @ stuck @ MASS**0.5 / np.outer(*[np.diag(MASS)] * 2))
    modal = np.diag(np.diag(MASS) ** 0.5) @ shapes
    if damping is None:
        damping = modal @ np.diag(2 * ZETA * np.sqrt(values)) @ modal.T
    times = np.arange(NUM) / FS
    samples = push(times)

    def field(t, state):
        q, v, z = state[:3], state[3:6], state[6]
        rate = ACROSS @ v
        slip = z - ALPHA * (ACROSS @ q)
        load = np.array([np.interp(t, times, samples), 0.0, 0.0]) - slip * ACROSS
        a = (load - damping @ v - stuck @ q) / np.diag(MASS)
        dz = ALPHA * rate - GAMMA * abs(rate) * z - DELTA * rate * abs(z)
        return np.concatenate((v, a, [dz]))

    state, states = np.zeros(7), [np.zeros(7)]
    for begin, end in pairwise(times):
        state = solve_ivp(field, (begin, end), state, "DOP853", rtol=1e-10, atol=1e-13).y[:, -1]
        states.append(state)
    q = np.array(states)[:, :3]
    return samples, q[:, 0], q @ ACROSS


def structure(zeta=ZETA, damping=None):
    dofs = [(n, "x") for n in (1, 2, 3)]
    model = matrix_model(MASS, BARE, units="SI", dofs=dofs, damping=damping)
    law = BoucWenLaw(ALPHA, DELTA, GAMMA)
    joint = Joint("bolt", across=("2:x", "3:x"), stiffness=STUCK, laws=law)
    found = reduce(model, [joint], to_hz=20.0, input="1:x", outputs={"y": "1:x"}, zeta=zeta)
    return found.structure()


@pytest.mark.slow  # compiles the step of three modes
def test_the_motion_is_that_of_the_matrices():
    samples, y, x = motion_of_the_matrices()
    response = jbw.simulate(structure(), samples, FS, substeps=8)
    slip = DELTA * np.abs(x).max()
    assert slip > 0.5  # so strong that a linear joint would be far off
    # Order 4: the highest mode, 5.7 Hz, moves by 0.07 rad a step.
    np.testing.assert_allclose(response.y, y, atol=1e-6 * np.abs(y).max())
    np.testing.assert_allclose(response.x, x, atol=1e-6 * np.abs(x).max())


@pytest.mark.slow  # an adaptive solver: dampers are not stepped
def test_damping_of_the_cut_structure_is_exact_in_its_stuck_modes():
    """C = b K of the structure whose joint is cut, which stuck modes do not diagonalise."""
    damping = 0.01 * BARE
    samples, y, x = motion_of_the_matrices(damping)
    response = jbw.simulate(structure(None, damping), samples, FS, substeps=8)
    # Of the adaptive solver's tolerance.
    np.testing.assert_allclose(response.y, y, atol=1e-5 * np.abs(y).max())
    np.testing.assert_allclose(response.x, x, atol=1e-5 * np.abs(x).max())
    # What the dashpot couples matters: without it the motion is another one.
    uncoupled = structure(0.01 * 5.0, None)
    assert np.std(jbw.simulate(uncoupled, samples, FS, substeps=8).y - y) > 1e-2 * np.std(y)


def test_the_law_of_a_joint_keeps_its_units():
    """h and p are physical: the joint's force is in newtons, its displacement in metres."""
    found = structure()
    np.testing.assert_array_equal(found.h, found.p)
    assert found.laws[0].parameters()["alpha"] == ALPHA


def test_several_joints_have_a_row_of_h_and_a_tuple_of_laws_each():
    laws = BoucWenLaw(1.5e7, 8e5, 2e5), BoucWenLaw(1e7, 1.2e6, 3e5)
    found = lapped_beams().with_laws(*laws).reduced()
    stated = found.structure()
    np.testing.assert_array_equal(stated.h, found.H)
    np.testing.assert_array_equal(stated.p, found.H.T)
    assert stated.laws == ((laws[0],), (laws[1],))
