"""Ansys: COMBIN39 with the joint's force as a table, and a dashpot that loses what it does."""

from pathlib import Path

from jbw.export.exports.program import Paths, Program, number, write_text
from jbw.export.one_joint import Export


def _card(folder: Path, result: Export) -> Paths:
    """Return the elements' types and real constants."""
    table = result.skeleton
    pairs = zip(table["displacement_m"], table["tip_force_n"], strict=True)
    # Of the origin on; Ansys mirrors what is given for positive displacements.
    points = ["0.0", "0.0", *(number(x) for pair in pairs for x in pair)]
    return (write_text(folder / "joint.mac", "ansys/joint.mac", result, points=points),)


ANSYS = Program("ansys", "Ansys", _card)
