"""Nastran: CBUSH1D with the joint's force as a table, and its equivalent damping as another."""

from pathlib import Path

from jbw.study.export import Export
from jbw.study.exports.program import Paths, Program, mirrored, write_text

FORCE, DAMPING = 1, 2  # tables


def _card(folder: Path, result: Export) -> Paths:
    """The element, its property and the tables."""
    tables = [
        (number, [_field(x) for x in mirrored(result.skeleton, column, odd=odd)])
        for number, column, odd in (
            (FORCE, "tip_force_n", True),
            (DAMPING, "damping_ns_m", False),
        )
    ]
    linear = (
        _field(result.skeleton["stiffness_n_m"][0]),
        _field(result.skeleton["damping_ns_m"][-1]),
    )
    facts = {"tables": tables, "linear": linear, "force": FORCE, "damping": DAMPING}
    return (write_text(folder / "joint.bdf", "nastran/joint.bdf", result, **facts),)


def _field(value: float) -> str:
    """A number in a field of sixteen characters."""
    return f"{value:<16.9e}"


NASTRAN = Program("nastran", "Nastran", _card)
