r"""Coordinates along the floor of a curved valley, where the other parameters follow one of them.

Where the data leave one parameter q open, the others make up for it along a curve that no straight
line follows. With the optimum c(q) of the others at every q, and a root of their covariance there,

$$x = c(q) + L(q)\,w, \qquad \left|\det \frac{\partial (q, x)}{\partial (q, w)}\right|
  = \prod_i L_{ii}(q)$$

c is a cubic between some values of q, where its slope is known too, and L is straight there. In
(q, w) the valley is straight and equally wide.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

from jbw.inference.space.coordinates import Composed, Coordinate, Vector
from jbw.inference.space.reparametrisation import Reparametrisation

FAR = 100.0  # standard deviations off the floor, where w ends
NUM_POINTS = 400  # along the floor, of its marginal density


class Floor(NamedTuple):
    """The floor of a valley, at rising values of the parameter that is held.

    Attributes:
        held: Which parameter.
        points: All of them, the others at their optimum.
        slopes: How the others' optimum changes with the one that is held.
        chi_square: There.
        roots: Lower triangular roots of the others' covariance there.
    """

    held: int
    points: Float[np.ndarray, "knot parameter"]
    slopes: Float[np.ndarray, "knot other"]
    chi_square: Float[np.ndarray, " knot"]
    roots: Float[np.ndarray, "knot other other"]


class Valley(Coordinate):
    """The parameter that is held, and the others by their distance from the floor."""

    held: int = eqx.field(static=True)
    knots: Float[Array, " knot"]
    floor: Float[Array, "knot other"]
    slopes: Float[Array, "knot other"]
    roots: Float[Array, "knot other other"]

    def forward(self, x: Vector) -> Vector:
        """The parameters at a distance from the floor."""
        floor, root = self._at(x[self.held])
        return x.at[self._others].set(floor + root @ x[self._others])

    def inverse(self, y: Vector) -> Vector:
        """The distance of parameters from the floor."""
        floor, root = self._at(y[self.held])
        away = jax.scipy.linalg.solve_triangular(root, y[self._others] - floor, lower=True)
        return y.at[self._others].set(away)

    def log_abs_det_jacobian(self, x: Vector) -> Float[Array, ""]:
        """Logarithm of the valley's width there."""
        return jnp.sum(jnp.log(jnp.diagonal(self._at(x[self.held])[1])))

    @property
    def _others(self) -> np.ndarray:
        return np.delete(np.arange(self.floor.shape[1] + 1), self.held)

    def _at(
        self, q: Float[Array, ""]
    ) -> tuple[Float[Array, " other"], Float[Array, "other other"]]:
        """The floor, extrapolated beyond its ends, and the root, constant beyond them."""
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
    """The coordinates along a floor, whose points are in coordinates within bounds.

    Args:
        floor: Where the valley lies.
        outer: From the coordinates of its points to the parameters.
        bounds: Of the coordinates of its points.
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
        jnp.full(size, sign * FAR).at[held].set(bound[held])
        for sign, bound in zip((-1, 1), bounds, strict=True)
    )
    mean, variance = _moments(floor, both)
    start, covariance = np.zeros(size), np.eye(size)
    start[held], covariance[held, held] = mean, variance
    return Reparametrisation(both, lower, upper, start, covariance)


def _moments(floor: Floor, coordinate: Composed) -> tuple[float, float]:
    r"""Mean and variance along the floor, of $e^{-\chi^2(q) / 2}\,|\det|$ where w = 0."""
    size, knots = floor.points.shape[1], floor.points[:, floor.held]
    q = np.linspace(knots[0], knots[-1], NUM_POINTS)
    x = jnp.zeros((NUM_POINTS, size)).at[:, floor.held].set(jnp.asarray(q))
    slope = np.asarray(jax.vmap(coordinate.log_abs_det_jacobian)(x))
    log_density = slope - 0.5 * np.interp(q, knots, floor.chi_square)
    weights: NDArray[np.float64] = np.exp(log_density - log_density.max())
    weights /= weights.sum()
    mean = float(weights @ q)
    return mean, float(weights @ (q - mean) ** 2)
