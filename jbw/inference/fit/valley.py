r"""Coordinates along a curved valley of the posterior, where one parameter determines the others.

If the data do not determine a parameter q, the others compensate for it along a curve. With the
optimum c(q) of the others at every q, and a root L(q) of their covariance there,

$$x = c(q) + L(q)\,w, \qquad \left|\det \frac{\partial (q, x)}{\partial (q, w)}\right|
  = \prod_i L_{ii}(q)$$

c is a cubic between some values of q, where its slope is known too, and L is linear there. In (q,
w) the valley is straight and equally wide. A floor is found by the profile of a parameter.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree
from numpy.typing import NDArray

from jbw.inference.fit.costly_fit import Part, evaluator, precision, search_coordinate, to_search
from jbw.inference.fit.fitting import Fit, Residual
from jbw.inference.fit.profiles import constrained, walk
from jbw.inference.space.box import Box
from jbw.inference.space.coordinates import IDENTITY, Composed, Coordinate, Vector
from jbw.inference.space.reparametrisation import Reparametrisation

# bound of the coordinate w, the distance from the bottom of the posterior's valley in standard
# deviations
WIDE = 100.0
NUM_POINTS = 400  # number of points of the marginal density along the posterior's valley
# Support points closer to each other than this, in normalised coordinates, count as one.
APART = 1e-9
# largest error of the bottom of the valley between two support points, as a change of chi-square
OFF = 1.0
FAR = 100.0  # rise of chi-square above which the posterior is negligible
# Above this slope, in units of the prior range, the valley turns back and cannot be followed by one
# parameter.
STEEP = 10.0
# A parameter may serve as coordinate along the valley if its component in the weakest direction
# exceeds this fraction of the largest.
PART = 0.3


class Floor(NamedTuple):
    """The bottom of a valley of chi-square: for each value of one parameter, the others' optimum.

    Attributes:
        held: Index of the fixed parameter.
        points: All parameters, with the others at their optimum.
        slopes: Derivatives of the others' optimum with respect to the fixed parameter.
        chi_square: Chi-square at the points.
        roots: Lower triangular roots of the others' covariance at the points.
    """

    held: int
    points: Float[np.ndarray, "knot parameter"]
    slopes: Float[np.ndarray, "knot other"]
    chi_square: Float[np.ndarray, " knot"]
    roots: Float[np.ndarray, "knot other other"]


class Valley(Coordinate):
    """Coordinates in a curved valley: one parameter, and distances of others from the bottom."""

    held: int = eqx.field(static=True)
    knots: Float[Array, " knot"]
    floor: Float[Array, "knot other"]
    slopes: Float[Array, "knot other"]
    roots: Float[Array, "knot other other"]

    def forward(self, x: Vector) -> Vector:
        """Return the parameters at given distances from the bottom of the posterior's valley."""
        floor, root = self._at(x[self.held])
        return x.at[self._others].set(floor + root @ x[self._others])

    def inverse(self, y: Vector) -> Vector:
        """Return the distances of parameters from the bottom of the posterior's valley."""
        floor, root = self._at(y[self.held])
        away = jax.scipy.linalg.solve_triangular(root, y[self._others] - floor, lower=True)
        return y.at[self._others].set(away)

    def log_abs_det_jacobian(self, x: Vector) -> Float[Array, ""]:
        """Return the log determinant of the map: the log of the posterior valley's width."""
        return jnp.sum(jnp.log(jnp.diagonal(self._at(x[self.held])[1])))

    @property
    def _others(self) -> np.ndarray:
        return np.delete(np.arange(self.floor.shape[1] + 1), self.held)

    def _at(
        self, q: Float[Array, ""]
    ) -> tuple[Float[Array, " other"], Float[Array, "other other"]]:
        """Return the optimum of the other parameters, and their covariance's root, at a given q."""
        i = jnp.clip(jnp.searchsorted(self.knots, q) - 1, 0, self.knots.size - 2)
        length = self.knots[i + 1] - self.knots[i]
        part = jnp.clip((q - self.knots[i]) / length, 0.0, 1.0)
        beyond = q - (self.knots[i] + part * length)
        rise = self.floor[i + 1] - self.floor[i]
        begins, ends = length * self.slopes[i], length * self.slopes[i + 1]
        twist = (1 - part) * (begins - rise) + part * (rise - ends)
        floor = self.floor[i] + part * (rise + (1 - part) * twist)
        slope = jnp.where(part > 0.5, self.slopes[i + 1], self.slopes[i])
        root = self.roots[i] + part * (self.roots[i + 1] - self.roots[i])
        return floor + beyond * slope, root


