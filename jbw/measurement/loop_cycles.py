r"""Force loops cycle by cycle: secant stiffness, work, damping and what is left of the stiffness.

Of a cycle from one passage of the middle to the second next, of amplitude a and the secant
stiffness k between its turning points,

$$W = \oint F\,\mathrm{d}y, \qquad \zeta_{eq} = \frac{W}{2 \pi k a^2}$$

An offset of the load cell changes none of them, and a drift hardly: what it drifts in a cycle times
what the ends of the cycle lie apart.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from jbw.measurement.channels import Reals
from jbw.measurement.curves import ForcedLoop

TURN = 0.1  # of the whole stroke: what goes back by less is no reversal
ALIKE = 0.02  # of their stroke: cycles of one amplitude
FEWEST = 3  # cycles of one amplitude, of which the first still remembers what was before
AT_REST = 0.02  # of the whole stroke: a loop that begins closer to y = 0 begins there
STEADY = 0.5  # of what a centre moves in a cycle of the first half of its course, later on
TINY = 1e-300


class Cycle(NamedTuple):
    """Samples from one largest displacement to the next, its stroke and peak-to-peak force."""

    samples: slice
    stroke: float
    force: float


class CycleReading(NamedTuple):
    """What one cycle shows.

    Attributes:
        amplitude: Half of its stroke a [m].
        stiffness: Secant stiffness k between its turning points [N/m].
        work: Work W that it takes in [J].
        damping: Equivalent damping ratio zeta_eq [-].
        retained: Its stiffness over that of the first cycle of its amplitude [-].
        repeated: Whether another cycle has its amplitude.
    """

    amplitude: float
    stiffness: float
    work: float
    damping: float
    retained: float
    repeated: bool


def cycles_of(loop: ForcedLoop) -> list[Cycle]:
    """Whole cycles of a loop, from one upper turning point to the next."""
    y = loop.displacement
    least = TURN * np.ptp(y)
    turns, rising, place = [], True, 0
    for i in range(len(y)):
        if (y[i] > y[place]) == rising and y[i] != y[place]:
            place = i
        elif abs(y[i] - y[place]) > least:
            turns += [place] if rising else []
            rising, place = not rising, i
    return [_cycle(loop, first, last) for first, last in pairwise(turns)]


def _between_passages(loop: ForcedLoop) -> list[Cycle]:
    """Whole cycles of a loop, from one passage of the middle to the second next."""
    crossings = passages(loop.displacement)
    return [_cycle(loop, *ends) for ends in zip(crossings[:-2:2], crossings[2::2], strict=False)]


def _cycle(loop: ForcedLoop, first: int, last: int) -> Cycle:
    """The cycle between two samples, which are both of it."""
    samples = slice(first, last + 1)
    stroke, force = (float(np.ptp(x[samples])) for x in (loop.displacement, loop.force))
    return Cycle(samples, stroke, force)


def passages(y: Reals) -> list[int]:
    """Samples from where a displacement is beyond its middle, one side and the other in turn.

    The middle is y = 0 where the motion goes to both sides of it; a record that begins or ends
    there does so with a passage.
    """
    reach, ends = float(np.ptp(y)), (float(np.min(y)), float(np.max(y)))
    goes_both_ways = min(-ends[0], ends[1]) > TURN * reach
    away = y - (0.0 if goes_both_ways else 0.5 * sum(ends))
    far, crossings = AT_REST * reach, []
    side = last = 0.0
    place = 0
    for i, (x, sign) in enumerate(zip(away, np.sign(away), strict=True)):
        if sign not in (0.0, last):
            last, place = sign, i
        if abs(x) > far and sign != side:
            side = sign
            crossings.append(place)
    begins = [] if abs(away[0]) > far else [0]
    closes = [] if not crossings or abs(away[-1]) > far else [len(y) - 1]
    return [*begins, *crossings[1:], *closes]


def readings_of_cycles(loop: ForcedLoop) -> list[CycleReading]:
    """Every whole cycle of a loop, in its order."""
    readings: list[CycleReading] = []
    first: dict[int, float] = {}
    cycles = _between_passages(loop)
    groups = _amplitudes(cycles)
    for cycle, group in zip(cycles, groups, strict=True):
        y, force = loop.displacement[cycle.samples], loop.force[cycle.samples]
        (bottom, top), (below, above) = _turning_points(loop, cycle)
        stiffness = float((above - below) / (top - bottom))
        work = float(np.trapezoid(np.append(force, force[0]), np.append(y, y[0])))
        amplitude = 0.5 * cycle.stroke
        first.setdefault(group, stiffness)
        damping = work / (2 * np.pi * stiffness * amplitude**2) if stiffness else np.nan
        retained = stiffness / first[group] if first[group] else np.nan
        is_repeated = groups.count(group) > 1
        readings.append(CycleReading(amplitude, stiffness, work, damping, retained, is_repeated))
    return readings


def _amplitudes(cycles: Sequence[Cycle]) -> list[int]:
    """A number for every cycle, the same for cycles of one stroke."""
    strokes: list[float] = []
    numbers = []
    for cycle in cycles:
        matching = [i for i, stroke in enumerate(strokes) if abs(cycle.stroke / stroke - 1) < ALIKE]
        strokes += [] if matching else [cycle.stroke]
        numbers.append(matching[0] if matching else len(strokes) - 1)
    return numbers


def start_of(loop: ForcedLoop) -> float | None:
    """Force at the start of a loop that begins at y = 0, over its half range; None of others.

    A joint that nothing has loaded exerts none there, whatever its law.
    """
    y, force = loop.displacement, loop.force
    reach = float(np.ptp(y))
    if not np.ptp(force) or abs(y[0]) > AT_REST * reach:
        return None
    away = np.abs(y - y[0]) > AT_REST * reach
    first = y[: max(int(np.argmax(away)), 2)]  # until it has left its start
    slope = 0.0 if np.ptp(first) == 0 else np.polyfit(first, force[: len(first)], 1)[0]
    return float(np.mean(force[: len(first)] - slope * first)) / (0.5 * float(np.ptp(force)))


def drift_of(loop: ForcedLoop) -> float:
    """How far the centres of equal cycles move in their course, over their half range.

    Zero where that is no steady course: a joint that forgets its start slows down.
    """
    most = 0.0
    for equal_cycles in of_one_amplitude(cycles_of(loop)):
        centres, halves = np.transpose([_centre(loop, cycle) for cycle in equal_cycles[1:]])
        middle = len(centres) // 2
        if not 0 < middle < len(centres) - 1:
            continue
        before = (centres[middle] - centres[0]) / middle
        after = (centres[-1] - centres[middle]) / (len(centres) - 1 - middle)
        is_steady = before * after > 0 and abs(after) > STEADY * abs(before)
        change = float((centres[-1] - centres[0]) / max(np.max(halves), TINY))
        if is_steady and abs(change) > abs(most):
            most = change
    return most


def lopsided(loop: ForcedLoop) -> float:
    r"""Median of $(F^+ - F^-) / (F^+ + F^-)$ of the forces at the turning points of all cycles."""
    centres = np.array([_centre(loop, cycle) for cycle in cycles_of(loop)])
    if not len(centres):
        return 0.0
    centre, half = centres.T
    start = start_of(loop) or 0.0
    return float(np.median((centre - start * np.max(half)) / np.maximum(half, TINY)))


def of_one_amplitude(cycles: Sequence[Cycle]) -> list[list[Cycle]]:
    """Runs of three cycles or more whose strokes are alike."""
    groups: list[list[Cycle]] = []
    for cycle in cycles:
        if groups and abs(cycle.stroke / groups[-1][0].stroke - 1) < ALIKE:
            groups[-1].append(cycle)
        else:
            groups.append([cycle])
    return [group for group in groups if len(group) >= FEWEST]


def _centre(loop: ForcedLoop, cycle: Cycle) -> tuple[float, float]:
    """Force midway between the turning points of a cycle at rest position, and its half range."""
    (bottom, top), (below, above) = _turning_points(loop, cycle)
    stiffness = (above - below) / (top - bottom)
    middle = 0.5 * (above + below - stiffness * (top + bottom))
    return float(middle), 0.5 * abs(float(above - below))


def _turning_points(loop: ForcedLoop, cycle: Cycle) -> tuple[Reals, Reals]:
    """Least and largest displacement of a cycle, and the forces there."""
    y, force = loop.displacement[cycle.samples], loop.force[cycle.samples]
    bottom, top = int(np.argmin(y)), int(np.argmax(y))
    return y[[bottom, top]], force[[bottom, top]]
