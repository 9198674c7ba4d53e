"""Materials of OpenSees: the spring beside the joint and its laws, in parallel."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from jbw.oscillator.parameters import Material, Scalar
from jbw.study.export import Export
from jbw.study.exported_joint import materials_of
from jbw.study.exports.program import Paths, Program, write_text

JOINT_TAG = 1  # of the material that is the whole joint


def _card(folder: Path, result: Export) -> Paths:
    """The materials."""
    lines = opensees_lines(result.materials)
    return (write_text(folder / "joint.tcl", "opensees/joint.tcl", result, lines=lines),)


def opensees_lines(materials: Sequence[Material]) -> tuple[str, ...]:
    """Commands that make materials and set them in parallel, as material 1."""
    tags = range(JOINT_TAG + 1, JOINT_TAG + 1 + len(materials))
    lines = [_line(one.kind, tag, one.arguments) for tag, one in zip(tags, materials, strict=True)]
    return (*lines, _line("Parallel", JOINT_TAG, tuple(map(str, tags))))


def _line(kind: str, tag: int, arguments: Iterable[Scalar | str]) -> str:
    words = (one if isinstance(one, str) else f"{float(one):.17g}" for one in arguments)
    return " ".join(("uniaxialMaterial", kind, str(tag), *words))


def _lacks(result: Export) -> tuple[str, ...]:
    if not result.laws:
        return ("linear",)  # a joint of no law
    return tuple(law for law in result.laws if not materials_of(result.joint, (law,), result.mass))


OPENSEES = Program("opensees", "OpenSees", _card, lacks=_lacks)
