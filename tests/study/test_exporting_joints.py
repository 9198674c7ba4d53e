"""Several joints as `jbw export` writes them, read back, moved and set into the whole matrices."""

import ctypes
import json
import re
import subprocess
import zipfile
from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
import two_bolts
import xarray as xr
from exported import rows
from full_model import joints_read, moved
from joints_tree import PEAK, tree_of
from scipy.integrate import quad, solve_ivp
from scipy.io import loadmat
from test_exports_elsewhere import Slave, needs_compiler

import jbw
from jbw.assembly.dofs import Dof
from jbw.assembly.joint_units import joint_units, terms_in
from jbw.assembly.matrices import matrix_model
from jbw.assembly.units import SYSTEMS, in_si
from jbw.cli import run
from jbw.errors import ConfigError, DataError
from jbw.export.exports.fmu import compiler
from jbw.export.files import chosen_programs_of_joints, export_of_run
from jbw.export.one_joint import export
from jbw.export.several_joints import _losing_at, _plain, export_joints
from jbw.oscillator.laws.bouc_wen import BoucWenLaw
from jbw.oscillator.laws.iwan import MasingPower
from jbw.rig.assemblies import lapped_beams, portal_frame
from jbw.study.assembly_group import ModelJoint

K = 1.5e7  # of both bolts in full stick [N/m]
TIED = ("bouc_wen@bolt_1=bolt_2",)


def written(folder, tree, *names, **options):
    """The folder that an export of the tree's joints is written to."""
    export_of_run(tree, {}, names, **options).write(folder)
    return folder


def force_along(bolt, path):
    """Force of a bolt's law along a path, by its differential equation [N]."""
    alpha, delta, gamma = bolt
    z, found, last = 0.0, [], 0.0
    for x in path:
        dx = x - last
        rate = lambda s, z, dx=dx: (  # noqa: E731
            alpha * dx - gamma * abs(dx) * z - delta * dx * abs(z)
        )
        z = solve_ivp(rate, (0, 1), [z], rtol=1e-10, atol=1e-10).y[0, -1]
        found.append(z)
        last = x
    return np.array(found)


def area_of_loop(bolt, x, z_max):
    """What a cycle loses, from Z' = alpha - c Z on the way down, c = -gamma + delta sgn(Z) [J]."""
    alpha, delta, gamma = bolt
    down = solve_ivp(
        lambda y, z: alpha - (-gamma + delta * np.sign(z)) * z,
        (x, -x), [z_max], rtol=1e-10, atol=1e-8, dense_output=True,
    )  # fmt: skip
    return 2 * abs(quad(lambda y: down.sol(y)[0], -x, x, limit=200)[0])


PATH = PEAK * np.array([0.3, 1.0, 0.2, -0.7, -0.5, -1.0, 0.4, 1.0])


# -- in the units of the matrices ------------------------------------------------------------------
def test_opensees_has_the_joints_at_their_degrees_of_freedom(tmp_path):
    text = (written(tmp_path, tree_of(), "opensees") / "joints.tcl").read_text()
    for joint, bolt, nodes in zip(
        joints_read(text), two_bolts.BOLTS, (("3", "101"), ("4", "102")), strict=True
    ):
        alpha, delta, gamma = bolt
        assert joint.weights == {f"{node}:ry": 0.0025 for node in nodes}
        assert joint.spring == pytest.approx(K - alpha, rel=1e-14)
        # a, k0, n, gamma, beta, A: jbw's delta and gamma are called gamma and beta there.
        assert joint.material == pytest.approx((0.0, alpha, 1.0, delta, gamma, 1.0), rel=1e-14)
    assert "# Mode 2 with fully stuck joints: 90.469 Hz (the matrices predict 90.469 Hz)" in text
    assert "damping ratio 0.4 %" in text


def in_millimetres(model):
    """Matrices of a model in newtons, millimetres and tonnes."""
    system = SYSTEMS["N-mm-t-s"]
    scale = sp.diags_array([1e-3 if d.direction in "xyz" else 1.0 for d in model.dofs])
    mass, stiffness = (
        scale @ matrix @ scale / system.energy for matrix in (model.mass, model.stiffness)
    )
    return matrix_model(mass, stiffness, units="N-mm-t-s", dofs=model.dofs)


