"""A tensor grid over a posterior in the whitened logit of the box, and the moments on it."""

from itertools import pairwise
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from numpy.typing import NDArray

from jbw.inference.bridge import FORBIDDEN
from jbw.inference.kernels import Problem, potential_of
from jbw.inference.laplace import Whitening

CHUNK = 1024  # nodes of one compiled call
LANES = 128  # of them side by side
DEEP = 21.0  # nats below the highest node where a grid may end
NARROW = 6.6  # standard deviations of the first window
MOST_WIDENINGS = 16


class Grid(NamedTuple):
    """Nodes at whole multiples of a spacing.

    Attributes:
        axes: Places of the nodes along each whitened coordinate.
        nodes: All nodes, the first coordinate slowest.
        log_p: Log posterior density of w at each, with the prior in it [nats].
        whitening: Where the coordinate lies.
        spacing: Between nodes.
    """

    axes: tuple[NDArray[np.float64], ...]
    nodes: Float[np.ndarray, "node parameter"]
    log_p: Float[np.ndarray, " node"]
    whitening: Whitening
    spacing: float

    @property
    def weights(self) -> NDArray[np.float64]:
        """Share of the posterior at each node."""
        p = np.exp(self.log_p - np.max(self.log_p))
        return p / np.sum(p)

    @property
    def log_evidence(self) -> float:
        """Logarithm of the evidence [nats], by the trapezoidal rule."""
        largest = np.max(self.log_p)
        cell = len(self.axes) * np.log(self.spacing)
        return float(largest + np.log(np.sum(np.exp(self.log_p - largest))) + cell)


def grid_of(problem: Problem, whitening: Whitening, spacing: float, most: int) -> Grid | None:
    """A grid wide enough that the posterior is 21 nats below its highest node at every side.

    Args:
        problem: The posterior; its own whitening is not used.
        whitening: The coordinate.
        spacing: Between nodes.
        most: Nodes at most.

    Returns:
        The grid; None where it would take more nodes.
    """
    d = len(problem.box.names)
    reach = np.full((d, 2), np.ceil(NARROW / spacing), dtype=int)
    for _ in range(MOST_WIDENINGS):
        if np.prod(reach.sum(axis=1) + 1.0) > most:
            return None
        grid = grid_within(problem, whitening, spacing, reach)
        open_sides = _open_sides(grid.log_p.reshape([len(axis) for axis in grid.axes]))
        if not np.any(open_sides):
            return grid
        reach = np.where(open_sides, np.ceil(1.2 * reach).astype(int), reach)
    return None


def grid_within(
    problem: Problem, whitening: Whitening, spacing: float, reach: Int[np.ndarray, "parameter 2"]
) -> Grid:
    """A grid of so many nodes to both sides of its centre.

    Args:
        problem: The posterior; its own whitening is not used.
        whitening: The coordinate.
        spacing: Between nodes.
        reach: Nodes below and above the centre, by coordinate.
    """
    problem = eqx.tree_at(lambda one: one.whitening, problem, whitening)
    axes = tuple(spacing * np.arange(-low, high + 1) for low, high in reach)
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    return Grid(axes, nodes, log_density_at(problem, nodes), whitening, spacing)


def _open_sides(log_p: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Sides of the grid, lower and upper, at which the posterior has not died out."""
    floor = np.max(log_p) - DEEP
    faces = [
        [np.max(np.take(log_p, side, axis=axis)) > floor for side in (0, -1)]
        for axis in range(log_p.ndim)
    ]
    return np.array(faces)


def whitened_by(
    mean: NDArray[np.float64], covariance: NDArray[np.float64], first: int = 0
) -> Whitening:
    """Whitening by a covariance whose first coordinate moves along one parameter's axis alone.

    Args:
        mean: Centre, as a logit.
        covariance: Of the logit.
        first: The parameter that depends on no other coordinate.
    """
    d = len(mean)
    order = [first, *(i for i in range(d) if i != first)]
    factor = np.empty((d, d))
    factor[order] = np.linalg.cholesky(covariance[np.ix_(order, order)])
    return Whitening(jnp.asarray(mean), jnp.asarray(factor))


def log_density_at(
    problem: Problem, w: Float[np.ndarray, "point parameter"]
) -> Float[np.ndarray, " point"]:
    """Log posterior density of w, the prior in it [nats].

    Args:
        problem: The posterior.
        w: Points in its whitened coordinate.
    """
    padded = np.concatenate([w, np.zeros((-len(w) % CHUNK, w.shape[1]))])
    ends = range(0, len(padded) + 1, CHUNK)
    parts = [np.asarray(_chunk(problem, jnp.asarray(padded[a:b]))) for a, b in pairwise(ends)]
    return np.concatenate(parts)[: len(w)]


@eqx.filter_jit
def _chunk(problem: Problem, w: Float[Array, "node parameter"]) -> Float[Array, " node"]:
    potential = potential_of(problem)
    log_slope = jnp.linalg.slogdet(problem.whitening.factor)[1]

    def one(w: Float[Array, " parameter"]) -> Float[Array, ""]:
        value = log_slope - potential(w)
        return jnp.where(jnp.isfinite(value), value, FORBIDDEN)

    return jax.lax.map(one, w, batch_size=LANES)
