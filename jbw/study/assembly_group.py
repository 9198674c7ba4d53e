"""The degrees of freedom on which joints act in an assembled structure, as stored in a result."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
import xarray as xr
from jaxtyping import Float

from jbw.assembly.dofs import TRANSLATIONS, Dof, terms_of
from jbw.assembly.joint_units import Terms, joint_units, rotates
from jbw.assembly.reduce import ReducedModel
from jbw.errors import DataError
from jbw.quantities import label
from jbw.report.messages import study as messages
from jbw.results.attributes import StoredAssembly

GROUP = "assembly"
SI = "SI"
# Nodes closer than this fraction of the structure's largest dimension have the same position.
SAME_PLACE = 1e-9
# largest number of links per node that are drawn; a matrix with more does not come from a mesh
MOST_LINKS = 12


class ModelJoint(NamedTuple):
    """One joint of an assembled structure: its degrees of freedom and stiffness, in SI units.

    Attributes:
        name: Name of the joint, as in its parameters, such as `bolt_1`.
        terms: Degrees of freedom and their factors, whose sum is the motion of the joint [-, or
            m/rad].
        stiffness: Stiffness of the fully stuck joint [N/m, or N m/rad].
    """

    name: str
    terms: Terms
    stiffness: float


class ModelJoints(NamedTuple):
    """All joints of an assembled structure, with facts about its matrices that an export needs.

    Attributes:
        joints: The joints.
        units: System of units of the structure's matrices.
        holds_joints: Whether the stiffness matrix K contains the fully stuck joints.
        highest_node: Largest node number; 0 where no node has a number.
    """

    joints: tuple[ModelJoint, ...]
    units: str
    holds_joints: bool
    highest_node: int


def assembly_group(model: ReducedModel, modes_hz: Sequence[float] = ()) -> xr.Dataset:
    """Return a result group with the degrees of freedom and stiffness of each joint of a model.

    Where positions of nodes are known, also return the positions, the pairs of nodes that the
    stiffness couples, and the motion of the nodes in the modes at some frequencies [Hz], with a
    largest value of 1.
    """
    terms = [terms_of(joint.weights, f"Joint `{joint.name}`") for joint in model.joints]
    dofs = list(dict.fromkeys(str(dof) for of_joint in terms for dof, _ in of_joint))
    weights = np.zeros((len(terms), len(dofs)))
    for row, of_joint in zip(weights, terms, strict=True):
        for dof, weight in of_joint:
            row[dofs.index(str(dof))] += weight
    nodes = {dof.node for dof in model.matrices.dofs}
    highest = max((int(node) for node in nodes if node.isdecimal()), default=0)
    units = [joint_units(SI, rotates=rotates(of_joint)) for of_joint in terms]
    stiffness = {"units": "N/m", "long_name": "stiffness in full stick"}
    weight = {"units": "1", "long_name": messages.WEIGHT_OF_DOF}
    return xr.Dataset(
        {
            "weight": (("joint", "dof"), weights, weight),
            "stiffness": ("joint", model.stiffness, stiffness),
            "motion_unit": ("joint", [of_joint.unit("m") for of_joint in units]),
            "force_unit": ("joint", [of_joint.unit("N") for of_joint in units]),
            **_geometry(model, modes_hz),
        },
        {"joint": [label(joint.name) for joint in model.joints], "dof": dofs},
        {
            "units": model.matrices.units,
            "holds_joints": int(model.holds_joints),
            "highest_node": highest,
        },
    )


def _geometry(model: ReducedModel, modes_hz: Sequence[float]) -> dict[str, Any]:
    """Return nodes, links and mode shapes of a structure for drawings; empty without positions."""
    positions = model.matrices.positions
    if not positions:
        return {}
    nodes = {node: i for i, node in enumerate(positions)}
    rows = np.array([nodes.get(dof.node, -1) for dof in model.matrices.dofs])
    coupled = sp.coo_array(model.matrices.stiffness)
    ends = np.sort(np.column_stack((rows[coupled.row], rows[coupled.col])), axis=1)
    links = np.unique(ends[(ends[:, 0] >= 0) & (ends[:, 0] < ends[:, 1])], axis=0)
    # A superelement couples each of its nodes with all other nodes; such links are not drawn.
    if len(links) > MOST_LINKS * len(nodes):
        links = links[:0]
    moved = np.zeros((len(modes_hz), len(nodes), len(TRANSLATIONS)))
    for i, hz in enumerate(modes_hz):
        shape = model.shapes[:, int(np.argmin(np.abs(model.frequencies_hz - hz)))]
        for row, dof, of_dof in zip(rows, model.matrices.dofs, shape, strict=True):
            if row >= 0 and dof.direction in TRANSLATIONS:
                moved[i, row, TRANSLATIONS.index(dof.direction)] = of_dof
    moved = _with_coincident(moved, np.array(list(positions.values())))
    largest = np.abs(moved).max(axis=(1, 2), keepdims=True)
    return {
        "node": ("node", list(nodes)),
        "position": (("node", "axis"), np.array(list(positions.values())), {"units": "m"}),
        "held": ("node", ~np.isin(np.arange(len(nodes)), rows)),
        "link": (("link", "end"), links),
        "deflection": (("mode", "node", "axis"), moved / np.where(largest > 0, largest, 1.0)),
    }


def _with_coincident(
    moved: Float[np.ndarray, "mode node 3"], position: Float[np.ndarray, "node 3"]
) -> Float[np.ndarray, "mode node 3"]:
    is_still, near = np.all(moved == 0, axis=(0, 2)), SAME_PLACE * np.ptp(position, axis=0).max()
    filled = moved.copy()
    for node in np.flatnonzero(is_still):
        is_there = np.abs(position - position[node]).max(axis=1) <= near
        there = np.flatnonzero(is_there & ~is_still)
        if there.size:
            filled[:, node] = moved[:, there[0]]
    return filled


def assembly_of(tree: xr.DataTree) -> ModelJoints:
    """Return the joints stored in a run's result, with the degrees of freedom on which they act.

    Raises:
        DataError: A version of jbw that did not store the joints made the run.
    """
    if GROUP not in tree.children:
        raise DataError(
            "A run of several joints must contain their degrees of freedom, group /assembly, "
            "but this run does not.",
            remedy="Identify the campaign again with this version of jbw.",
        )
    group = tree[GROUP].to_dataset()
    joints = []
    for name in group["joint"].values:
        of_joint = group.sel(joint=name)
        pairs = zip(of_joint["dof"].values, of_joint["weight"].values, strict=True)
        terms = tuple((_dof(str(dof)), float(weight)) for dof, weight in pairs if weight)
        joints.append(ModelJoint(str(name), terms, float(of_joint["stiffness"])))
    facts = StoredAssembly.of(group)
    return ModelJoints(tuple(joints), facts.units, facts.holds_joints, facts.highest_node)


def _dof(name: str) -> Dof:
    node, _, direction = name.rpartition(":")
    return Dof(node, direction)
