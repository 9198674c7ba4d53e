"""Modelica: the joint as a translational component, described by the rate equations of its laws."""

from pathlib import Path

from jbw.export.exports.program import Paths, Program, forms_of, without_form, write_text
from jbw.export.one_joint import Export


def _card(folder: Path, result: Export) -> Paths:
    forms = forms_of("modelica/laws", result)
    return (write_text(folder / "Joint.mo", "modelica/joint.mo", result, forms=forms),)


MODELICA = Program("modelica", "Modelica", _card, lacks=without_form("modelica/laws"))
