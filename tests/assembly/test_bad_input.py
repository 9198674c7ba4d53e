"""Every row of bad input: what is refused or warned of, in which words, and what cures it."""

import warnings

import numpy as np
import pytest
import scipy.sparse as sp
from golden_beams import CASES, joints, matrices, reduced, up_to

from jbw.assembly.joint import Joint
from jbw.assembly.matrices import matrix_model
from jbw.assembly.reduce import reduce
from jbw.errors import ConfigError, DataError, ModelError
from jbw.rig.assemblies import lapped_beams, plate_chain

MASS = np.diag([2.0, 1.0, 1.0])
STIFFNESS = np.array([[300.0, -100.0, 0.0], [-100.0, 200.0, -100.0], [0.0, -100.0, 100.0]])
DOFS = [(17, "x"), (17, "rx"), (112, "x")]


def three(mass=MASS, stiffness=STIFFNESS, dofs=DOFS, units="SI", **options):
    return matrix_model(mass, stiffness, units=units, dofs=dofs, **options)


def reduced_three(model=None, places=None, **options):
    places = places or [Joint("bolt", across=("17:x", "112:x"), stiffness=50.0)]
    stated = {"to_hz": 10.0, "input": "17:x", "outputs": {"tip": "112:x"}, "zeta": 0.01}
    return reduce(model or three(), places, **(stated | options))


def large(matrix):
    """The same block again and again, beyond the size of dense algebra."""
    return sp.block_diag([sp.csc_array(matrix)] * 200, format="csc")


def test_an_unsymmetric_matrix_is_refused_with_its_entries():
    stiffness = STIFFNESS.copy()
    stiffness[0, 1] *= 1.001
    with pytest.raises(DataError) as caught:
        three(stiffness=stiffness)
    assert "Matrix K must be symmetric" in caught.value.what
    assert "K[17:x, 17:rx] is -100.1" in caught.value.what
    assert "K[17:rx, 17:x] is -100" in caught.value.what


def test_a_triangle_is_named_as_one_and_its_remedy_cures():
    K = np.tril(STIFFNESS)
    with pytest.raises(DataError, match="must be symmetric") as caught:
        three(stiffness=K)
    formula = "K + K.T - diag(K)"
    assert formula in caught.value.remedy
    mirrored = eval(formula, {"K": K, "diag": lambda A: np.diag(np.diag(A))})
    np.testing.assert_array_equal(three(stiffness=mirrored).stiffness.toarray(), STIFFNESS)


def test_a_little_asymmetry_is_removed_and_said():
    stiffness = STIFFNESS.copy()
    stiffness[0, 1] *= 1 + 1e-8
    model = three(stiffness=stiffness)
    assert model.stiffness[0, 1] == model.stiffness[1, 0]
    (note,) = model.notes
    assert "symmetric part is used" in note
    stiffness[0, 1] = STIFFNESS[0, 1] * (1 + 1e-12)  # round-off of an export
    assert three(stiffness=stiffness).notes == ()


@pytest.mark.parametrize("size", ["small", "large"])
def test_an_indefinite_mass_is_refused_with_its_node(size):
    mass = np.array([[2.0, 0, 0], [0, 1.0, 1.2], [0, 1.2, 1.0]])
    if size == "large":
        dofs = [(node, direction) for node in range(200) for direction in ("x", "y", "z")]
        with pytest.raises(DataError, match=r"indefinite at node \d+, direction [yz]"):
            matrix_model(large(mass), large(STIFFNESS), units="SI", dofs=dofs)
    else:
        with pytest.raises(
            DataError, match=r"indefinite at node (17, direction rx|112, direction x)"
        ):
            three(mass=mass)


def test_a_negative_mass_is_refused_with_its_node():
    with pytest.raises(DataError, match="indefinite at node 112, direction x"):
        three(mass=np.diag([2.0, 1.0, -1.0]))


def test_a_zero_rotary_inertia_is_condensed_and_said():
    found = reduced_three(three(mass=np.diag([2.0, 0.0, 1.0])))
    assert any("without mass, which were condensed statically: 1." in note for note in found.notes)


@pytest.mark.parametrize("size", ["small", "large"])
def test_an_indefinite_stiffness_is_refused_with_its_lowest_eigenvalue(size):
    stiffness = STIFFNESS - 150.0 * np.eye(3)
    lowest = np.linalg.eigvalsh(
        np.diag(np.diag(MASS) ** -0.5) @ stiffness @ np.diag(np.diag(MASS) ** -0.5)
    )[0]
    places = [Joint("bolt", {"1:x": 1.0}, stiffness=1e-6)]
    if size == "large":
        dofs = [(n, d) for n in range(200) for d in ("x", "y", "z")]
        model = matrix_model(large(MASS), large(stiffness), units="SI", dofs=dofs)
        options = {"input": "1:x", "outputs": {"tip": "1:x"}}
    else:
        model, options = three(stiffness=stiffness), {}
        places = [Joint("bolt", {"17:x": 1.0}, stiffness=1e-6)]
    with pytest.raises(ModelError, match=f"lowest eigenvalue is {lowest:.4g}") as caught:
        reduced_three(model, places, **options)
    assert "preload" in caught.value.remedy
    assert "units" in caught.value.remedy