def test_joints_are_in_the_units_of_the_matrices(tmp_path):
    rig = lapped_beams()
    rig = replace(rig, model=in_millimetres(rig.model))
    model = rig.reduced(to_hz=two_bolts.TO_HZ, zeta=two_bolts.ZETA)
    folder = written(tmp_path, tree_of(model), "opensees", "abaqus")
    joints = joints_read((folder / "joints.tcl").read_text())
    for joint, (alpha, delta, gamma) in zip(joints, two_bolts.BOLTS, strict=True):
        # 1 N/m is 1e-3 N/mm, 1/m is 1e-3/mm, and a lever of 2.5 mm per radian.
        assert set(joint.weights.values()) == {2.5}
        assert joint.spring == pytest.approx(1e-3 * (K - alpha), rel=1e-14)
        expected = (0.0, 1e-3 * alpha, 1.0, 1e-3 * delta, 1e-3 * gamma, 1.0)
        assert joint.material == pytest.approx(expected, rel=1e-14)
    # The stiffness that the joints add to the matrices is that in SI, in full stick.
    dofs = rig.model.dofs
    across = np.array([[j.weights.get(str(dof), 0.0) for dof in dofs] for j in joints]).T
    stuck = [j.spring + j.material[1] for j in joints]
    added = in_si(sp.csc_array((across * stuck) @ across.T), dofs, SYSTEMS["N-mm-t-s"], 0)
    metres = np.array([[dict(j.weights).get(str(dof), 0.0) for dof in dofs] for j in rig.joints]).T
    np.testing.assert_allclose(added.toarray(), K * metres @ metres.T, rtol=1e-13)
    assert "alpha [N/mm], delta [1/mm]" in (folder / "joints.inp").read_text()
    table = {
        (r["joint"], r["convention"], r["parameter"]): r for r in rows(folder / "parameters.csv")
    }
    assert table["bolt_1", "SI", "alpha"]["unit"] == "N/m"
    in_units = table["bolt_1", "N-mm-t-s", "alpha"]
    assert (float(in_units["value"]), in_units["unit"]) == (pytest.approx(6e3), "N/mm")


LINKS = {"alpha@left_link": 150.0, "delta@left_link": 300.0, "gamma@left_link": 40.0,
         "power_loss@right_link": 20.0, "power_exponent@right_link": 0.4}  # fmt: skip


def frame(units="SI"):
    """Two links that rotate, of different laws, and what a run would hold of them."""
    rig = portal_frame()
    model = rig.model if units == "SI" else in_millimetres(rig.model)
    reduced = replace(rig, model=model).reduced(to_hz=200.0, zeta=0.004)
    theta = {"omega_n": float(reduced.omega[0]), "zeta": 0.004, **LINKS}
    laws = ("bouc_wen@left_link", "masing_power@right_link")
    return tree_of(reduced, laws, theta, peak=2e-3)


def test_a_rotation_has_moments_and_a_loss_at_a_millimetre_keeps_its_amplitude(tmp_path):
    joints = export_joints(frame("N-mm-t-s"), draw=0)
    left, right = (card.joint for card in joints.cards)
    units = {q.name: q.unit for card in joints.cards for q in card.joint.quantities}
    assert (units["alpha"], units["delta"]) == ("N mm/rad", "1/rad")
    # 1 N m is 1e3 N mm, and radians stay.
    assert left.joint["alpha"] == pytest.approx(1.5e5, rel=1e-13)
    assert left.joint["delta"] == pytest.approx(300.0, rel=1e-13)
    assert left.linear["spring"] == pytest.approx(1e3 * (400.0 - 150.0), rel=1e-13)
    assert right.joint["power_loss"] == pytest.approx(2e4, rel=1e-13)
    assert left.y_max == pytest.approx(2e-3, rel=1e-3)
    assert [weight for _, weight in joints.cards[0].terms] == [-1.0, 1.0]


def test_a_loss_stated_at_a_millimetre_is_the_same_in_millimetres():
    """F = kappa (|x| / 1e-3)^q x, whose number 1e-3 is the same in metres and in millimetres."""
    kappa, q, x = 20.0, 0.4, 3e-6
    in_units = float(joint_units("N-mm-t-s", rotates=False).value(kappa, "N/m", -q))
    force = kappa * (x / 1e-3) ** q * x
    assert in_units * (1e3 * x / 1e-3) ** q * 1e3 * x == pytest.approx(force, rel=1e-13)


