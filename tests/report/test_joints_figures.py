"""The structure with its joints and the joints' loops, read off what is drawn."""

import numpy as np
import pytest
import toy_joints
import xarray as xr
from matplotlib.collections import LineCollection, PathCollection

from jbw.errors import DataError
from jbw.report.assembly import joint_loops, mode_backbones, structure, view_of


def tree_of(assembly):
    return xr.DataTree.from_dict({"/joints": toy_joints.joints(), "/assembly": assembly})


def test_every_mode_has_its_shape_and_its_joints_by_their_share():
    axes = structure(tree_of(toy_joints.assembly()))
    assert axes.shape == (1, 2)
    first, second = axes.flat
    assert first.get_title(loc="left") == "mode 1, 32 Hz\nstrain energy: bolt_2 30 %, bolt_1 20 %"
    assert "bolt_2 4.0 %, bolt_1 1.0 %" in second.get_title(loc="left")
    assert (first.get_xlabel(), first.get_ylabel()) == ("x [m]", "z [m]")
    at_rest, moved = [c for c in first.collections if isinstance(c, LineCollection)]
    np.testing.assert_allclose(at_rest.get_segments()[0], [[0.3, 0.0], [0.5, 0.0]])
    # 0.12 of 0.5 m is the largest deflection.
    np.testing.assert_allclose(moved.get_segments()[0], [[0.3, 0.024], [0.5, 0.06]])
    marks = [c for c in first.collections if isinstance(c, PathCollection)]
    np.testing.assert_allclose([mark.get_offsets()[0] for mark in marks], moved.get_segments()[0])
    small, large = (mark.get_sizes()[0] for mark in marks)
    assert large - small == pytest.approx(0.1 * (160 - 12))
    (held,) = [line for line in first.lines if line.get_marker() == "^"]
    np.testing.assert_array_equal(held.get_xydata(), [[0.0, 0.0]])


def test_without_positions_bars_have_the_share_in_the_losses():
    bare = toy_joints.assembly()[["weight", "motion_unit", "force_unit"]]
    (panel,) = structure(tree_of(bare)).flat
    heights = [[bar.get_height() for bar in bars] for bars in panel.containers if len(bars) == 2]
    np.testing.assert_allclose(heights, [[20.0, 1.0], [30.0, 4.0]])
    assert [tick.get_text() for tick in panel.get_xticklabels()] == [
        "mode 1, 32 Hz",
        "mode 2, 90 Hz",
    ]


def test_a_flat_structure_is_seen_from_the_side_and_another_one_askew():
    beam, along_z = np.array([[0.0, 0, 0], [1, 0, 0]]), np.zeros((1, 2, 3))
    along_z[0, 1, 2] = 1.0
    assert view_of(beam, along_z)[1] == ("x", "z")
    plate = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    assert view_of(plate, np.zeros((1, 3, 3)))[1] == ("x", "y")
    bent = np.zeros((1, 3, 3))
    bent[0, 2, 2] = 1.0
    x, y, z = view_of(plate, bent)[0].T
    # An isometric view: three axes of one length.
    lengths = [np.linalg.norm(axis) for axis in (x, y, z)]
    np.testing.assert_allclose(lengths, 1.0, rtol=1e-12)


def test_a_loop_stands_in_micrometres_and_below_without_its_secant():
    axes = joint_loops(tree_of(toy_joints.assembly()))
    assert axes.shape == (2, 2)
    assert axes[0, 0].get_title(loc="left") == "bolt_1, identified"
    assert axes[0, 1].get_title(loc="left") == "bolt_2, unidentified"
    assert axes[1, 0].get_xlabel() == "motion [\u00b5m]"
    loop, opened = axes[0, 1].lines[0], axes[1, 1].lines[0]
    assert np.max(loop.get_xdata()) == pytest.approx(5.0)
    assert np.max(loop.get_ydata()) == pytest.approx(np.hypot(10.0, 3.0), rel=1e-2)
    assert loop.get_xydata()[0] == pytest.approx(loop.get_xydata()[-1])  # it closes
    # Of the ellipse the slope from tip to tip is 2e6 N/m, and 3 N are left of it.
    assert np.max(opened.get_ydata()) == pytest.approx(3.0, rel=1e-12)
    texts = [text.get_text() for text in axes[0, 1].texts]
    assert texts == ["secant 2.00\u00d710\u2076 N/m"]


def test_joints_that_rotate_have_moments():
    turning = toy_joints.assembly().assign(
        motion_unit=("joint", ["rad", "rad"]), force_unit=("joint", ["N m", "N m"])
    )
    axes = joint_loops(tree_of(turning))
    assert axes[1, 0].get_xlabel() == "motion [\u00b5rad]"
    assert axes[0, 0].get_ylabel() == "force [N m]"


def test_every_mode_has_its_band_and_the_other_modes_in_its_shape():
    tree = xr.DataTree.from_dict({"/backbones": toy_joints.backbones()})
    axes = mode_backbones(tree)
    assert axes.shape == (3, 2)
    assert axes[0, 0].get_title(loc="left") == "mode 1, 32 Hz"
    assert axes[2, 1].get_xlabel() == "amplitude at the first point [\u00b5m]"
    middle, stuck = (axes[0, 0].lines[i].get_xydata() for i in range(2))
    np.testing.assert_allclose(middle, [[2.0, 32.0], [4.0, 31.0]])
    np.testing.assert_allclose(stuck[:, 1], [32.0, 31.1])
    # A run before this had bands in full stick, and beside them the free shape.
    before = toy_joints.backbones().drop_vars(["frequency_in_full_stick", "damping_in_full_stick"])
    old_axes = mode_backbones(xr.DataTree.from_dict({"/backbones": before}))
    np.testing.assert_allclose(old_axes[0, 0].lines[1].get_ydata(), [32.0, 30.9])
    np.testing.assert_allclose(axes[1, 1].lines[0].get_ydata(), [0.4, 0.8])  # per cent
    # Of two modes the other one alone: |q_2 / q_1| below mode 1.
    (other,) = axes[2, 0].lines
    np.testing.assert_allclose(other.get_ydata(), [1e-4, 2e-4])
    assert other.get_label() == "mode 2"


def test_modes_that_are_hardly_seen_have_no_column():
    backbones = toy_joints.backbones()
    backbones["displacement"][1] = np.nan
    assert mode_backbones(xr.DataTree.from_dict({"/backbones": backbones})).shape == (3, 1)
    backbones["displacement"][:] = np.nan
    with pytest.raises(DataError, match="hardly moves in the modes"):
        mode_backbones(xr.DataTree.from_dict({"/backbones": backbones}))
