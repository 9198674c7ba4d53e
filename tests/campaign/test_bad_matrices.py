"""Bad matrices, places and joints as a campaign file has them: what `jbw check` says of each."""

import numpy as np
import pytest
import scipy.io
from test_joint_tables import BOLTS, STRUCTURE, TESTS, doubts_of, errors_of, written

from jbw.campaign.check import check_campaign
from jbw.campaign.load import load_campaign
from jbw.errors import JbwError
from jbw.rig.assemblies import lapped_beams, plate_chain

SLIP = 'weights = { "3:ry" = 0.0025, "101:ry" = 0.0025 }'
SECOND = SLIP.replace("3:ry", "4:ry").replace("101:ry", "102:ry")


@pytest.fixture
def folder(tmp_path):
    """A folder with a sweep through the first two modes of the beams."""
    t = np.arange(1024) / 512.0
    u = np.sin(2 * np.pi * (20 * t + 25 * t**2))
    noise = 1e-5 * np.random.default_rng(0).standard_normal(t.size)
    np.savez(tmp_path / "sweep.npz", u=u, v=np.gradient(u, t) * 1e-5 + noise)
    return tmp_path


def check_of(folder, text=STRUCTURE + BOLTS + TESTS, model=None, **changes):
    """The check of a campaign with the beams' matrices, or others, after some changes."""
    model = lapped_beams().model if model is None else model
    dofs = [str(dof) for dof in model.dofs]
    matrices = {"M": model.mass.toarray(), "K": model.stiffness.toarray()}
    matrices |= {"dofs": np.array(dofs, dtype=object)[:, None]}
    for name, change in changes.items():
        matrices[name] = change(matrices, dofs)
    scipy.io.savemat(folder / "beams.mat", matrices)
    return check_campaign(written(folder, text))


def refusal_of(folder, *args, **changes):
    """The one error of a check, which stops an identification too."""
    check = check_of(folder, *args, **changes)
    (fault,) = errors_of(check)
    assert check.exit_code in (2, 3)
    with pytest.raises(JbwError) as caught:
        load_campaign(folder / "campaign.toml")
    assert caught.value.what in fault.what
    return fault


def doubt_of(folder, words, *args, **changes):
    """The one doubt of a check that says these words; an identification goes on, and says it."""
    check = check_of(folder, *args, **changes)
    assert errors_of(check) == []
    (fault,) = doubts_of(check, words)
    with pytest.warns(UserWarning, match=words):
        load_campaign(folder / "campaign.toml")
    return fault


def with_entry(name, row, column, factor):
    """A change of one entry of a matrix, at degrees of freedom by name."""

    def change(matrices, dofs):
        matrix = matrices[name].copy()
        matrix[dofs.index(row), dofs.index(column)] *= factor
        return matrix

    return change


def test_a_matrix_that_is_not_symmetric_names_its_largest_pair_of_entries(folder):
    fault = refusal_of(folder, K=with_entry("K", "3:z", "3:ry", 1.01))
    assert "Matrix K must be symmetric, but K[3:z, 3:ry] is " in fault.what.replace(
        "K[3:ry, 3:z]", "K[3:z, 3:ry]"
    )
    assert "without friction" in fault.remedy


def test_a_mass_matrix_that_is_indefinite_names_node_and_direction(folder):
    fault = refusal_of(folder, M=with_entry("M", "105:ry", "105:ry", -1.0))
    assert "indefinite at node 105, direction ry" in fault.what


def test_rotary_inertia_of_zero_is_condensed_and_said(folder):
    def without_rotation(matrices, dofs):
        keep = np.array([not dof.endswith("ry") for dof in dofs])
        return matrices["M"] * np.outer(keep, keep)

    check = check_of(folder, M=without_rotation)
    assert errors_of(check) == []
    assert check.joints is not None
    assert any("which were condensed statically: 9" in note for note in check.joints.notes)


def test_a_stiffness_matrix_that_is_indefinite_has_its_lowest_eigenvalue(folder):
    fault = refusal_of(folder, K=lambda matrices, _: matrices["K"] - 1e5 * matrices["M"])
    assert "lowest eigenvalue is -" in fault.what
    assert "preload" in fault.remedy
    assert "units" in fault.remedy


@pytest.mark.parametrize(
    ("old", "new", "what", "remedy"),
    [
        ('input = "1:z"', 'input = "7:z"', "there is no node 7", "nearest nodes are"),
        ('input = "1:z"', 'input = "1:x"', "no direction `x`", "Node 1 has"),
        ('tip = "105:z"', 'tip = "106:z"', "there is no node 106", "nearest nodes are 105"),
        (SLIP, 'across = ["3:x", "101:z"]', "no direction `x`", "Node 3 has"),
    ],
)
def test_a_place_that_the_model_lacks_names_the_nearest(folder, old, new, what, remedy):
    text = STRUCTURE + BOLTS + TESTS
    assert text.count(old) == 1
    fault = refusal_of(folder, text.replace(old, new))
    assert what in fault.what
    assert remedy in fault.remedy
    if "across" in new:
        assert "constrained or dependent" in fault.why


