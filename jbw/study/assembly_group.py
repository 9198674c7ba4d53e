"""Where the joints of an assembled structure act, as a run's result keeps it."""

from typing import NamedTuple

import numpy as np
import xarray as xr

from jbw.assembly.dofs import Dof, terms_of
from jbw.assembly.joint_units import Terms
from jbw.assembly.reduce import ReducedModel
from jbw.errors import DataError
from jbw.quantities import label

GROUP = "assembly"


class Place(NamedTuple):
    """One joint at its degrees of freedom, in SI.

    Attributes:
        name: As parameters bear it, such as `bolt_1`.
        terms: Degrees of freedom and their factors, which add up to its motion [-, or m/rad].
        stiffness: In full stick [N/m, or N m/rad].
    """

    name: str
    terms: Terms
    stiffness: float


class Assembly(NamedTuple):
    """All joints, and what a file for the model's own program needs beside them.

    Attributes:
        places: The joints.
        units: System of units of the matrices.
        holds_joints: Whether K holds the joints in full stick.
        highest_node: Largest number of a node; 0 where none is a number.
    """

    places: tuple[Place, ...]
    units: str
    holds_joints: bool
    highest_node: int


def assembly_group(model: ReducedModel) -> xr.Dataset:
    """Degrees of freedom and stiffness of every joint, with the model's units."""
    terms = [terms_of(joint.weights, f"Joint `{joint.name}`") for joint in model.joints]
    dofs = list(dict.fromkeys(str(dof) for of_joint in terms for dof, _ in of_joint))
    weights = np.zeros((len(terms), len(dofs)))
    for row, of_joint in zip(weights, terms, strict=True):
        for dof, weight in of_joint:
            row[dofs.index(str(dof))] += weight
    nodes = {dof.node for dof in model.matrices.dofs}
    highest = max((int(node) for node in nodes if node.isdecimal()), default=0)
    stiffness = {"units": "N/m", "long_name": "stiffness in full stick"}
    weight = {"units": "1", "long_name": "factor of a degree of freedom in the joint's motion"}
    return xr.Dataset(
        {
            "weight": (("joint", "dof"), weights, weight),
            "stiffness": ("joint", model.stiffness, stiffness),
        },
        {"joint": [label(joint.name) for joint in model.joints], "dof": dofs},
        {
            "units": model.matrices.units,
            "holds_joints": int(model.holds_joints),
            "highest_node": highest,
        },
    )


def assembly_of(tree: xr.DataTree) -> Assembly:
    """The joints of a run's result.

    Raises:
        DataError: The run is of a version that did not keep them.
    """
    if GROUP not in tree.children:
        raise DataError(
            "A run of several joints must hold their degrees of freedom, group /assembly, but this "
            "one does not.",
            remedy="Identify the campaign again with this version of jbw.",
        )
    group = tree[GROUP].to_dataset()
    places = []
    for name in group["joint"].values:
        of_joint = group.sel(joint=name)
        pairs = zip(of_joint["dof"].values, of_joint["weight"].values, strict=True)
        terms = tuple((_dof(str(dof)), float(weight)) for dof, weight in pairs if weight)
        places.append(Place(str(name), terms, float(of_joint["stiffness"])))
    return Assembly(
        tuple(places),
        str(group.attrs["units"]),
        bool(group.attrs["holds_joints"]),
        int(group.attrs["highest_node"]),
    )


def _dof(name: str) -> Dof:
    node, _, direction = name.rpartition(":")
    return Dof(node, direction)