@pytest.mark.parametrize(
    ("place", "what", "remedy"),
    [
        ("17:z", "node 17 has no direction `z`", "Node 17 has the directions x, rx."),
        ("19:x", "there is no node 19", "The nearest nodes are 17, 112."),
        ("17", 'must be stated as "node:direction"', "directions are"),
        ("17:x*heavy", 'must be stated as "node:direction"', "directions are"),
    ],
)
def test_a_place_that_the_model_lacks_is_refused_with_the_nearest(place, what, remedy):
    for options in ({"input": place}, {"outputs": {"tip": place}}):
        with pytest.raises(ConfigError) as caught:
            reduced_three(**options)
        assert what in caught.value.what
        assert remedy in caught.value.remedy
    with pytest.raises(ConfigError) as caught:
        reduced_three(places=[Joint("bolt", [place], stiffness=1.0)])
    assert "Joint `bolt`" in caught.value.what
    assert what in caught.value.what


@pytest.mark.parametrize("row", [0, 4])
def test_a_row_out_of_range_is_refused_with_the_nearest(row):
    with pytest.raises(ConfigError, match=f"there is no node {row}") as caught:
        reduced_three(
            three(dofs=None), [Joint("bolt", {f"{row}:row": 1.0}, stiffness=1.0)], input="1:row"
        )
    assert "The nearest nodes are" in caught.value.remedy


def test_a_joint_on_a_constrained_degree_is_refused_and_why_is_said():
    with pytest.raises(ConfigError) as caught:
        reduced_three(places=[Joint("bolt", across=("17:x", "112:z"), stiffness=1.0)])
    assert "constrained or dependent" in caught.value.why


def test_a_joint_whose_ends_are_one_is_refused():
    with pytest.raises(ConfigError, match="two different degrees of freedom"):
        Joint("bolt", across=("17:x", "17:x"), stiffness=1.0)
    with pytest.raises(ConfigError, match="its weights cancel"):
        reduced_three(places=[Joint("bolt", ["17:x*1", "17:ux*-1"], stiffness=1.0)])


def test_a_joint_whose_ends_are_tied_is_refused():
    """Two degrees tied by a penalty: their relative motion is round-off beside their own."""
    stiffness = STIFFNESS + 1e14 * np.outer([1, 0, -1], [1, 0, -1])
    with pytest.raises(ConfigError, match="no mode up to `to_hz` moves this joint"):
        reduced_three(three(stiffness=stiffness))


def test_a_joint_that_no_kept_mode_moves_is_refused_and_more_modes_cure():
    """Three separate masses, of which the third is beyond `to_hz`."""
    model = three(np.eye(3), np.diag([100.0, 200.0, 1e6]))
    places = [Joint("bolt", {"112:x": 1.0}, stiffness=1.0)]
    with pytest.raises(ConfigError, match="no mode up to `to_hz` moves this joint") as caught:
        reduced_three(model, places)
    assert "raise `to_hz`" in caught.value.remedy
    assert reduced_three(model, places, to_hz=200.0).num_kept == 3


def test_shares_beyond_one_are_refused_and_the_remedy_cures():
    rig = lapped_beams()
    with pytest.raises(ModelError, match="shares of mode 1 add up to") as caught:
        rig.with_laws((), ()).reduced(holds_joints=True)
    assert "`holds_joints = false`" in caught.value.remedy
    assert rig.reduced(holds_joints=False).num_kept == 5


def test_the_golden_beams_hold_their_joints():
    """Where K holds the joints, shares are at most one to round-off, and nothing is refused."""
    for case in CASES:
        assert reduced(case, 5).num_kept == 5


def test_a_joint_that_a_rigid_body_mode_moves_is_warned_of():
    chain = plate_chain(lengths=(0.2, 0.3), stiffness=(500.0,), clamped=False)
    ground = [Joint("foot", {"100:z": 1.0, "103:z": -0.5}, stiffness=1e-3)]
    with pytest.warns(UserWarning, match="A rigid-body mode moves joint `foot`"):
        reduce(chain.model, ground, to_hz=500.0, input="102:z", outputs={}, zeta=0.01,
               holds_joints=True)  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        chain.reduced()


@pytest.mark.parametrize("factor", [1.0, -3.0])
def test_two_joints_at_one_place_are_refused(factor):
    places = [
        Joint("bolt 1", across=("17:x", "112:x"), stiffness=1.0),
        Joint("bolt 2", {"17:x": -factor, "112:x": factor}, stiffness=1.0),
    ]
    with pytest.raises(ConfigError, match="weights are the same up to a factor") as caught:
        reduced_three(places=places)
    assert "one joint with two laws" in caught.value.remedy


