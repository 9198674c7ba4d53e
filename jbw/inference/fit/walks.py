"""Constrained optima along one coordinate of a least-squares problem, for its profile."""

from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from jbw.inference.fit.costly_fit import Part, trust_region

REACH = 3.0  # standard deviations to either side, a little beyond the 2.58 of 99 %
MOST_FURTHER = 6  # points beyond, each twice as far as the last
MOST_EVALUATIONS = 12  # of a point: the neighbour's optimum is near
TOLERANCE = 1e-7  # of the cost and of the step, relative
ON_BOUND = 1e-6  # of the box: nearer there is no room for points

STEEP = 1.5  # standard deviations between two points: more, and a line between them tells little
MOST_HALVINGS = 6  # of the gap in which a side passes the threshold

Point = tuple[NDArray[np.float64], float]  # where, and chi-square


def walk(
    part: Part,
    start: NDArray[np.float64],
    held: int,
    *,
    num_points: int,
    worth: float,
    threshold: float,
) -> tuple[Float[np.ndarray, "point parameter"], Float[np.ndarray, " point"]]:
    """Hold one coordinate at points on both sides of a fit, the others at their best.

    Args:
        part: Residual (0) and Jacobian (1) as functions of the coordinates, each in [0, 1].
        start: The fit.
        held: Which coordinate is held.
        num_points: Points within three standard deviations, the fit among them.
        worth: Share of the residuals that are independent.
        threshold: Rise of chi-square at which a side is done.

    Returns:
        Coordinates of the optima, the held one rising, and their chi-square.
    """
    sd = _sd(np.sqrt(worth) * part(start, 1), held)
    centre = worth * float(np.sum(part(start, 0) ** 2))
    sides: list[list[Point]] = []
    for sign in (-1.0, 1.0):
        s, side = start, [(start, centre)]
        for place in _places(start[held], sign, sd, num_points // 2):
            within = abs(place - start[held]) <= REACH * sd * (1 + 1e-9)
            if not within and side[-1][1] > centre + threshold:
                break
            s, chi_square = _constrained(part, s, held, place)
            side.append((s, worth * chi_square))
        sides.append(_refined(part, side, held, worth, threshold))
    rows, costs = zip(*sides[0][:0:-1], *sides[1], strict=True)
    return np.array(rows), np.array(costs)


def _refined(
    part: Part, side: list[Point], held: int, worth: float, threshold: float
) -> list[Point]:
    """A side with points put in where it rises to the threshold too steeply for a line.

    Another parameter may have met its bound there: the valley ends and a wall begins.
    """
    centre = side[0][1]
    for _ in range(MOST_HALVINGS):
        rise = np.array([max(chi_square - centre, 0.0) for _, chi_square in side])
        beyond = np.flatnonzero(rise > threshold)
        if not beyond.size:
            break
        j = int(beyond[0])
        if np.sqrt(rise[j]) - np.sqrt(rise[j - 1]) < STEEP:
            break
        inner, outer = side[j - 1][0], side[j][0]
        s, chi_square = _constrained(part, inner, held, (inner[held] + outer[held]) / 2)
        side = [*side[:j], (s, worth * chi_square), *side[j:]]
    return side


def _sd(jacobian: Float[np.ndarray, "residual parameter"], held: int) -> float:
    """Standard deviation of one coordinate, all others free; a box's width where there is none."""
    others = np.delete(jacobian, held, axis=1)
    own = jacobian[:, held]
    explained = others @ np.linalg.lstsq(others, own)[0] if others.shape[1] else 0.0
    left = float(np.linalg.norm(own - explained))
    # What the others explain up to rounding carries no information of its own.
    left = left if left > 1e-9 * float(np.linalg.norm(own)) else 0.0
    return min(1 / left, 1.0) if left > 0 else 1.0


def _places(centre: float, side: float, sd: float, num_points: int) -> list[float]:
    """Where to hold the coordinate on one side, outwards; the last one is the box's bound."""
    room = 1 - centre if side > 0 else centre
    if room <= ON_BOUND:
        return []
    reach = min(REACH * sd, room)
    steps = list(reach * np.arange(1, num_points + 1) / num_points)
    further = [REACH * sd * 2.0**k for k in range(1, MOST_FURTHER + 1)]
    steps += [each for each in further if reach < each < room]
    if steps[-1] < room:
        steps.append(room)
    # On the bound itself exactly: a difference may miss it by rounding.
    return [float(np.clip(centre + side * step, 0.0, 1.0)) for step in steps]


def _constrained(part: Part, s: NDArray[np.float64], held: int, place: float) -> Point:
    """Optimum of the other coordinates, from a neighbour's, and its chi-square."""
    free = np.arange(len(s)) != held

    def whole(rest: NDArray[np.float64]) -> NDArray[np.float64]:
        found = np.full(len(s), place)
        found[free] = rest
        return found

    if not np.any(free):
        alone = whole(np.empty(0))
        return alone, float(np.sum(part(alone, 0) ** 2))

    def of_rest(rest: NDArray[np.float64], which: int) -> NDArray[np.float64]:
        found = part(whole(rest), which)
        return found[:, free] if which else found

    found: Any = trust_region(of_rest, np.clip(s[free], 0.0, 1.0), MOST_EVALUATIONS, TOLERANCE)
    return whole(found.x), 2 * float(found.cost)
