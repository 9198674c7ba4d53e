"""Reduction to modes in full stick and residual modes, against golden numbers and dense algebra."""

import numpy as np
import pytest
import scipy.linalg
from golden_beams import CASES, joints, matrices, reduced

from jbw.assembly.joint import Joint
from jbw.assembly.matrices import matrix_model
from jbw.assembly.reduce import reduce
from jbw.rig.assemblies import bending_mass, bending_stiffness, lapped_beams, plate_chain

each_case = pytest.mark.parametrize("case", CASES, ids=[case["name"] for case in CASES])


def dense_weights(case):
    mass, _ = matrices(case)
    weights = np.zeros((mass.shape[0], len(case["joint_dofs"])))
    for j, place in enumerate(case["joint_dofs"]):
        for row, weight in place:
            weights[row, j] = weight
    return weights


@each_case
def test_modes_in_full_stick_are_those_of_the_golden_beams(case):
    model = reduced(case, 5)
    # The golden numbers are printed with 14 digits, and K holds springs 1e9 times its least entry.
    np.testing.assert_allclose(model.omega[:5], case["omega"][:5], rtol=1e-9)
    np.testing.assert_allclose(np.abs(model.H[:, :5]), case["abs_H"], rtol=1e-8)
    np.testing.assert_allclose(model.flexibility, case["flexibility"], rtol=1e-8)
    shares = model.stiffness[:, None] * model.H[:, :5] ** 2 / model.omega[:5] ** 2
    np.testing.assert_allclose(shares, case["energy_share"], rtol=1e-8)


@each_case
def test_the_residual_flexibility_is_that_of_the_golden_beams(case):
    model = reduced(case, 3)
    np.testing.assert_allclose(
        model.residual_flexibility, case["residual_flexibility_3"], rtol=1e-8
    )


@each_case
def test_residual_modes_of_joints_and_input_are_those_of_the_golden_reduction(case):
    expected = case["reduced"]["rubin_5_and_input"]["omega"]
    np.testing.assert_allclose(reduced(case, 5).omega, expected, rtol=1e-9)


@each_case
def test_residual_modes_give_the_freed_frequencies(case):
    """Of one per cent without them (the least of the specification's table is 0.55)."""
    mass, stiffness = matrices(case)
    weights = dense_weights(case)
    springs = np.array([law["alpha"] for law in case["joints"]])
    freed = stiffness - (weights * springs) @ weights.T
    exact = np.sqrt(np.maximum(scipy.linalg.eigvalsh(freed, mass), 0.0)) / (2 * np.pi)
    model = reduced(case, 5)
    # 3e-6 of the first three by the specification's table of the two bolts; the input's column is
    # in the basis too. The mechanism of the second case moves by round-off alone.
    soft = model.frequencies_at(np.zeros(len(springs)))
    np.testing.assert_allclose(soft[:3], exact[:3], rtol=2e-5, atol=1e-2)


@each_case
def test_what_modes_and_residual_modes_add_statically_is_exact(case):
    mass, stiffness = matrices(case)
    weights = dense_weights(case)
    model = reduced(case, 3)
    static = (model.H / model.omega**2) @ model.H.T
    np.testing.assert_allclose(static, weights.T @ np.linalg.solve(stiffness, weights), rtol=1e-9)
    tip = np.linalg.solve(stiffness, np.eye(mass.shape[0])[case["input_dof"]])[case["tip_dof"]]
    np.testing.assert_allclose((model.c / model.omega**2) @ model.b, [tip], rtol=1e-9)


@each_case
def test_slowing_residual_modes_keeps_the_static_flexibility(case):
    free = reduced(case, 3)
    slow = reduced(case, 3, slow_residual_modes=True)
    limit = 2 * np.pi * 5 * (case["omega"][2] + case["omega"][3]) / (4 * np.pi)
    assert free.omega.max() > limit
    np.testing.assert_allclose(slow.omega.max(), limit, rtol=1e-12)
    np.testing.assert_allclose(
        (slow.H / slow.omega**2) @ slow.H.T, (free.H / free.omega**2) @ free.H.T, rtol=1e-9
    )
    assert any("was lowered to" in note for note in slow.notes)


