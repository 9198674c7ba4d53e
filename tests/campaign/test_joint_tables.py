"""[structure] with matrices and [[joint]]: what they take, what a check says, what it refuses."""

import json
import re

import numpy as np
import pytest
import scipy.io

from jbw.campaign.check import check_campaign
from jbw.campaign.joints import SeveralJoints, reduced_model, starts_of
from jbw.campaign.load import load_campaign
from jbw.campaign.schema import parse, read_spec
from jbw.cli import run
from jbw.errors import ConfigError
from jbw.rig.assemblies import lapped_beams, portal_frame

STRUCTURE = """[structure]
matrices = "beams.mat"
units = "SI"
to_hz = 1000.0
damping = 0.004
input = "1:z"
points = { tip = "105:z", slip = ["3:ry*0.0025", "101:ry*0.0025"] }
"""
BOLTS = """[[joint]]
name = "bolt 1"
weights = { "3:ry" = 0.0025, "101:ry" = 0.0025 }
stiffness = 1.5e7

[[joint]]
name = "bolt 2"
weights = { "4:ry" = 0.0025, "102:ry" = 0.0025 }
stiffness = 1.5e7
"""
TESTS = """[[test]]
name = "sweep"
kind = "sweep"
files = "sweep.npz"
channels = { force = "u", velocity = "v" }
units = { force = "N", velocity = "m/s" }
fs = 512.0
band = [20.0, 120.0]
"""
MEASURED = """[structure]
modes = [32.2, 90.5, 306.6]
"""
SHAPES = """[[joint]]
name = "bolt 1"
shape = [1.0, 0.2, 3.0]

[[joint]]
name = "bolt 2"
shape = [1.0, 1.2, -2.0]
"""
PUT = re.compile(r"Put under \[\[joint\]\] `([^`]+)`: `([^`]+)`")


def pasted(text, remedy):
    """The campaign with the line of a remedy under the joint that it names."""
    ((name, line),) = PUT.findall(remedy)
    head = f'name = "{name}"\n'
    assert text.count(head) == 1
    return text.replace(head, f"{head}{line}\n")


def refused(text):
    with pytest.raises(ConfigError) as caught:
        parse(text)
    return str(caught.value)


@pytest.fixture
def folder(tmp_path):
    write_matrices(tmp_path / "beams.mat", lapped_beams().model)
    t = np.arange(1024) / 512.0
    u = np.sin(2 * np.pi * (20 * t + 25 * t**2))
    v = np.gradient(u, t) * 1e-5 + 1e-5 * np.random.default_rng(0).standard_normal(t.size)
    np.savez(tmp_path / "sweep.npz", u=u, v=v)
    return tmp_path


def write_matrices(path, model):
    dofs = np.array([str(dof) for dof in model.dofs], dtype=object)[:, None]
    scipy.io.savemat(path, {"M": model.mass, "K": model.stiffness, "dofs": dofs})


def written(folder, text):
    path = folder / "campaign.toml"
    path.write_text(text)
    return path


def errors_of(check):
    return [f for row in check.rows for f in row.findings if f.severity == "error"]


def doubts_of(check, words):
    return [f for row in check.rows for f in row.findings if words in f.what]


def test_tables_are_read():
    spec = parse(STRUCTURE + BOLTS + TESTS)
    assert spec.structure is None
    assert spec.assembled is not None
    assert (spec.assembled.units, spec.assembled.to_hz) == ("SI", 1000.0)
    assert spec.assembled.points["slip"] == ("3:ry*0.0025", "101:ry*0.0025")
    assert [joint.name for joint in spec.joints] == ["bolt 1", "bolt 2"]
    assert spec.joints[0].weights == {"3:ry": 0.0025, "101:ry": 0.0025}


def test_one_joint_table_is_read_as_before():
    spec = parse('[joint]\nlaws = ["jenkins"]\n' + TESTS)
    assert (spec.laws, spec.joints, spec.assembled) == (("jenkins",), (), None)


def test_the_matrices_are_reduced_as_stated(folder):
    path = written(folder, STRUCTURE + BOLTS + TESTS)
    model = reduced_model(read_spec(path), folder)
    rig = lapped_beams().reduced(zeta=0.004)
    np.testing.assert_allclose(model.omega, rig.omega, rtol=1e-9)
    assert model.outputs == ("tip", "slip")
    np.testing.assert_allclose(model.c[1], model.H[0], rtol=1e-9, atol=1e-12)