@pytest.mark.parametrize("factor", [1e12, 1e-12])
def test_an_implausible_first_frequency_is_warned_of_with_the_likely_unit(factor):
    with pytest.warns(UserWarning, match=r"Check `units`.*31\.6"):
        reduced_three(
            three(stiffness=STIFFNESS * factor),
            [Joint("bolt", across=("17:x", "112:x"), stiffness=50.0 * factor)],
            to_hz=10.0 * factor**0.5,
        )


def test_damping_that_couples_modes_is_warned_of_with_the_number():
    damping = np.diag([0.5, 0.0, 0.0])
    with pytest.warns(UserWarning, match=r"couples modes 1 and \d by 100 %"):
        reduced_three(three(damping=damping), zeta=None)


def test_damping_must_be_stated():
    with pytest.raises(ConfigError, match="so damping ratios must be stated") as caught:
        reduced_three(zeta=None)
    assert "zeta=0.004" in caught.value.remedy
    assert reduced_three(zeta=0.004).zeta[0] == 0.004
    with pytest.raises(ConfigError, match="one number, or 3"):
        reduced_three(zeta=[0.01, 0.02])
    with pytest.raises(ModelError, match="finite and not negative"):
        reduced_three(zeta=-0.01)


def test_unknown_units_and_unknown_rows_are_refused():
    with pytest.raises(ConfigError, match="must be one of SI, N-mm-t-s"):
        three(units="N-mm-kg-s")
    with pytest.raises(ConfigError, match="must have a table of degrees of freedom"):
        three(units="N-mm-t-s", dofs=None)
    with pytest.raises(DataError, match="must have a line for each of the 3 rows"):
        three(dofs=DOFS[:2])
    with pytest.raises(DataError, match="rows 1 and 3 are both `17:x`"):
        three(dofs=[*DOFS[:2], (17, "ux")])
    with pytest.raises(DataError, match="Direction of node 17 must be one of"):
        three(dofs=[*DOFS[:2], (17, "w")])


def test_matrices_of_other_shapes_and_numbers_are_refused():
    with pytest.raises(DataError, match="must be square"):
        three(mass=np.ones(3))
    with pytest.raises(DataError, match="the same size"):
        three(stiffness=np.eye(2))
    with pytest.raises(DataError, match="finite"):
        three(stiffness=STIFFNESS * np.nan)
    with pytest.raises(DataError, match="real"):
        three(stiffness=STIFFNESS * (1 + 0.01j))
    with pytest.raises(DataError, match="must have mass"):
        three(mass=np.zeros((3, 3)))


def test_a_frequency_below_the_first_is_refused_and_the_remedy_cures():
    with pytest.raises(ConfigError, match="above the first frequency") as caught:
        reduced_three(to_hz=0.1)
    proposed = float(caught.value.remedy.split("Set `to_hz` to ")[1].split(" Hz")[0])
    assert reduced_three(to_hz=proposed).num_kept >= 1


def test_joints_need_names_a_place_and_a_stiffness():
    with pytest.raises(ConfigError, match="At least one joint"):
        reduce(three(), [], to_hz=10.0, input="17:x", outputs={}, zeta=0.01)
    with pytest.raises(ConfigError, match="`bolt` occurs twice"):
        reduced_three(
            places=[
                Joint("bolt", {"17:x": 1.0}, stiffness=1.0),
                Joint("bolt", {"112:x": 1.0}, stiffness=1.0),
            ]
        )
    with pytest.raises(ConfigError, match="has neither"):
        Joint("bolt", stiffness=1.0)
    with pytest.raises(ConfigError, match="has both"):
        Joint("bolt", {"17:x": 1.0}, across=("17:x", "112:x"), stiffness=1.0)
    with pytest.raises(ConfigError, match="must be two degrees of freedom"):
        Joint("bolt", across=("17:x",), stiffness=1.0)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ModelError, match="positive and finite"):
        Joint("bolt", {"17:x": 1.0}, stiffness=0.0)
    with pytest.raises(ConfigError, match="`to_hz` must be positive"):
        reduced_three(to_hz=-1.0)


def test_laws_stiffer_than_their_joint_are_refused():
    from jbw.oscillator.laws.bouc_wen import BoucWenLaw

    law = BoucWenLaw(2e7, 8e5, 2e5)
    with pytest.raises(ModelError, match="no more stiffness at rest than the fully") as caught:
        Joint("bolt", {"17:x": 1.0}, stiffness=1.5e7, laws=law)
    assert "Raise `stiffness`" in caught.value.remedy
    assert Joint("bolt", {"17:x": 1.0}, stiffness=2e7, laws=law).laws == (law,)


def test_slowed_residual_modes_are_said_with_their_frequencies():
    case = CASES[0]
    to_hz = up_to(case, 3)
    found = reduced(case, 3, slow_residual_modes=True)
    (note,) = [note for note in found.notes if "was lowered" in note]
    assert f"{5 * to_hz:.4g} Hz" in note
    assert note in repr(found)


def test_golden_joints_have_their_names():
    assert [joint.name for joint in joints(CASES[1])] == ["joint 1", "joint 2", "joint 3"]
    assert matrices(CASES[1])[0].shape == (19, 19)
