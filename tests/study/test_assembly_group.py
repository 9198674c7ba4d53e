"""What a run keeps of an assembled structure: where its joints act, and what is drawn of it."""

import numpy as np
import pytest
import two_bolts
import xarray as xr

from jbw.assembly.dofs import Dof
from jbw.rig.assemblies import plate_chain, portal_frame
from jbw.study.assembly_group import assembly_group, assembly_of


def test_joints_come_back_with_their_degrees_of_freedom():
    group = assembly_group(two_bolts.reduced())
    found = assembly_of(xr.DataTree.from_dict({"/assembly": group}))
    first, second = found.joints
    assert (first.name, second.name) == two_bolts.LABELS
    assert first.terms == ((Dof("3", "ry"), 0.0025), (Dof("101", "ry"), 0.0025))
    assert (first.stiffness, found.units, found.holds_joints) == (1.5e7, "SI", False)
    assert found.highest_node == 105
    assert group["motion_unit"].values.tolist() == ["m", "m"]
    links = assembly_group(portal_frame().reduced())
    assert links["motion_unit"].values.tolist() == ["rad", "rad"]
    assert links["force_unit"].values.tolist() == ["N m", "N m"]


def test_nodes_have_their_links_and_the_shape_of_every_mode():
    model = two_bolts.reduced()
    group = assembly_group(model, model.frequencies_hz.tolist())
    nodes = group["node"].values.tolist()
    assert nodes == ["0", "1", "2", "3", "4", "101", "102", "103", "104", "105"]
    assert [nodes[i] for i in np.flatnonzero(group["held"].values)] == ["0"]
    links = {tuple(nodes[i] for i in pair) for pair in group["link"].values}
    beams = {("1", "2"), ("2", "3"), ("3", "4"), ("101", "102"), ("102", "103"), ("103", "104"),
             ("104", "105")}  # fmt: skip
    assert links == beams | {("3", "101"), ("4", "102")}  # and the springs at the bolts
    assert group["position"].values[nodes.index("102")] == pytest.approx([0.29, 0.0, 0.005])
    # Shapes are the model's deflections over the largest: the tip moves most in both modes.
    deflection = group["deflection"].values[:, :, 2]
    seen = model.c[0, : len(deflection)]
    np.testing.assert_allclose(np.abs(deflection[:, nodes.index("105")]), 1.0)
    np.testing.assert_array_equal(np.sign(deflection[:, -1]), np.sign(seen))
    at_node_1 = [i for i, dof in enumerate(model.matrices.dofs) if str(dof) == "1:z"]
    expected = model.shapes[at_node_1[0]] / np.abs(seen)
    np.testing.assert_allclose(deflection[:, nodes.index("1")], expected, rtol=1e-12)
    assert not group["deflection"].values[:, :, :2].any()


def test_a_node_that_only_rotates_moves_with_the_one_at_its_place():
    group = assembly_group(chain := plate_chain().reduced(), chain.frequencies_hz[:2].tolist())
    nodes = group["node"].values.tolist()
    deflection = group["deflection"].values
    np.testing.assert_array_equal(
        deflection[:, nodes.index("200")], deflection[:, nodes.index("103")]
    )
    assert deflection[:, nodes.index("200"), 2].all()
