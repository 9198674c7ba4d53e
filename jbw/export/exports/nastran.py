"""Nastran: CBUSH1D with tables of the joint's force and of its equivalent damping."""

from pathlib import Path

from jbw.export.exports.program import (
    OfJoints,
    Paths,
    Program,
    mirrored,
    no_code,
    nodes_of,
    require_nodes,
    write_template,
    write_text,
)
from jbw.export.one_joint import Export
from jbw.export.several_joints import JointsExport
from jbw.report.messages import study as messages

FORCE, DAMPING = 1, 2  # numbers of the tables of force and damping if there is a single joint


def _card(folder: Path, result: Export) -> Paths:
    """Write the element, its property and the tables of force and damping."""
    tables = _tables(result, FORCE, DAMPING)
    facts = {"tables": tables, "linear": _linear(result), "force": FORCE, "damping": DAMPING}
    return (write_text(folder / "joint.bdf", "nastran/joint.bdf", result, **facts),)


def _joints_card(folder: Path, result: JointsExport) -> Paths:
    """Write grid points, constraint equations, elements, properties and tables of all joints."""
    joints = []
    for nodes in nodes_of(result):
        joint, card = nodes.card.joint, nodes.card
        force, damping = 10 * nodes.node + FORCE, 10 * nodes.node + DAMPING
        joints.append({
            "nodes": nodes, "linear": _linear(joint), "force": force, "damping": damping,
            "tables": _tables(joint, force, damping),
            "note": messages.joint_dashpot(card.name, card.hz, joint.y_max, card.units.names[1]),
        })  # fmt: skip
    path = folder / "joints.bdf"
    facts = {"about": result.about, "joints": joints, "ground": nodes.ground}
    return (write_template(path, "nastran/joints.bdf", field=_field, **facts),)


def _tables(result: Export, force: int, damping: int) -> list[tuple[int, list[str]]]:
    """Return the tables of force and equivalent dashpot over displacement, each with its number."""
    return [
        (number, [_field(x) for x in mirrored(result.skeleton, column, odd=odd)])
        for number, column, odd in (
            (force, "tip_force_n", True),
            (damping, "damping_ns_m", False),
        )
    ]


def _linear(result: Export) -> tuple[str, str]:
    """Return the initial stiffness, and a dashpot of equal loss at the largest displacement."""
    table = result.skeleton
    return _field(table["stiffness_n_m"][0]), _field(table["damping_ns_m"][-1])


def _field(value: float) -> str:
    """Return a number as a Nastran field of sixteen characters."""
    return f"{value:<16.9e}"


NASTRAN = Program(
    "nastran", "Nastran", _card, joints=OfJoints(_joints_card, no_code, require_nodes)
)