def test_a_check_says_frequencies_shares_and_separability(folder):
    check = check_campaign(written(folder, STRUCTURE + BOLTS + TESTS))
    joints = check.joints
    assert joints is not None
    rig = lapped_beams().reduced()
    np.testing.assert_allclose(joints.frequencies_hz, rig.frequencies_hz, rtol=1e-9)
    assert joints.swept == (0, 1)  # modes at 32 and 90 Hz lie in the band
    assert joints.separability is not None
    # As the specification of the golden beams states it.
    assert joints.separability.condition == pytest.approx(2.47, rel=0.01)


def test_the_command_prints_them(folder, capsys):
    path = written(folder, STRUCTURE + BOLTS + TESTS)
    run(["check", str(path)])
    text = capsys.readouterr().out
    for words in ("energy share of bolt 1", "32.158 Hz", "matrix B: 2.47", "was lowered"):
        assert words in text
    run(["check", str(path), "--json"])
    answer = json.loads(capsys.readouterr().out)["joints"]
    assert answer["swept_modes"] == [1, 2]
    assert answer["separability"]["joints"] == ["bolt 1", "bolt 2"]


def test_shapes_of_measured_modes_have_a_separability(folder):
    check = check_campaign(written(folder, MEASURED + SHAPES + TESTS))
    assert check.joints is not None
    assert check.joints.shares is None
    assert check.joints.separability is not None
    B = np.abs([[1.0, 1.0], [0.2, 1.2]]) ** 3
    np.testing.assert_allclose(check.joints.separability.participation, B, rtol=1e-12)
    unknown = SHAPES.replace("shape = [1.0, 0.2, 3.0]\n", "")
    check = check_campaign(written(folder, MEASURED + unknown + TESTS))
    assert check.joints is not None
    assert check.joints.separability is None


def test_joints_of_measured_modes_are_refused_and_the_modes_as_matrices_are_taken(folder):
    def lines_of(remedy):
        return re.findall(r"`(holds_joints = \w+)`", remedy)

    with pytest.raises(ConfigError, match="cannot be identified yet") as caught:
        load_campaign(written(folder, MEASURED + SHAPES + TESTS))
    assert "jbw check" in caught.value.remedy
    (line,) = lines_of(caught.value.remedy)
    # The first two modes of the beams, as if they were measured.
    model = lapped_beams().reduced()
    places = ["1:x", "2:x"]
    np.savez(folder / "modes.npz", M=np.eye(2), K=np.diag(model.omega[:2] ** 2), dofs=places)

    def shape(row):
        return (
            "{ "
            + ", ".join(f'"{n}" = {x!r}' for n, x in zip(places, row.tolist(), strict=True))
            + " }"
        )

    text = f"""[structure]
matrices = "modes.npz"
units = "SI"
{line}
to_hz = 120.0
damping = 0.004
input = {shape(model.b[:2])}
points = {{ tip = {shape(model.c[0, :2])} }}
"""
    for joint, row in zip(model.joints, model.H[:, :2], strict=True):
        text += f'[[joint]]\nname = "{joint.name}"\nstiffness = {joint.stiffness}\n'
        text += f"weights = {shape(row)}\n"
    joints = load_campaign(written(folder, text + TESTS)).joints
    assert joints is not None
    np.testing.assert_allclose(joints.model.omega, model.omega[:2], rtol=1e-12)
    np.testing.assert_allclose(np.abs(joints.model.H), np.abs(model.H[:, :2]), rtol=1e-12)


def test_a_campaign_with_matrices_has_its_laws_at_its_joints(folder):
    campaign = load_campaign(written(folder, STRUCTURE + BOLTS + TESTS))
    assert campaign.laws == ("bouc_wen@bolt_1", "bouc_wen@bolt_2")
    assert campaign.joints is not None
    assert campaign.joints.model.outputs == ("tip", "slip")
    tied = BOLTS.replace('name = "bolt 2"', 'name = "bolt 2"\nsame_as = "bolt 1"')
    campaign = load_campaign(written(folder, STRUCTURE + tied + TESTS))
    assert campaign.laws == ("bouc_wen@bolt_1=bolt_2",)


def test_names_of_joints_that_look_alike_in_parameters_are_refused(folder):
    alike = BOLTS.replace('name = "bolt 2"', 'name = "bolt_1"')
    with pytest.raises(ConfigError, match="must differ from the names of other joints"):
        load_campaign(written(folder, STRUCTURE + alike + TESTS))


