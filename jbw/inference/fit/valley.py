"""The curve along which the other parameters make up for the one that the data leave open."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, PyTree

from jbw.inference.fit.costly_fit import Part, evaluator, precision, search_coordinate, to_search
from jbw.inference.fit.fitting import Fit, Residual
from jbw.inference.fit.profiles import constrained, walk
from jbw.inference.space.box import Box
from jbw.inference.space.coordinates import IDENTITY
from jbw.inference.space.reparametrisation import Reparametrisation
from jbw.inference.space.valley import Floor, along_valley

APART = 1e-9  # of the unit cube: knots that are nearer are one
OFF = 1.0  # of chi-square: what the floor may miss the optimum by between two knots
FAR = 100.0  # of chi-square above its least, where nothing of the posterior is left
STEEP = 10.0  # of the floor, in units of the box: it turns back there
PART = 0.3  # of the largest part in the least known direction, which another may have instead


def about_valley(residual: Residual, box: Box, data: PyTree, best: Fit) -> Reparametrisation | None:
    """Coordinates along the profile of a parameter that a fit hardly knows, in units of its box.

    None where all such profiles turn back inside the box: what follows them is seen in part alone.
    What they do where the data rule them out does not matter.
    The residual, box, data and compiled differences are those of the `costly_fit` that found it.
    """
    part = evaluator(residual, box, data)
    start = to_search(best.x, box)
    unit = jnp.zeros(len(start)), jnp.ones(len(start))
    for held in _least_known(part(start, 1)):
        points, chi_square = walk(part, start, held)
        near = chi_square < chi_square.min() + FAR
        on_floor = near & np.append(True, np.diff(points[:, held]) > APART)
        floor = _floor(part, held, points[on_floor], chi_square[on_floor])
        if len(floor.points) > 1 and not np.any(np.abs(floor.slopes) > STEEP):
            floor = _finer(part, floor, unit) or floor
            return along_valley(floor, search_coordinate(box), unit)
    return None


def _least_known(jacobian: Float[np.ndarray, "residual parameter"]) -> list[int]:
    """The parameters of a part in the direction that is known least, the largest first."""
    weakest: Any = np.abs(np.linalg.eigh(precision(jacobian))[1][:, 0])
    order = np.argsort(-weakest)
    return order[weakest[order] > PART * weakest.max()].tolist()


def _floor(
    part: Part,
    held: int,
    points: Float[np.ndarray, "knot parameter"],
    chi_square: Float[np.ndarray, " knot"],
) -> Floor:
    r"""The floor through optima, $dc/dq = -(J_o^T J_o)^{-1} J_o^T j_q$, and the others' roots."""
    slopes, roots = [], []
    for point in points:
        # Where the model cannot be solved beside the point, the box alone bounds the others.
        jacobian = np.nan_to_num(part(point, 1), posinf=0.0, neginf=0.0)
        others, held_column = np.delete(jacobian, held, axis=1), jacobian[:, held]
        covariance = np.linalg.inv(precision(others))
        slopes.append(-covariance @ (others.T @ held_column))
        roots.append(np.linalg.cholesky(covariance))
    return Floor(held, points, np.stack(slopes), chi_square, np.stack(roots))


def _finer(part: Part, floor: Floor, unit: Any) -> Floor | None:
    """The floor with optima put in where it misses them between two knots; None where nowhere."""
    middles, optima = (floor.points[1:, floor.held] + floor.points[:-1, floor.held]) / 2, []
    flat = along_valley(floor, IDENTITY, unit).outer
    for place in middles:
        guess = np.asarray(flat.forward(jnp.zeros(len(unit[0])).at[floor.held].set(place)))
        point, least = constrained(part, guess, floor.held, float(place))
        if float(np.sum(part(guess, 0) ** 2)) > least + OFF:
            optima.append((point, least))
    if not optima:
        return None
    rows, costs = zip(*optima, strict=True)
    points = np.vstack([floor.points, rows])
    order = np.argsort(points[:, floor.held])
    chi_square = np.append(floor.chi_square, costs)
    return _floor(part, floor.held, points[order], chi_square[order])