def test_a_law_whose_loss_is_stated_at_a_millimetre_loses_as_much_in_millimetres():
    """N/mm at 2 mm are a thousandth of N/m at 2 mm, whatever the power of the amplitude."""
    draws = {"power_loss@left": np.array([20.0]), "power_exponent@left": np.array([0.4])}
    place = ModelJoint("left", (), 1e6)
    losses = []
    for system, peak in (("SI", 2e-3), ("N-mm-t-s", 2.0)):
        units = joint_units(system, rotates=False)
        values, _ = _plain(draws, place, ("masing_power@left",), units)
        law = MasingPower(values["power_loss"][0], values["power_exponent"][0])
        losses.append(float(law.loop(peak).damping))
    assert losses[1] == pytest.approx(1e-3 * losses[0], rel=1e-12)


def test_a_dashpot_loses_at_its_frequency_what_it_lost_at_its_own():
    """5 Hz in milliseconds are 0.01 pi rad/ms; of a stiffness of 4 its own frequency is 2."""
    table = {"stiffness_n_m": np.array([4.0]), "damping_ns_m": np.array([3.0])}
    assert _losing_at(table, 5.0, 1e-3)["damping_ns_m"] == pytest.approx(3.0 * 2.0 / (0.01 * np.pi))


def test_levers_of_rotations_are_millimetres_in_a_model_of_millimetres():
    terms = (Dof("1", "z"), 1.0), (Dof("2", "ry"), 2.5e-3)  # m/rad
    moved = terms_in(joint_units("N-mm-t-s", rotates=False), terms)
    assert [weight for _, weight in moved] == pytest.approx([1.0, 2.5], rel=1e-14)
    turned = terms_in(joint_units("N-mm-t-s", rotates=True), ((Dof("1", "z"), 40.0),))  # rad/m
    assert turned[0][1] == pytest.approx(0.04, rel=1e-14)


# -- other programs --------------------------------------------------------------------------------
def field_rows(text, word):
    """Large fields of the entries of a name: lists of what stands in sixteen columns."""
    lines = text.splitlines()
    for i, line in enumerate(lines):
        if line.startswith(f"{word}*"):
            entry = [line]
            for follower in lines[i + 1 :]:
                if not follower.startswith("*"):
                    break
                entry.append(follower)
            yield [one[j : j + 16].strip() for one in entry for j in range(8, max(72, len(one)), 16)
                   if j < 72]  # fmt: skip


def test_nastran_has_constraints_tables_and_a_dashpot_of_the_loss(tmp_path):
    text = (written(tmp_path, tree_of(), "nastran") / "joints.bdf").read_text()
    equations = [[word for word in row if word] for row in field_rows(text, "MPC")]
    for equation, node, members in zip(
        equations, ("1001", "1002"), (("3", "101"), ("4", "102")), strict=True
    ):
        assert equation[:3] == ["1000", node, "1"]
        assert float(equation[3]) == -1.0
        for i, member in enumerate(members):
            at = equation[4 + 3 * i : 7 + 3 * i]
            assert (at[:2], float(at[2])) == ([member, "5"], 0.0025)
    tables = {row[0]: row for row in field_rows(text, "TABLED1")}
    properties = list(field_rows(text, "PBUSH1D"))
    hz = two_bolts.reduced().frequencies_hz[0]
    for (alpha, delta, gamma), row, number in zip(
        two_bolts.BOLTS, properties, ("10011", "10021"), strict=True
    ):
        words = [w for w in tables[number][4:] if w and w != "ENDT"]
        x, force = np.reshape(np.array(words, float), (-1, 2))[-1]
        turns = x * np.array([1.0, *(-1.0, 1.0) * 30])
        z_max = force_along((alpha, delta, gamma), turns)[-1]
        assert force == pytest.approx((K - alpha) * x + z_max, rel=1e-8)
        # Over the frequency of mode 1, which moves the bolts most.
        lost = area_of_loop((alpha, delta, gamma), x, z_max)
        dashpot = float(row[2])
        assert dashpot == pytest.approx(lost / (np.pi * 2 * np.pi * hz * x**2), rel=1e-5)