def test_what_matrices_tell_is_refused_beside_them_and_the_remedy_cures(folder):
    text = STRUCTURE + BOLTS + TESTS
    for line, says in (("gain = 2.0", "gain"), ("modal_mass = 0.1", "modal_mass"),
                       ("fs_std = 1e-5", "errors of instruments")):  # fmt: skip
        with pytest.raises(ConfigError, match=says) as caught:
            load_campaign(written(folder, f"[campaign]\n{line}\n{text}"))
        assert caught.value.remedy.startswith("Leave ")


def test_shapes_are_those_of_the_model_unless_they_are_uncertain(folder):
    text = STRUCTURE + BOLTS + TESTS
    uncertain = text.replace("damping = 0.004", 'damping = 0.004\nshapes = "uncertain"')
    for stated, answer in ((text, False), (uncertain, True)):
        campaign = load_campaign(written(folder, stated))
        assert campaign.joints is not None
        assert campaign.joints.uncertain is answer


def frame(**changes):
    """A campaign of a symmetric portal frame, whose links are mirror images."""
    rig = portal_frame(heights=(0.4, 0.4))
    links = "\n".join(
        f'[[joint]]\nname = "{joint.name}"\nstiffness = 400.0\n'
        f"across = {json.dumps(list(joint.weights))}\n{changes.get(joint.name, '')}"
        for joint in rig.joints
    )
    structure = """[structure]
matrices = "frame.mat"
units = "SI"
to_hz = 400.0
damping = 0.004
input = "102:x"
points = { sway = "104:x" }
"""
    return structure + links + "\n" + TESTS.replace("band = [20.0, 120.0]", "")


def test_label_switching_is_refused_and_the_remedy_cures(folder):
    write_matrices(folder / "frame.mat", portal_frame(heights=(0.4, 0.4)).model)
    text = frame()
    check = check_campaign(written(folder, text))
    (fault,) = errors_of(check)
    assert check.exit_code == 2
    assert "mirror images" in fault.what
    assert 'same_as = "left link"' in fault.remedy
    cured = check_campaign(written(folder, pasted(text, fault.remedy)))
    assert errors_of(cured) == []
    assert cured.joints is not None
    assert cured.joints.separability is not None
    assert cured.joints.separability.joints == ("left link = right link",)


def test_joints_of_other_laws_are_doubtful_alone(folder):
    write_matrices(folder / "frame.mat", portal_frame(heights=(0.4, 0.4)).model)
    check = check_campaign(written(folder, frame(**{"right link": 'laws = ["jenkins"]\n'})))
    assert errors_of(check) == []
    assert any("mirror images" in f.what for row in check.rows for f in row.findings)


def test_one_swept_mode_tells_no_two_joints_apart(folder):
    text = STRUCTURE + BOLTS + TESTS.replace("[20.0, 120.0]", "[20.0, 60.0]")
    check = check_campaign(written(folder, text))
    assert errors_of(check) == []  # what all joints do together is told
    (doubt,) = doubts_of(check, "not distinguished by mode 1")
    cured = check_campaign(written(folder, pasted(text, doubt.remedy)))
    assert doubts_of(cured, "not distinguished") == []


def test_a_joint_that_no_swept_mode_moves_keeps_its_prior(folder):
    shapes = SHAPES.replace("[1.0, 0.2, 3.0]", "[1e-3, 1e-4, 3.0]")
    check = check_campaign(written(folder, MEASURED + shapes + TESTS))
    doubts = [f.what for row in check.rows for f in row.findings]
    assert any("`bolt 1`" in what and "do not constrain" in what for what in doubts)


def test_a_swept_mode_that_moves_no_joint_is_left_out_of_the_table(folder):
    still = SHAPES.replace("[1.0, 0.2, 3.0]", "[1.0, 0.0, 3.0]")
    still = still.replace("[1.0, 1.2, -2.0]", "[1.0, 0.0, -2.0]")
    check = check_campaign(written(folder, MEASURED + still + TESTS))
    assert check.joints is not None
    assert check.joints.separability is not None
    assert check.joints.separability.modes == (0,)
    only = TESTS.replace("[20.0, 120.0]", "[80.0, 120.0]")
    check = check_campaign(written(folder, MEASURED + still + only))
    doubts = [f.what for row in check.rows for f in row.findings]
    assert any("No mode in the bands of the tests moves a joint" in what for what in doubts)