def test_the_rig_has_the_matrices_of_the_golden_beams():
    mass, stiffness = matrices(CASES[0])
    rig = lapped_beams()
    weights = dense_weights(CASES[0])
    stuck = rig.model.stiffness.toarray() + weights @ np.diag([1.5e7, 1.5e7]) @ weights.T
    # The golden entries have 14 digits.
    np.testing.assert_allclose(rig.model.mass.toarray(), mass, atol=1e-13 * mass.max())
    np.testing.assert_allclose(stuck, stiffness, atol=1e-13 * stiffness.max())


def test_joints_that_are_added_are_joints_that_are_held():
    case = CASES[0]
    held = reduced(case, 5)
    added = lapped_beams().reduced(
        to_hz=held.frequencies_hz[-1] + 50, slow_residual_modes=False, input="1:z"
    )
    np.testing.assert_allclose(added.omega, held.omega, rtol=1e-9)
    np.testing.assert_allclose(added.H, held.H, rtol=1e-7, atol=1e-9 * np.abs(held.H).max())


def test_a_clamped_beam_with_a_friction_joint_is_that_of_nlvib():
    """Example 8 of NLvib 1.3 (Krack and Gross): frequencies as the specification states them."""
    length, area, modulus, density, elements = 2.0, 0.1 * 0.3, 185e9, 7830.0, 8
    bending = modulus * 0.3 * 0.1**3 / 12
    size = 2 * (elements + 1)
    mass, stiffness = np.zeros((size, size)), np.zeros((size, size))
    for i in range(elements):
        rows = slice(2 * i, 2 * i + 4)
        mass[rows, rows] += density * area * bending_mass(length / elements)
        stiffness[rows, rows] += bending * bending_stiffness(length / elements)
    dofs = [(node, direction) for node in range(1, 10) for direction in ("z", "ry")][2:]
    model = matrix_model(mass[2:, 2:], stiffness[2:, 2:], units="SI", dofs=dofs)
    friction = Joint("friction", {"4:z": 1.0}, stiffness=1e8)
    found = reduce(model, [friction], to_hz=400, input="9:z", outputs={"tip": "9:z"}, zeta=0.0)
    np.testing.assert_allclose(found.omega[:3], [189.322705, 970.101699, 2245.458955], rtol=1e-8)
    shares = 1e8 * found.H[0, :3] ** 2 / found.omega[:3] ** 2
    np.testing.assert_allclose(shares, [0.328, 0.337, 0.075], atol=5e-4)  # printed digits
    free = 2 * np.pi * found.frequencies_at([0.0])[:2]
    # All but the three kept of sixteen modes are condensed into two.
    np.testing.assert_allclose(free, [123.340591, 773.022486], rtol=2e-6)
    fixed = 2 * np.pi * found.frequencies_at([1e14])[:2]
    np.testing.assert_allclose(fixed, [248.973205, 1660.389487], rtol=1e-3)


def test_three_masses_with_an_iwan_joint_are_those_of_tmdsimpy():
    """examples/vprnm_rom_iwan.py of tmdsimpy: modes 1, 3, 7.5 rad/s hold half of the joint."""
    phi = np.array([[1.0, 2.0, -2.0], [2.0, 1.0, 1.0], [3.0, -1.0, 1.0]])
    mass = np.linalg.inv(phi @ phi.T)
    stiffness = mass @ phi @ np.diag([1.0, 9.0, 56.25]) @ phi.T @ mass
    weights = np.array([0.0, 1.0, -1.0])
    bare = stiffness - 0.3 * np.outer(weights, weights)
    model = matrix_model(mass, bare, units="SI", dofs=[(n, "x") for n in (1, 2, 3)])
    joint = Joint("iwan", across=("3:x", "2:x"), stiffness=0.6)
    found = reduce(model, [joint], to_hz=2.0, input="1:x", outputs={"y": "1:x"}, zeta=0.01)
    np.testing.assert_allclose(found.omega, [1.12237817, 3.20004176, 7.5], rtol=1e-8)
    sign = -np.sign(found.H[0])  # shapes have a free sign
    sign[2] = -np.sign(found.b[2])
    np.testing.assert_allclose(sign * found.H[0], [-0.86383265, -2.06247258, 0], atol=1e-8)
    np.testing.assert_allclose(sign * found.b, [1.13167848, -1.92854967, -2], rtol=1e-8)
    np.testing.assert_allclose(
        2 * np.pi * found.frequencies_at([0.0]), [0.80601042, 2.80184711, 7.5], rtol=1e-8
    )


