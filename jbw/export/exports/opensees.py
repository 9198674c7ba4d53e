"""OpenSees: the joint as uniaxial materials in parallel, for the spring and for every law."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from jbw.export.exports.program import (
    OfJoints,
    Paths,
    Program,
    no_code,
    nodes_of,
    require_nodes,
    write_template,
    write_text,
)
from jbw.export.joint_parts import REACH, error_of_sliders, materials_of
from jbw.export.one_joint import Export
from jbw.export.several_joints import JointsExport
from jbw.oscillator.oscillator import oscillator_of
from jbw.oscillator.parameters import Material, Scalar
from jbw.report.messages import study as messages

JOINT_TAG = 1  # tag of the material that represents the whole joint


def _card(folder: Path, result: Export) -> Paths:
    facts = {"lines": opensees_lines(result.materials), "notes": tuple(_notes(result))}
    return (write_text(folder / "joint.tcl", "opensees/joint.tcl", result, **facts),)


def _joints_card(folder: Path, result: JointsExport) -> Paths:
    """Write the nodes, materials and elements of all joints."""
    joints, parts = nodes_of(result), 1 + max(joint.node for joint in nodes_of(result))
    lines = []
    for joint in joints:
        materials = joint.card.joint.materials
        lines.append(
            {
                "nodes": joint,
                "materials": opensees_lines(materials, joint.node, parts),
                "notes": tuple(_notes(joint.card.joint, joint.card.units.names[1])),
            }
        )
        parts += len(materials)
    path = folder / "joints.tcl"
    return (write_template(path, "opensees/joints.tcl", about=result.about, joints=lines),)


def _notes(result: Export, unit: str = "m") -> Iterator[str]:
    """Yield, for each law represented by sliders, a note on the sliders' range and accuracy."""
    for law in oscillator_of(result.joint, result.laws).laws:
        if law.depth:
            error = 100.0 * error_of_sliders(law, result.y_max)  # pyright: ignore[reportArgumentType]
            most = result.y_max
            yield messages.sliders(law.name, REACH * most, 0.1 * most, most, error, unit)


def opensees_lines(
    materials: Sequence[Material], tag: int = JOINT_TAG, first: int = JOINT_TAG + 1
) -> tuple[str, ...]:
    """Return the OpenSees commands that create materials and combine them in parallel."""
    tags = range(first, first + len(materials))
    lines = [
        _line(material.kind, own_tag, material.arguments)
        for own_tag, material in zip(tags, materials, strict=True)
    ]
    return (*lines, _line("Parallel", tag, tuple(map(str, tags))))


def _line(kind: str, tag: int, arguments: Iterable[Scalar | str]) -> str:
    words = (
        argument if isinstance(argument, str) else f"{float(argument):.17g}"
        for argument in arguments
    )
    return " ".join(("uniaxialMaterial", kind, str(tag), *words))


def _lacks(result: Export) -> tuple[str, ...]:
    if not result.laws:
        return ("linear",)  # This joint has no law.

    def found(law: str) -> tuple[Material, ...]:
        return materials_of(result.joint, (law,), result.mass, result.y_max)

    return tuple(law for law in result.laws if not found(law))


OPENSEES = Program(
    "opensees",
    "OpenSees",
    _card,
    lacks=_lacks,
    joints=OfJoints(_joints_card, no_code, require_nodes),
)