def test_a_row_out_of_range_names_the_nearest(folder):
    text = """[structure]
matrices = "rows.mat"
units = "SI"
to_hz = 1000.0
damping = 0.004
input = "1:row"
points = { tip = "40:row" }

[[joint]]
name = "bolt 1"
weights = { "6:row" = 0.0025, "11:row" = 0.0025 }
stiffness = 1.5e7

"""
    model = lapped_beams().model
    scipy.io.savemat(folder / "rows.mat", {"M": model.mass, "K": model.stiffness})
    (fault,) = errors_of(check_campaign(written(folder, text + TESTS)))
    assert "Output `tip` must be at degrees of freedom of the model" in fault.what
    assert "there is no node 40" in fault.what
    assert "The nearest nodes are 18" in fault.remedy
    cured = text.replace("40:row", "18:row")
    assert errors_of(check_campaign(written(folder, cured + TESTS))) == []


def test_a_joint_whose_ends_are_tied_would_not_move(folder):
    def tied(matrices, dofs):
        tie = np.zeros(len(dofs))
        tie[[dofs.index("3:ry"), dofs.index("101:ry")]] = 1.0
        return matrices["K"] + 1e16 * np.outer(tie, tie)

    fault = refusal_of(folder, K=tied)
    assert "Joint `bolt 1` must move, but no mode up to `to_hz` moves this joint" in fault.what
    cancelled = BOLTS.replace(SLIP, 'weights = ["3:ry*1", "3:ry*-1"]')
    fault = refusal_of(folder, STRUCTURE + cancelled + TESTS)
    assert "Joint `bolt 1` must move, but its weights cancel" in fault.what


def test_joints_at_one_place_are_one_joint_with_two_laws(folder):
    twice = BOLTS.replace(SECOND, SLIP.replace("0.0025", "-0.005"))
    fault = refusal_of(folder, STRUCTURE + twice + TESTS)
    assert "`bolt 1` and `bolt 2` must act at different points" in fault.what
    assert "one joint with two laws" in fault.remedy


def test_a_joint_that_a_rigid_body_mode_moves_is_doubtful(folder):
    chain = plate_chain(lengths=(0.2, 0.3), stiffness=(500.0,), clamped=False)
    text = """[structure]
matrices = "beams.mat"
units = "SI"
holds_joints = true
to_hz = 500.0
damping = 0.01
input = "102:z"
points = { tip = "203:z" }

[[joint]]
name = "foot"
weights = { "100:z" = 1.0, "103:z" = -0.5 }
stiffness = 1e-3

"""
    doubt_of(folder, "A rigid-body mode moves joint `foot`", text + TESTS, chain.model)


def test_a_first_frequency_of_no_bolted_structure_is_doubtful(folder):
    text = STRUCTURE.replace("to_hz = 1000.0", "to_hz = 1e9") + BOLTS + TESTS
    stiff = text.replace("stiffness = 1.5e7", "stiffness = 1.5e19")
    fault = doubt_of(
        folder, "outside 0.01 to 100000 Hz", stiff, K=lambda matrices, _: 1e12 * matrices["K"]
    )
    assert "off by a factor of 31.6" in fault.what


def test_damping_that_couples_modes_is_doubtful_with_its_number(folder):
    def dashpot(matrices, dofs):
        C = np.zeros_like(matrices["K"])
        tip = dofs.index("105:z")
        C[tip, tip] = 1.0
        return C

    text = STRUCTURE.replace("damping = 0.004\n", "") + BOLTS + TESTS
    fault = doubt_of(folder, "The damping matrix couples modes", text, C=dashpot)
    assert "% of their own damping" in fault.what


def test_a_joint_that_no_swept_mode_moves_keeps_its_prior(folder):
    """Two masses of 1 kg on springs of their own: a sweep through one does not move the other."""
    text = """[structure]
matrices = "masses.mat"
units = "SI"
to_hz = 200.0
damping = 0.004
input = ["1:x", "2:x"]
points = { both = ["1:x", "2:x"] }

[[joint]]
name = "first"
weights = { "1:x" = 1.0 }
stiffness = 1e4

[[joint]]
name = "second"
weights = { "2:x" = 1.0 }
stiffness = 1e4

"""
    places = np.array(["1:x", "2:x"], dtype=object)[:, None]
    # In full stick at 50 and 151 Hz, of which 20 to 120 Hz are swept.
    masses = {"M": np.eye(2), "K": np.diag([9e4, 8.9e5]), "dofs": places}
    scipy.io.savemat(folder / "masses.mat", masses)
    check = check_campaign(written(folder, text + TESTS))
    assert errors_of(check) == []
    (doubt,) = doubts_of(check, "do not constrain")
    assert "`second`" in doubt.what