def test_rigid_body_modes_move_no_joint():
    """Two free beams with a joint on their relative rotation; elastic modes by dense algebra."""
    chain = plate_chain(lengths=(0.2, 0.3), stiffness=(500.0,), clamped=False)
    found = chain.reduced(to_hz=3000.0)
    assert np.sum(found.omega == 0) == 2
    weights = np.array([{"103:ry": -1.0, "200:ry": 1.0}.get(str(d), 0.0) for d in chain.model.dofs])
    stuck = chain.model.stiffness.toarray() + 500.0 * np.outer(weights, weights)
    exact = np.sqrt(scipy.linalg.eigvalsh(stuck, chain.model.mass.toarray())[2:])
    np.testing.assert_allclose(
        found.omega[2 : found.num_kept], exact[: found.num_kept - 2], rtol=1e-9
    )
    assert np.abs(found.H[0, :2]).max() < 1e-9 * np.abs(found.H).max()
    assert found.zeta[0] == found.zeta[1] == 0.0


def test_a_free_hinged_pair_has_the_closed_form_of_its_antisymmetric_mode():
    """No moment in the middle: half of it is a free-pinned beam, tan(x) = tanh(x)."""
    chain = plate_chain(lengths=(0.25, 0.25), stiffness=(500.0,), clamped=False, elements=16)
    found = chain.reduced(to_hz=2000.0)
    section = 0.2, 0.008, 70e9, 2700.0
    bending = section[2] * section[0] * section[1] ** 3 / 12
    per_length = section[3] * section[0] * section[1]
    root = 3.926602312047919
    expected = root**2 * np.sqrt(bending / per_length) / 0.25**2
    # Cubic elements of length h raise omega^2 by (kh)^4/720 (Strang and Fix, section 6.3).
    expected *= 1 + (root / 16) ** 4 / 1440
    nearest = found.omega[np.argmin(np.abs(found.omega - expected))]
    np.testing.assert_allclose(nearest, expected, rtol=1e-7)


def test_massless_degrees_are_condensed():
    """A spring between two masses, cut in the middle by a node without mass: springs in series."""
    mass = np.diag([2.0, 0.0, 1.0])
    stiffness = np.array([[300.0, -200.0, 0], [-200.0, 300.0, -100.0], [0, -100.0, 100.0]])
    model = matrix_model(mass, stiffness, units="SI", dofs=[(n, "x") for n in (1, 2, 3)])
    joint = Joint("end", {"3:x": 1.0}, stiffness=50.0)
    found = reduce(model, [joint], to_hz=10.0, input="1:x", outputs={"y": "2:x"}, zeta=0.0)
    series = 200.0 * 100.0 / 300.0
    condensed = np.array([[100.0 + series, -series], [-series, series + 50.0]])
    exact = np.sqrt(scipy.linalg.eigvalsh(condensed, np.diag([2.0, 1.0])))
    np.testing.assert_allclose(found.omega, exact, rtol=1e-12)
    assert any("without mass" in note for note in found.notes)


