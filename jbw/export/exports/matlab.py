"""MATLAB and Octave: a function that advances the joint by one exact time step."""

from pathlib import Path

from jbw.export.exports.program import Paths, Program, forms_of, without_form, write_text
from jbw.export.one_joint import Export


def _code(folder: Path, result: Export) -> Paths:
    """Write the function that advances the joint by one time step, given its parameters."""
    forms = forms_of("matlab/laws", result)
    facts = {"forms": forms, "memory": sum(form.memory for form in forms)}
    return (write_text(folder / "joint_step.m", "matlab/joint_step.m", result, **facts),)


def _card(folder: Path, result: Export) -> Paths:
    path = folder / "joint_parameters.m"
    return (write_text(path, "matlab/joint_parameters.m", result),)


MATLAB = Program("matlab", "MATLAB", _card, _code, without_form("matlab/laws"))
