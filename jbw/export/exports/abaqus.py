"""Abaqus/Standard: a user element with two nodes in C, with the laws' exact steps, and its card."""

from dataclasses import replace
from pathlib import Path

from jbw.errors import ConfigError
from jbw.export.exports.program import (
    Form,
    OfJoints,
    Paths,
    Program,
    forms_of,
    nodes_of,
    parameters_of,
    require_nodes,
    without_form,
    write_template,
    write_text,
)
from jbw.export.one_joint import Export
from jbw.export.several_joints import JointsExport


def _facts(result: Export) -> dict[str, int | tuple[Form, ...]]:
    forms = forms_of("c/laws", result)
    return {"forms": forms, "memory": sum(form.memory for form in forms)}


def _code(folder: Path, result: Export) -> Paths:
    return (write_text(folder / "joint_uel.c", "abaqus/joint_uel.c", result, **_facts(result)),)


def _card(folder: Path, result: Export) -> Paths:
    """Write the properties of the user element, for inclusion in an Abaqus input file."""
    return (write_text(folder / "joint.inp", "abaqus/joint.inp", result, **_facts(result)),)


def _joints_code(folder: Path, result: JointsExport) -> Paths:
    """Write the source code of the user element; it is the same for all joints."""
    joint = replace(result.cards[0].joint, about=result.about)
    facts = _facts(joint)
    return (write_text(folder / "joint_uel.c", "abaqus/joint_uel.c", joint, **facts),)


def _joints_card(folder: Path, result: JointsExport) -> Paths:
    """Write the nodes, equations, elements and properties of all joints."""
    joints = nodes_of(result)
    first = joints[0].card.joint
    forms = forms_of("c/laws", first)
    facts = {
        "about": result.about,
        "joints": joints,
        "laws": first.laws,
        "memory": sum(form.memory for form in forms),
        "parameters": [parameters_of(joint.card.joint) for joint in joints],
    }
    return (write_template(folder / "joints.inp", "abaqus/joints.inp", **facts),)


def _require_one_element(result: JointsExport) -> None:
    """Raise an error if joints have different laws: Abaqus takes one user subroutine per run."""
    require_nodes(result)
    first = result.cards[0]
    for card in result.cards:
        if card.joint.laws != first.joint.laws:
            raise ConfigError(
                f"Abaqus must be given joints with the same laws, but `{first.name}` has "
                f"{', '.join(first.joint.laws)} and `{card.name}` {', '.join(card.joint.laws)}.",
                why="A job has one user subroutine, which is written for one set of laws.",
                remedy="Choose another program: --to opensees,nastran,fmi3.",
            )


ABAQUS = Program(
    "abaqus",
    "Abaqus",
    _card,
    _code,
    without_form("c/laws"),
    OfJoints(_joints_card, _joints_code, _require_one_element),
)
