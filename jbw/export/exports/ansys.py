"""Ansys: COMBIN39 with a table of the joint's force, and a dashpot with the joint's energy loss."""

from pathlib import Path

from jbw.export.exports.program import Paths, Program, number, write_text
from jbw.export.one_joint import Export


def _card(folder: Path, result: Export) -> Paths:
    """Write the element types and real constants of the joint."""
    table = result.skeleton
    pairs = zip(table["displacement_m"], table["tip_force_n"], strict=True)
    # The table begins at the origin; Ansys mirrors the points with positive displacement.
    points = ["0.0", "0.0", *(number(x) for pair in pairs for x in pair)]
    return (write_text(folder / "joint.mac", "ansys/joint.mac", result, points=points),)


ANSYS = Program("ansys", "Ansys", _card)