def call_uel(library, props, y, state):
    """Force of the user element after an increment, and the state that it leaves."""
    doubles = ctypes.c_double * 8
    rhs, matrix, u = doubles(), doubles(), doubles(0.0, y)
    none, zero, two = doubles(), ctypes.c_int(0), ctypes.c_int(2)
    flags = (ctypes.c_int * 5)(1, 0, 1, 0, 0)
    one, dtime = ctypes.c_int(1), ctypes.c_double(0.0)
    num = ctypes.c_int(len(props))
    by = ctypes.byref
    library.uel_(
        rhs, matrix, state, none, by(two), by(one), by(num), props, by(num), none, by(two),
        by(two), u, none, none, none, by(one), none, by(dtime), by(one), by(one), by(one), none,
        by(zero), by(zero), none, none, by(zero), flags, by(two), none, by(one), none, by(zero),
        by(zero), none,
    )  # fmt: skip
    return rhs[0], -rhs[1]


@needs_compiler
def test_the_user_element_moves_every_joint_by_its_own_properties(tmp_path):
    folder = written(tmp_path, tree_of(), "abaqus")
    lines = (folder / "joints.inp").read_text().splitlines()
    subprocess.run(
        [*compiler(), "-std=c99", "-O2", "-fPIC", "-shared", "joint_uel.c", "-o", "uel.so", "-lm"],
        cwd=folder, check=True, timeout=120,
    )  # fmt: skip
    library = ctypes.CDLL(str(folder / "uel.so"))
    assert [line for line in lines if line.startswith("1001, 1,")] == ["1001, 1, 1.0"]
    equation = lines.index("1002, 1, 1.0")
    assert lines[equation + 1 : equation + 3] == ["4, 5, -0.0025", "102, 5, -0.0025"]
    for i, bolt in enumerate(two_bolts.BOLTS, start=1):
        at = lines.index(f"*UEL PROPERTY, ELSET=JOINT_{i}")
        values = [float(word) for word in lines[at + 1].split(", ")]
        props, state = (ctypes.c_double * 6)(*values), (ctypes.c_double * 8)()
        found = [call_uel(library, props, y, state) for y in PATH]
        expected = (K - bolt[0]) * PATH + force_along(bolt, PATH)
        # Of the integration; the force pulls both nodes alike.
        np.testing.assert_allclose([f for f, _ in found], expected, rtol=1e-7)
        np.testing.assert_array_equal([f for f, _ in found], [f for _, f in found])


@needs_compiler
def test_each_joint_has_an_fmu_of_its_own_in_si(tmp_path):
    folder = written(tmp_path, tree_of(), "fmi3", count=2)
    for name, bolt in zip(two_bolts.LABELS, two_bolts.BOLTS, strict=True):
        slave = Slave(folder / name / "joint_fmi3.fmu", folder / f"unpacked {name}")
        try:
            found = [slave.step(x) for x in PATH]
        finally:
            slave.fmu.freeInstance()
        np.testing.assert_allclose(found, force_along(bolt, PATH), rtol=1e-7)  # of the integration
        assert (folder / "draws" / "0002" / name / "joint.ssv").is_file()
        with zipfile.ZipFile(folder / name / "joint_fmi3.fmu") as fmu:
            assert 'unit="N/m"' in fmu.read("modelDescription.xml").decode()


def test_an_fmu_of_a_rotation_says_its_units(tmp_path):
    folder = written(tmp_path, frame("N-mm-t-s"), "fmi2")
    with zipfile.ZipFile(folder / "left_link" / "joint_fmi2.fmu") as fmu:
        description = fmu.read("modelDescription.xml").decode()
        about = fmu.read("documentation/index.html").decode()
    units = dict(re.findall(r'name="(\w+)"[^>]*?>\s*<Real[^>]*?unit="([^"]+)"', description))
    expected = {"displacement": "rad", "velocity": "rad/s", "force": "N m", "alpha": "N m/rad"}
    assert {name: units[name] for name in expected} == expected
    assert "This is left_link in SI: its motion in rad, its force in N m." in about


# -- draws and tables ------------------------------------------------------------------------------
def test_draws_have_cards_and_a_manifest_of_every_joint(tmp_path):
    tree = tree_of(spread=0.05)
    folder = written(tmp_path, tree, "opensees", "abaqus", "nastran", count=4)
    manifest = json.loads((folder / "manifest.json").read_text())
    assert [row["files"] for row in manifest["draws"]] == [
        ["joints.bdf", "joints.inp", "joints.tcl"]
    ] * 4
    assert not (folder / "draws" / "0001" / "joint_uel.c").exists()  # the same for all
    for row in manifest["draws"]:
        text = (folder / row["folder"] / "joints.tcl").read_text()
        for name, joint in zip(two_bolts.LABELS, joints_read(text), strict=True):
            alpha = tree["posterior"][f"alpha@{name}"].values.ravel()[row["draw"]]
            assert joint.material[1] == pytest.approx(alpha, rel=1e-14)
            assert row["joints"][name]["spring"] == pytest.approx(K - alpha, rel=1e-12)
    assert manifest["units"]["joints"]["bolt_2"]["gamma"] == "1/m"