def test_fewer_swept_modes_than_laws_are_doubtful(folder):
    third = '[[joint]]\nname = "bolt 3"\nshape = [-0.5, 0.6, 1.0]\n'
    check = check_campaign(written(folder, MEASURED + SHAPES + third + TESTS))
    doubts = [f.what for row in check.rows for f in row.findings]
    assert any("To determine 3 laws, at least 3 modes must be swept" in what for what in doubts)


def test_what_the_model_refuses_is_an_error_of_the_structure(folder):
    text = STRUCTURE + BOLTS.replace('"4:ry" =', '"99:ry" =') + TESTS
    check = check_campaign(written(folder, text))
    (fault,) = errors_of(check)
    assert "Joint `bolt 2` must be at degrees of freedom of the model" in fault.what
    assert "The nearest nodes are 101" in fault.remedy
    assert check.exit_code == 2


def test_joints_that_k_does_not_hold_are_refused_and_the_remedy_cures(folder):
    def lines_of(remedy):
        return re.findall(r"`(holds_joints = \w+)`", remedy)

    stated = STRUCTURE + "holds_joints = true\n"
    (fault,) = errors_of(check_campaign(written(folder, stated + BOLTS + TESTS)))
    assert "shares of mode 1 add up to" in fault.what
    (line,) = lines_of(fault.remedy)
    cured = stated.replace("holds_joints = true", line)
    assert errors_of(check_campaign(written(folder, cured + BOLTS + TESTS))) == []


def test_damping_that_nothing_states_is_refused_and_the_remedy_cures(folder):
    def lines_of(remedy):
        return re.findall(r"`(damping = [\d.]+)` under \[structure\]", remedy)

    stated = STRUCTURE.replace("damping = 0.004\n", "")
    (fault,) = errors_of(check_campaign(written(folder, stated + BOLTS + TESTS)))
    (line,) = lines_of(fault.remedy)
    assert errors_of(check_campaign(written(folder, f"{stated}{line}\n{BOLTS}{TESTS}"))) == []


def test_a_damaged_file_of_matrices_is_a_fault_of_the_data(folder):
    (folder / "beams.mat").write_bytes(b"MATLAB 5.0 MAT-file" + bytes(200))
    check = check_campaign(written(folder, STRUCTURE + BOLTS + TESTS))
    (fault,) = errors_of(check)
    assert "beams.mat cannot be read" in fault.what
    assert check.exit_code == 3
    (folder / "beams.mat").unlink()
    assert check_campaign(folder / "campaign.toml").exit_code == 3


def test_matrices_stay_in_the_folder_of_the_campaign(folder, tmp_path_factory):
    other = tmp_path_factory.mktemp("other")
    (folder / "beams.mat").rename(other / "beams.mat")
    text = STRUCTURE.replace('"beams.mat"', f'"{other}/beams.mat"') + BOLTS + TESTS
    (fault,) = errors_of(check_campaign(written(folder, text)))
    assert "points outside the campaign's folder" in fault.what
    assert errors_of(check_campaign(written(folder, text), allow_outside=True)) == []