def test_a_craig_bampton_basis_gives_the_same_modes():
    """With every fixed-interface mode it is a change of coordinates, and loses nothing."""
    case = CASES[0]
    mass, stiffness = matrices(case)
    boundary = [case["input_dof"], 5, 7, 9, 11, case["tip_dof"]]
    inner = [i for i in range(mass.shape[0]) if i not in boundary]
    pick = np.ix_(inner, inner)
    static = -np.linalg.solve(stiffness[pick], stiffness[np.ix_(inner, boundary)])
    _, fixed = scipy.linalg.eigh(stiffness[pick], mass[pick])
    basis = np.zeros_like(mass)
    basis[boundary, range(len(boundary))] = 1.0
    basis[inner, : len(boundary)] = static
    basis[np.ix_(inner, range(len(boundary), len(mass)))] = fixed
    dofs = [(row + 1, "z") for row in boundary] + [(f"m{i}", "s") for i in range(len(inner))]
    element = matrix_model(
        basis.T @ mass @ basis, basis.T @ stiffness @ basis, units="SI", dofs=dofs
    )
    places = [
        Joint(
            j.name, {name.replace("row", "z"): w for name, w in j.weights.items()}, stiffness=1.5e7
        )
        for j in joints(case)
    ]
    full = reduced(case, 5)
    found = reduce(
        element, places, to_hz=full.frequencies_hz[-1] + 50, input=f"{case['input_dof'] + 1}:z",
        outputs={"tip": f"{case['tip_dof'] + 1}:z"}, zeta=0.004, holds_joints=True,
        slow_residual_modes=False,
    )  # fmt: skip
    # Dense products of matrices whose entries differ by 1e13 leave this much.
    np.testing.assert_allclose(found.omega, full.omega, rtol=1e-7)
    np.testing.assert_allclose(np.abs(found.H), np.abs(full.H), rtol=1e-5, atol=1e-6)


def test_of_coincident_modes_one_alone_moves_the_joint():
    """A mass on equal springs in x and y: any two orthogonal directions are its modes."""
    mass, stiffness = np.eye(2), 100.0 * np.eye(2)
    model = matrix_model(mass, stiffness, units="SI", dofs=[(1, "x"), (1, "y")])
    weights = {"1:x": 0.6, "1:y": 0.8}
    joint = Joint("slanted", weights, stiffness=1e-6)
    found = reduce(model, [joint], to_hz=5.0, input="1:x", outputs={"y": "1:y"}, zeta=0.01)
    np.testing.assert_allclose(np.sort(np.abs(found.H[0])), [0.0, 1.0], atol=1e-9)


def test_damping_of_a_matrix_is_that_of_its_modes():
    """C = a M + b K_s gives zeta = a/(2 omega) + b omega/2 exactly (Rayleigh)."""
    case = CASES[0]
    mass, stiffness = matrices(case)
    model = matrix_model(mass, stiffness, units="SI", damping=1.5 * mass + 2e-6 * stiffness)
    places = joints(case)
    found = reduce(
        model, places, to_hz=550.0, input="1:row", outputs={"tip": "17:row"}, holds_joints=True
    )
    omega = found.omega[: found.num_kept]
    expected = 1.5 / (2 * omega) + 2e-6 * omega / 2
    np.testing.assert_allclose(found.zeta[: found.num_kept], expected, rtol=1e-8)


def test_units_in_millimetres_and_tonnes_are_si():
    rig = lapped_beams()
    to_mm = np.array([1e3 if dof.direction == "z" else 1.0 for dof in rig.model.dofs])
    # q_mm = to_mm q; energies in N mm are 1e3 times those in N m.
    stiffness = 1e3 * rig.model.stiffness.toarray() / np.outer(to_mm, to_mm)
    mass = 1e3 * rig.model.mass.toarray() / np.outer(to_mm, to_mm)
    model = matrix_model(mass, stiffness, units="N-mm-t-s", dofs=rig.model.dofs)
    np.testing.assert_allclose(model.stiffness.toarray(), rig.model.stiffness.toarray(), rtol=1e-14)
    np.testing.assert_allclose(model.mass.toarray(), rig.model.mass.toarray(), rtol=1e-14)
