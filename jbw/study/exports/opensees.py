"""Materials of OpenSees: the spring beside the joint and its laws, in parallel."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from jbw.oscillator.laws.masing import Masing
from jbw.oscillator.oscillator import oscillator_of
from jbw.oscillator.parameters import Material, Scalar
from jbw.report.messages import study as messages
from jbw.study.export import Export
from jbw.study.exported_joint import REACH, error_of_sliders, materials_of
from jbw.study.exports.program import Paths, Program, write_text

JOINT_TAG = 1  # of the material that is the whole joint


def _card(folder: Path, result: Export) -> Paths:
    """The materials."""
    facts = {"lines": opensees_lines(result.materials), "notes": tuple(_notes(result))}
    return (write_text(folder / "joint.tcl", "opensees/joint.tcl", result, **facts),)


def _notes(result: Export) -> Iterator[str]:
    """Of each law that sliders stand for, how far and how well."""
    for law in oscillator_of(result.joint, result.laws).laws:
        if isinstance(law, Masing):
            error = 100.0 * error_of_sliders(law, result.y_max)
            most = result.y_max
            yield messages.sliders(law.name, REACH * most, 0.1 * most, most, error)


def opensees_lines(materials: Sequence[Material]) -> tuple[str, ...]:
    """Commands that make materials and set them in parallel, as material 1."""
    tags = range(JOINT_TAG + 1, JOINT_TAG + 1 + len(materials))
    lines = [
        _line(material.kind, tag, material.arguments)
        for tag, material in zip(tags, materials, strict=True)
    ]
    return (*lines, _line("Parallel", JOINT_TAG, tuple(map(str, tags))))


def _line(kind: str, tag: int, arguments: Iterable[Scalar | str]) -> str:
    words = (
        argument if isinstance(argument, str) else f"{float(argument):.17g}"
        for argument in arguments
    )
    return " ".join(("uniaxialMaterial", kind, str(tag), *words))


def _lacks(result: Export) -> tuple[str, ...]:
    if not result.laws:
        return ("linear",)  # a joint of no law

    def found(law: str) -> tuple[Material, ...]:
        return materials_of(result.joint, (law,), result.mass, result.y_max)

    return tuple(law for law in result.laws if not found(law))


OPENSEES = Program("opensees", "OpenSees", _card, lacks=_lacks)
