"""A tensor grid over a posterior in the whitened logit of the box, and the moments on it."""

from itertools import pairwise
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

from jbw.inference.bridge import FORBIDDEN
from jbw.inference.kernels import Problem, potential_of
from jbw.inference.laplace import LOGIT_PRIOR_PRECISION, Whitening

CHUNK = 1024  # nodes of one compiled call
LANES = 128  # of them side by side
DEEP = 26.0  # nats below the highest node where a grid may end
NARROW = 6.0  # standard deviations of the first window
MOST_WIDENINGS = 12
COARSE = 0.75  # standard deviations between the nodes of the grids that find the moments
MOST_ROUNDS = 14
MOST_COARSE = 400_000
STEADY = 0.03  # change of the moments, in standard deviations, at which they are settled


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

    def log_density(self, problem: Problem, w: NDArray[np.float64]) -> NDArray[np.float64]:
        """Log posterior density at other points of this coordinate."""
        return _log_density(problem, w)


def grid_of(problem: Problem, whitening: Whitening, spacing: float, most: int) -> Grid | None:
    """A grid wide enough that the posterior is 26 nats below its highest node at every side.

    Args:
        problem: The posterior; its own whitening is not used.
        whitening: The coordinate.
        spacing: Between nodes.
        most: Nodes at most.

    Returns:
        The grid; None where it would take more nodes.
    """
    problem = eqx.tree_at(lambda one: one.whitening, problem, whitening)
    d = len(problem.box.names)
    reach = np.full((d, 2), np.ceil(NARROW / spacing), dtype=int)
    for _ in range(MOST_WIDENINGS):
        if np.prod(reach.sum(axis=1) + 1.0) > most:
            return None
        axes = tuple(spacing * np.arange(-low, high + 1) for low, high in reach)
        nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, d)
        log_p = _log_density(problem, nodes)
        open_sides = _open_sides(log_p.reshape([len(axis) for axis in axes]))
        if not np.any(open_sides):
            return Grid(axes, nodes, log_p, whitening, spacing)
        reach = np.where(open_sides, np.ceil(1.35 * reach).astype(int), reach)
    return None


def _open_sides(log_p: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Sides of the grid, lower and upper, at which the posterior has not died out."""
    floor = np.max(log_p) - DEEP
    faces = [
        [np.max(np.take(log_p, side, axis=axis)) > floor for side in (0, -1)]
        for axis in range(log_p.ndim)
    ]
    return np.array(faces)


def settled(problem: Problem) -> tuple[NDArray[np.float64], NDArray[np.float64], int]:
    """Mean and covariance of the posterior's logit, by coarse grids that follow their own moments.

    Args:
        problem: The posterior, whitened as well as anyone knows.

    Returns:
        Mean, covariance, and nodes that were spent.
    """
    centre, factor = (np.asarray(part) for part in problem.whitening)
    if np.array_equal(factor, np.eye(len(centre))):  # nothing is known: the prior's width
        factor = factor / np.sqrt(LOGIT_PRIOR_PRECISION)
    mean, covariance, spent = centre, factor @ factor.T, 0
    for _ in range(MOST_ROUNDS):
        whitening = whitened_by(mean, covariance)
        grid = grid_of(problem, whitening, COARSE, MOST_COARSE)
        if grid is None:  # too wide a tail to follow: what is known will do
            break
        spent += grid.log_p.size
        shift, spread = _moments(grid)
        factor = np.asarray(whitening.factor)
        mean, covariance = mean + factor @ shift, factor @ spread @ factor.T
        if np.max(np.abs(shift)) < STEADY and np.max(np.abs(spread - np.eye(len(mean)))) < STEADY:
            break
    return mean, covariance, spent


def _moments(grid: Grid) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean and covariance of w; no narrower than the nodes can tell."""
    mean = grid.weights @ grid.nodes
    left = grid.nodes - mean
    covariance = (grid.weights[:, None] * left).T @ left
    return mean, covariance + (0.1 * grid.spacing) ** 2 * np.eye(len(mean)) * (
        np.diagonal(covariance) < (0.3 * grid.spacing) ** 2
    )


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


def _log_density(problem: Problem, w: NDArray[np.float64]) -> NDArray[np.float64]:
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