def test_tables_have_every_joint_and_matlab_can_name_them(tmp_path):
    tree = tree_of(spread=0.05)
    folder = written(tmp_path, tree)
    for row in rows(folder / "parameters.csv"):
        if row["joint"]:
            values = tree["posterior"][f"{row['parameter']}@{row['joint']}"].values
            assert float(row["value"]) in values
            quantiles = [float(row[mark]) for mark in ("q005", "q500", "q995")]
            np.testing.assert_allclose(
                quantiles, np.quantile(values, [0.005, 0.5, 0.995]), rtol=1e-12
            )
    stored = loadmat(folder / "jbw.mat", squeeze_me=True)
    assert stored["draws"]["alpha_at_bolt_1"].item().shape == (40,)
    # The steady loop of the second bolt at its largest motion closes on the tips.
    loop = [r for r in rows(folder / "loop.csv") if r["joint"] == "bolt_2"]
    peaks = np.array([float(r["motion_peak"]) for r in loop])
    assert peaks.max() == pytest.approx(PEAK, rel=1e-12)
    curve = rows(folder / "backbone.csv")
    assert "force_n" not in curve[0]
    assert float(curve[0]["frequency_hz"]) == pytest.approx(
        two_bolts.reduced().frequencies_hz[0], rel=5e-2
    )


def test_joints_of_uncertain_shapes_reach_as_far_as_each_draw_moves_them(tmp_path):
    """Mode 1 moves the second bolt by PEAK, and so does mode 2 by the matrices."""
    factor = {"motion_factor_2@bolt_2": 1.25}
    tree = tree_of(theta=two_bolts.truth() | factor)
    result = export_joints(tree)
    first, second = result.cards
    # Mode 1 moves the first bolt by 0.99 of what it moves the second.
    H = two_bolts.reduced().H
    assert first.in_si.y_max == pytest.approx(PEAK * abs(H[0, 0] / H[1, 0]), rel=1e-12)
    assert second.in_si.y_max == pytest.approx(1.25 * PEAK, rel=1e-12)
    assert (
        "Motion of bolt_2 in mode 2 relative to the structural model is 1.25. "
        "A model with these matrices does not include this factor."
    ) in result.about
    (row,) = [row for row in result.parameters if row["parameter"] in factor]
    assert (row["value"], row["unit"]) == (1.25, "1")


@pytest.mark.slow  # compiles the backbones of two more sets of laws
def test_joints_of_a_tie_share_their_law_and_no_law_is_said(tmp_path):
    theta = {n: x for n, x in two_bolts.truth().items() if "bolt_2" not in n}
    text = (written(tmp_path, tree_of(laws=TIED, theta=theta)) / "joints.tcl").read_text()
    first, second = joints_read(text)
    assert first.material == second.material
    (tmp_path / "one").mkdir()
    alone = tree_of(laws=("bouc_wen@bolt_1",), theta=theta)
    text = (written(tmp_path / "one", alone) / "joints.tcl").read_text()
    assert len(joints_read(text)) == 1
    assert "bolt_2 moves by" in text
    assert (
        "stuck joint is 1.5e+07 N/m. The model does not contain the stiffness of joint bolt_2: add "
        "a spring." in text
    )


def test_where_the_matrices_hold_the_joints_the_spring_is_to_be_replaced(tmp_path):
    rig = lapped_beams()
    weights = np.array(
        [[dict(j.weights).get(str(dof), 0.0) for dof in rig.model.dofs] for j in rig.joints]
    ).T
    stuck = rig.model.stiffness.toarray() + K * weights @ weights.T
    model = matrix_model(rig.model.mass, stuck, units="SI", dofs=rig.model.dofs)
    held = replace(rig, model=model).reduced(
        to_hz=two_bolts.TO_HZ, zeta=two_bolts.ZETA, holds_joints=True
    )
    text = (written(tmp_path, tree_of(held)) / "joints.tcl").read_text()
    replaced = "The model contains the stiffness of joint bolt_1 as a spring, which the exported"
    assert f"1.5e+07 N/m. {replaced}" in text
    # The joint is the same, whole.
    assert joints_read(text)[0].spring == pytest.approx(K - two_bolts.BOLTS[0][0], rel=1e-14)


