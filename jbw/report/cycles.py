"""Tables of force loops without a model: secant stiffness, and all cycles."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from jbw.report.messages import tables as notes
from jbw.report.table import Column, Table, table, words
from jbw.report.text import NOTHING, length_unit, number, percent

if TYPE_CHECKING:
    from jbw.results.run import StoredCycle, StoredLoop  # loads pydantic

MOST_CYCLES = 12  # largest number of cycles of one test in a table
# factor from radians to each unit of angle, and the name of the unit
ANGLES = ((1.0, "rad"), (1e3, "mrad"), (1e6, "µrad"))


def motion_unit(largest: float, unit: str = "m") -> tuple[float, str]:
    """Return the unit, after its factor, in which a motion [m] or [rad] has a value above one."""
    if unit != "rad":
        return length_unit(largest)
    return next((prefix for prefix in ANGLES if largest * prefix[0] >= 1.0), ANGLES[-1])


def loops_table(loops: "Sequence[StoredLoop]") -> Table:
    """Return a table of force loops: largest motion, and secant stiffness at that motion."""
    motion, stiffness = _written(loops)
    return table(
        "Force loops",
        loops,
        words("test", "test"),
        Column(f"motion [{motion[1]}]", lambda row: number(motion[0] * row.y)),
        Column(f"secant stiffness [{stiffness}]", lambda row: number(row.stiffness)),
    )


def cycles_table(loops: "Sequence[StoredLoop]") -> Table:
    """Return a table of cycles: amplitude, secant stiffness, work, damping, remaining stiffness."""
    (factor, unit), stiffness = _written(loops)
    return table(
        notes.CYCLES,
        [cycle for loop in loops for cycle in _shown(loop)],
        words("test", "test"),
        words("cycle", "cycle", "right"),
        Column(f"amplitude [{unit}]", lambda row: number(factor * row.amplitude)),
        Column(f"secant stiffness [{stiffness}]", lambda row: number(row.stiffness)),
        Column("work [J]", lambda row: number(row.work)),
        Column("equivalent\ndamping", lambda row: percent(row.damping)),
        Column(notes.FIRST_OF_AMPLITUDE, _retained),
    )


def _retained(row: "StoredCycle") -> str:
    return percent(row.retained) if row.repeated else NOTHING


def unit_of_motion(loops: "Sequence[StoredLoop]") -> str:
    """Return "rad" if all loops are of torque and rotation, otherwise "m"."""
    return "rad" if {loop.unit for loop in loops} == {"rad"} else "m"


def _written(loops: "Sequence[StoredLoop]") -> tuple[tuple[float, str], str]:
    """Return factor and unit of the motion, and the unit of stiffness, for a table of loops."""
    unit = unit_of_motion(loops)
    largest = max((row.y for row in loops), default=1e-3)
    return motion_unit(largest, unit), "N m/rad" if unit == "rad" else "N/m"


def _shown(loop: "StoredLoop") -> "Iterator[StoredCycle]":
    """Yield the cycles of a test that a table shows: all, or some at even distances."""
    count = len(loop.cycles)
    chosen = np.unique(np.linspace(0, count - 1, min(count, MOST_CYCLES)).round())
    for i in chosen.astype(int):
        yield loop.cycles[i].replaced(test=loop.test, cycle=int(i) + 1)
