"""Damping matrices in stuck modes: what a dashpot across each joint keeps, and what is left out."""

from dataclasses import replace

import numpy as np
import pytest

from jbw.assembly.matrices import matrix_model
from jbw.oscillator.laws.dashpot import Dashpot
from jbw.rig.assemblies import BOLT, lapped_beams

B = 2e-5  # [s]
HERTZ = (20.0, 32.0, 60.0, 90.4, 150.0)


def beams(damping_of):
    """Lapped beams with the damping matrix that a function makes of M, K and W."""
    rig = lapped_beams()
    dofs = [str(dof) for dof in rig.model.dofs]
    across = np.array([[dict(j.weights).get(dof, 0.0) for dof in dofs] for j in rig.joints]).T
    mass, stiffness = rig.model.mass.toarray(), rig.model.stiffness.toarray()
    damping = damping_of(mass, stiffness, across)
    model = matrix_model(mass, stiffness, units="SI", dofs=dofs, damping=damping)
    return replace(rig, model=model), across


def receptance_of_the_matrices(rig, across):
    """Tip over force by all degrees of freedom, joints in full stick [m/N]."""
    model, dofs = rig.model, [str(dof) for dof in rig.model.dofs]
    stuck = model.stiffness.toarray() + BOLT * across @ across.T
    push = np.eye(len(dofs))[dofs.index("1:z")]
    omega = 2 * np.pi * np.array(HERTZ)
    mass, damping = model.mass.toarray(), model.damping.toarray()
    motions = [np.linalg.solve(stuck + 1j * w * damping - w**2 * mass, push) for w in omega]
    return np.array(motions)[:, dofs.index("105:z")]


def receptance_of_the_structure(structure):
    """The same of modes with dashpots, by their equations."""
    omega = 2 * np.pi * np.array(HERTZ)
    H = np.asarray(structure.h)
    dashpots = np.diag([sum(law.c for law in laws) for laws in structure.laws])
    coupling = H.T @ dashpots @ H
    own = np.asarray(structure.omega_n), np.asarray(structure.zeta)
    return np.array([
        structure.c @ np.linalg.solve(
            np.diag(own[0] ** 2 - w**2 + 2j * own[1] * own[0] * w) + 1j * w * coupling, structure.b
        )
        for w in omega
    ])  # fmt: skip


def test_damping_of_the_cut_structure_is_a_negative_dashpot_across_each_joint():
    rig, across = beams(lambda mass, stiffness, across: B * stiffness)
    found = rig.reduced(zeta=None)
    np.testing.assert_allclose(found.dashpots, -B * BOLT, rtol=1e-7)
    structure = found.structure()
    assert all(isinstance(law, Dashpot) for laws in structure.laws for law in laws)
    # C = b K_s - sum b k_j w_j w_j^T: the modes have b omega / 2 beside the dashpots.
    np.testing.assert_allclose(structure.zeta, B * found.omega / 2, rtol=1e-7)
    assert "-300 N s/m across bolt 1" in found.notes[-1]
    expected = receptance_of_the_matrices(rig, across)
    # 3e-5 of the reduction; by the diagonal alone it is off by 6e-4 at these frequencies.
    np.testing.assert_allclose(receptance_of_the_structure(structure), expected, rtol=5e-5)
    alone = receptance_of_the_structure(replace_dashpots(found).structure())
    assert np.max(np.abs(alone / expected - 1)) > 5e-4


def replace_dashpots(found):
    """A reduced model whose damping is its diagonal alone."""
    return replace(found, dashpots=np.zeros(len(found.joints)))


def test_dashpots_that_a_model_has_at_its_joints_stay_there():
    rig, across = beams(
        lambda mass, stiffness, across: 0.8 * mass + (across * [50.0, 0.0]) @ across.T
    )
    found = rig.reduced(zeta=None)
    np.testing.assert_allclose(found.dashpots, [50.0, 0.0], rtol=1e-7)
    structure = found.structure()
    assert structure.laws[1] == ()
    kept = structure.zeta[: found.num_kept] * found.omega[: found.num_kept]
    np.testing.assert_allclose(kept, 0.4, rtol=1e-7)  # a / 2
    expected = receptance_of_the_matrices(rig, across)
    np.testing.assert_allclose(receptance_of_the_structure(structure), expected, rtol=5e-5)


def test_damping_of_the_stuck_structure_needs_no_dashpot():
    rig, _ = beams(lambda mass, stiffness, across: B * (stiffness + BOLT * across @ across.T))
    found = rig.reduced(zeta=None)
    assert not found.dashpots.any()
    assert all(laws == () for laws in found.structure().laws)
    np.testing.assert_allclose(found.zeta, B * found.omega / 2, rtol=1e-8)
    assert not any("damping" in note for note in found.notes)


def test_other_damping_is_left_out_beside_the_diagonal_and_the_largest_is_said():
    """A dashpot to ground at node 2: its part in modes 1 and 2 by their shapes there."""
    place = np.eye(18)[2]

    def to_ground(mass, stiffness, across):
        return 0.5 * mass + 0.002 * np.outer(place, place)

    rig, _ = beams(to_ground)
    found = rig.reduced(zeta=None)
    assert not found.dashpots.any()
    assert "this coupling is neglected" in found.notes[-1]
    shapes = found.shapes
    modal = shapes.T @ rig.model.damping.toarray() @ shapes
    size = np.sqrt(np.diag(modal))
    coupling = np.abs(modal / np.outer(size, size) - np.eye(len(size)))
    assert f"{100 * coupling.max():.3g} % of their own damping" in found.notes[-1]
    np.testing.assert_allclose(
        found.zeta[: found.num_kept],
        np.diag(modal) / (2 * found.omega[: found.num_kept]),
        rtol=1e-10,
    )


@pytest.mark.parametrize("c", [-3.0, 3.0])
def test_a_dashpot_loses_by_its_velocity(c):
    loop = Dashpot(c).loop(2e-3, 10.0)
    assert float(loop.damping) == pytest.approx(10.0 * c, rel=1e-14)
    harmonics = Dashpot(c).harmonics(np.array([1.0 + 0.5j, 0.2j]), 2, 10.0)
    # g = c dx/dt of harmonics 1 and 3.
    np.testing.assert_allclose(harmonics, c * 1j * 10.0 * np.array([1, 3]) * [1.0 + 0.5j, 0.2j])