def test_files_of_one_matrix_each(folder):
    model = lapped_beams().model
    scipy.io.mmwrite(folder / "M.mtx", model.mass, precision=17)
    scipy.io.mmwrite(folder / "K.mtx", model.stiffness, precision=17)
    rows = [f"{i},{dof.node},{dof.direction}" for i, dof in enumerate(model.dofs, 1)]
    (folder / "dofs.csv").write_text("\n".join(rows))
    files = '{ mass = "M.mtx", stiffness = "K.mtx", dofs = "dofs.csv" }'
    text = STRUCTURE.replace('"beams.mat"', files) + BOLTS + TESTS
    assert errors_of(check_campaign(written(folder, text))) == []


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('units = "SI"\n', "", "[structure] units: missing"),
        ('units = "SI"', 'units = "N-mm-kg"', "[structure] units: 'N-mm-kg' is unknown"),
        ("to_hz = 1000.0\n", "", "[structure] to_hz: missing"),
        ("damping = 0.004", "damping = 1.5", "[structure] damping: must be ratios from 0 to 1"),
        ('input = "1:z"', 'input = "1"', '[structure] input: must be stated as "node:direction"'),
        ('input = "1:z"', 'inputs = "1:z"', "did you mean `input`"),
        ('"beams.mat"', '{ mass = "M.mtx" }', "[structure] matrices: must be a file, or files"),
        ('"beams.mat"', '{ mass = "M", stiffness = "K", mas = "x" }', "did you mean `mass`"),
        ("stiffness = 1.5e7\n\n", "", "[[joint]] `bolt 1` stiffness: missing"),
        (
            'name = "bolt 2"',
            'name = "bolt 1"',
            "name: must be unique, but 2 joints have the same name",
        ),
        ('name = "bolt 2"', 'name = "bolt 2"\nsame_as = "bolt 7"', "must be the name of a joint"),
        ('name = "bolt 2"', 'name = "bolt 2"\nsame_as = "bolt 2"', "in a circle"),
        ('name = "bolt 2"', 'name = "bolt 2"\nlaws = ["jenkin"]', "`bolt 2` laws"),
        (
            'name = "bolt 2"',
            'name = "bolt 2"\nsame_as = "bolt 1"\nlaws = ["jenkins"]',
            "must have the same laws, but `bolt 2` has jenkins and `bolt 1` bouc_wen",
        ),
        (
            'name = "bolt 2"',
            'name = "bolt 2"\nacross = ["4:x", "4:z"]',
            "weights: states the same as `across`; leave out one of the two",
        ),
        (
            'weights = { "4:ry" = 0.0025, "102:ry" = 0.0025 }',
            'across = ["4:x", "4:x"]',
            "across: must be two different degrees of freedom",
        ),
        (
            'weights = { "4:ry" = 0.0025, "102:ry" = 0.0025 }\n',
            "",
            "[[joint]] `bolt 2`: if there are matrices, a joint must have `across` or `weights`",
        ),
        ('name = "sweep"', 'name = "sweep"\npoint = "wing"', "[structure] points: must name"),
    ],
)
def test_what_cannot_be_meant_is_refused(old, new, says):
    text = STRUCTURE + BOLTS + TESTS
    assert text.count(old) == 1
    assert says in refused(text.replace(old, new))


def test_a_circle_of_joints_is_refused():
    first, second = ('name = "bolt 1"\n', 'name = "bolt 2"\n')
    bolts = BOLTS.replace(first, first + 'same_as = "bolt 2"\n')
    bolts = bolts.replace(second, second + 'same_as = "bolt 1"\n')
    assert "in a circle" in refused(STRUCTURE + bolts + TESTS)


def test_matrices_need_joints_and_joints_of_modes_need_shapes_of_them():
    assert "need a [[joint]] table for every joint" in refused(STRUCTURE + TESTS)
    text = MEASURED + SHAPES.replace("[1.0, 0.2, 3.0]", "[1.0, 0.2]") + TESTS
    assert "must have a number for each of 3 modes" in refused(text)
    assert "needs `matrices` under [structure]" in refused(MEASURED + BOLTS + TESTS)


def test_bounds_are_stated_by_the_names_of_the_joints(folder):
    prior = '[identify]\nprior = { "alpha@bolt_1" = [1e6, 1e7] }\n'
    campaign = load_campaign(written(folder, STRUCTURE + BOLTS + TESTS + prior))
    assert campaign.settings.prior["alpha@bolt_1"] == (1e6, 1e7)
    says = refused(STRUCTURE + BOLTS + TESTS + prior.replace("bolt_1", "bolt_7"))
    assert "alpha@bolt_7: unknown parameter" in says


@pytest.mark.parametrize("tie", [False, True], ids=["own laws", "tied"])
def test_readings_of_single_modes_are_sums_over_the_joints_of_a_law(tie):
    model = lapped_beams().reduced()
    laws = ("bouc_wen@bolt_1=bolt_2",) if tie else ("bouc_wen@bolt_1", "bouc_wen@bolt_2")
    joints = SeveralJoints(model, laws)
    S = np.array([2.0, 2.0 if tie else 5.0])
    readings = np.abs(model.H[:, :3].T) ** 3 @ S
    found = starts_of(joints, model.frequencies_hz[:3], readings, 0.01 * readings)
    np.testing.assert_allclose(found.estimate, S[: len(laws)], rtol=1e-9)
    assert found.degrees_of_freedom == 3 - len(laws)
    assert found.explains
    # One mode that reads ten standard errors more is explained by no sum of both.
    off = starts_of(joints, model.frequencies_hz[:3], readings * [1.0, 1.0, 1.1], 0.01 * readings)
    assert not off.explains