def along_valley(
    floor: Floor,
    outer: Composed,
    bounds: tuple[Float[Array, " parameter"], Float[Array, " parameter"]],
) -> Reparametrisation:
    """Return the sampling coordinates along a valley of the posterior.

    Args:
        floor: Floor of the valley.
        outer: Map from the coordinates of the floor's points to the parameters.
        bounds: Bounds of the coordinates of the floor's points.
    """
    held, size = floor.held, floor.points.shape[1]
    others = np.delete(np.arange(size), held)
    valley = Valley(
        held,
        jnp.asarray(floor.points[:, held]),
        jnp.asarray(floor.points[:, others]),
        jnp.asarray(floor.slopes),
        jnp.asarray(floor.roots),
    )
    both = Composed((valley, outer))
    lower, upper = (
        jnp.full(size, sign * WIDE).at[held].set(bound[held])
        for sign, bound in zip((-1, 1), bounds, strict=True)
    )
    mean, variance = _moments(floor, both)
    start, covariance = np.zeros(size), np.eye(size)
    start[held], covariance[held, held] = mean, variance
    return Reparametrisation(both, lower, upper, start, covariance)


def _moments(floor: Floor, coordinate: Composed) -> tuple[float, float]:
    r"""Return mean and variance of the leading parameter q under $e^{-\chi^2(q) / 2}\,|\det|$."""
    size, knots = floor.points.shape[1], floor.points[:, floor.held]
    q = np.linspace(knots[0], knots[-1], NUM_POINTS)
    x = jnp.zeros((NUM_POINTS, size)).at[:, floor.held].set(jnp.asarray(q))
    slope = np.asarray(jax.vmap(coordinate.log_abs_det_jacobian)(x))
    log_density = slope - 0.5 * np.interp(q, knots, floor.chi_square)
    weights: NDArray[np.float64] = np.exp(log_density - log_density.max())
    weights /= weights.sum()
    mean = float(weights @ q)
    return mean, float(weights @ (q - mean) ** 2)


def about_valley(residual: Residual, box: Box, data: PyTree, best: Fit) -> Reparametrisation | None:
    """Return coordinates along the profile of a weakly determined parameter, or None.

    None if all such profiles turn back inside the box, because coordinates along them would miss a
    part. Profiles where the data rule them out do not matter. The residual, box, data and compiled
    differences are those of the `costly_fit` that found `best`.
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
    """Return the parameters with the largest components in the least determined direction."""
    weakest: Any = np.abs(np.linalg.eigh(precision(jacobian))[1][:, 0])
    order = np.argsort(-weakest)
    return order[weakest[order] > PART * weakest.max()].tolist()


def _floor(
    part: Part,
    held: int,
    points: Float[np.ndarray, "knot parameter"],
    chi_square: Float[np.ndarray, " knot"],
) -> Floor:
    r"""Fit the bottom c(q) of a valley to optima with slopes $-(J_o^T J_o)^{-1} J_o^T j_q$."""
    slopes, roots = [], []
    for point in points:
        # Where the model has no solution near a point, derivatives count as zero, so that only the
        # prior range limits the other parameters.
        jacobian = np.nan_to_num(part(point, 1), posinf=0.0, neginf=0.0)
        others, held_column = np.delete(jacobian, held, axis=1), jacobian[:, held]
        covariance = np.linalg.inv(precision(others))
        slopes.append(-covariance @ (others.T @ held_column))
        roots.append(np.linalg.cholesky(covariance))
    return Floor(held, points, np.stack(slopes), chi_square, np.stack(roots))


def _finer(part: Part, floor: Floor, unit: Any) -> Floor | None:
    """Return the valley with more support points where it is inaccurate; None if it is accurate."""
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
