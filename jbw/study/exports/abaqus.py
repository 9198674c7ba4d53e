"""Abaqus/Standard: a user element of two nodes in C, with the exact moves, and its properties."""

from pathlib import Path

from jbw.study.export import Export
from jbw.study.exports.program import Form, Paths, Program, forms_of, without_form, write_text


def _facts(result: Export) -> dict[str, int | tuple[Form, ...]]:
    forms = forms_of("c/laws", result)
    return {"forms": forms, "memory": sum(form.memory for form in forms)}


def _code(folder: Path, result: Export) -> Paths:
    """The element."""
    return (write_text(folder / "joint_uel.c", "abaqus/joint_uel.c", result, **_facts(result)),)


def _card(folder: Path, result: Export) -> Paths:
    """Its properties, to be included in an input file."""
    return (write_text(folder / "joint.inp", "abaqus/joint.inp", result, **_facts(result)),)


ABAQUS = Program("abaqus", "Abaqus", _card, _code, without_form("c/laws"))