# -- refusals --------------------------------------------------------------------------------------
def test_what_joints_cannot_be_given_to_is_refused_with_what_can():
    joints = export_joints(frame(), draw=0)
    with pytest.raises(
        ConfigError, match="Ansys supports only one joint, but the run has 2"
    ) as caught:
        chosen_programs_of_joints(["ansys"], joints)
    assert "--to opensees,fmi2,fmi3,abaqus,nastran" in caught.value.remedy
    with pytest.raises(ConfigError, match=r"is at `104\.beam:ry`") as caught:
        chosen_programs_of_joints(["nastran"], joints)
    assert "--to fmi3" in caught.value.remedy
    assert chosen_programs_of_joints([], joints) == ()
    assert [p.name for p in chosen_programs_of_joints(["fmi3"], joints)] == ["fmi3"]


def test_abaqus_takes_joints_of_one_set_of_laws():
    laws = ("bouc_wen@bolt_1", "cubic@bolt_2")
    theta = {n: x for n, x in two_bolts.truth().items() if "bolt_2" not in n}
    joints = export_joints(tree_of(laws=laws, theta=theta | {"cubic@bolt_2": 1e15}), draw=0)
    with pytest.raises(ConfigError, match="`bolt_1` has bouc_wen and `bolt_2` cubic") as caught:
        chosen_programs_of_joints(["abaqus"], joints)
    assert "--to opensees,nastran,fmi3" in caught.value.remedy
    assert chosen_programs_of_joints(["nastran", "fmi3"], joints)


def test_a_run_that_does_not_hold_the_degrees_of_freedom_is_refused():
    tree = tree_of()
    del tree["assembly"]
    with pytest.raises(DataError, match="must contain their degrees of freedom"):
        export_of_run(tree, {})
    with pytest.raises(DataError, match="Call `export_joints`"):
        export(tree_of())


def test_the_command_writes_joints_and_refuses_a_modal_mass(tmp_path, capsys):
    tree_of(spread=0.01).to_netcdf(tmp_path / "posterior.nc", engine="h5netcdf")
    (tmp_path / "summary.json").write_text(json.dumps({"campaign": "bolts"}))
    assert run(["export", str(tmp_path), "--mass", "2"]) != 0
    assert "`--mass` must be left out" in capsys.readouterr().err
    assert run(["export", str(tmp_path), "--to", "opensees,nastran", "--draws", "2"]) == 0
    printed = capsys.readouterr().out
    assert "joints.tcl" in printed
    assert (tmp_path / "export" / "draws" / "0002" / "joints.bdf").is_file()
    stored = xr.open_datatree(tmp_path / "posterior.nc")
    assert "assembly" in stored.children


# -- in the whole matrices -------------------------------------------------------------------------
@pytest.mark.slow
def test_exported_joints_in_the_whole_matrices_move_as_the_reduced_model(tmp_path):
    """18 degrees of freedom by Newmark's rule against 8 modes by jbw's own steps.

    The reduction to 1000 Hz costs 6e-5 of the tip and 1e-3 of the joints' motion under a sweep to
    265 Hz; Newmark's phase at 90 Hz over a second is off by 4e-4 of a radian.
    """
    text = (written(tmp_path, tree_of(), "opensees") / "joints.tcl").read_text()
    rig, fs = lapped_beams(), two_bolts.FS
    u = two_bolts.sweep((25.0, 40.0), 1.5) + two_bolts.sweep((70.0, 105.0), 2.5)
    velocity, motion = moved(rig, joints_read(text), u, fs, zeta=two_bolts.ZETA, factor=256)
    laws = [BoucWenLaw(*bolt) for bolt in two_bolts.BOLTS]
    model = rig.with_laws(*laws).reduced(zeta=two_bolts.ZETA)
    reduced = jbw.simulate(model.structure(), u, fs, hold="band_limited", substeps=256)
    assert np.std(reduced.v - velocity) < 1e-3 * np.std(velocity)
    for x, whole in zip(np.asarray(reduced.x), motion.T, strict=True):
        assert np.std(x - whole) < 1e-3 * np.std(whole)
    # The joints matter: in full stick the tip moves otherwise.
    stuck = two_bolts.stuck_motion(two_bolts.reduced(), u)
    assert np.std(stuck - velocity) > 0.1 * np.std(velocity)
