"""Where a posterior lies: moments on grids that shrink from the prior as the likelihood rises."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.optimize import brentq

from jbw.inference.bridge import FORBIDDEN, require_possible
from jbw.inference.grid import Grid, grid_within, whitened_by
from jbw.inference.kernels import Problem
from jbw.inference.laplace import LOGIT_PRIOR_PRECISION
from jbw.inference.weights import effective_draws

REACH = 6.0  # standard deviations to either side
NODES = {1: 128, 2: 80, 3: 40, 4: 20}  # along each coordinate, by the number of parameters
SHRINK = 0.4  # share of the effective nodes that a rise of the power leaves
MOST_ROUNDS = 120
MOST_WHOLE = 8  # rounds on the posterior itself: on a thin bend the moments never settle
STEADY = 0.03  # change of the moments, in standard deviations, at which they are settled


class Settled(NamedTuple):
    """Where a posterior lies, as a logit of the unit box.

    Attributes:
        mean: Of the logit.
        covariance: Of the logit.
        spacing: Between the nodes that showed it, in standard deviations.
        num_nodes: Nodes that were spent.
    """

    mean: Float[np.ndarray, " parameter"]
    covariance: Float[np.ndarray, "parameter parameter"]
    spacing: float
    num_nodes: int


def settled(problem: Problem) -> Settled:
    r"""Mean and covariance of a posterior's logit, from the prior down.

    $$p_\beta \propto \pi\, L^\beta, \qquad 0 < \beta_1 < \dots \le 1$$

    Every grid is whitened by the moments of the one before, and its power is so high that four
    tenths of the effective nodes are left: separate modes keep their share until the end.

    Args:
        problem: The posterior; its whitening is not used.

    Raises:
        ModelError: The posterior is impossible at every node.
    """
    d = len(problem.box.names)
    spacing = 2 * REACH / NODES[d]
    reach = np.full((d, 2), NODES[d] // 2)
    mean, covariance = np.zeros(d), np.eye(d) / LOGIT_PRIOR_PRECISION
    power, spent, whole = 0.0, 0, 0
    for _ in range(MOST_ROUNDS):
        grid = grid_within(problem, whitened_by(mean, covariance), spacing, reach)
        spent += grid.log_p.size
        power, log_share = _raised(grid, power)
        shift, spread = _moments(grid._replace(log_p=log_share))
        factor = np.asarray(grid.whitening.factor)
        mean, covariance = mean + factor @ shift, factor @ spread @ factor.T
        still = np.max(np.abs(shift)) < STEADY and np.max(np.abs(spread - np.eye(d))) < STEADY
        whole += power == 1
        if (whole and still) or whole == MOST_WHOLE:
            break
    return Settled(mean, covariance, spacing, spent)


def _raised(grid: Grid, power: float) -> tuple[float, NDArray[np.float64]]:
    """A higher power of the likelihood that the grid still resolves, and log p at it."""
    prior = _log_prior(grid)
    likelihood = grid.log_p - prior
    require_possible(bool(np.max(grid.log_p) > FORBIDDEN / 2))

    def left(power: float) -> float:
        log_p = prior + power * likelihood
        return effective_draws(np.exp(log_p - np.max(log_p)))

    least = SHRINK * left(power)
    if left(1.0) < least:
        # The root is sought in the logarithm: the first powers are small beyond guessing.
        low = np.log(power) if power > 0 else -60.0
        root: Any = brentq(lambda t: left(np.exp(t)) - least, low, 0.0)
        power = float(np.exp(root))
    else:
        power = 1.0
    return power, prior + power * likelihood


def _log_prior(grid: Grid) -> NDArray[np.float64]:
    """Log density of w under the uniform box: logistic in the logit."""
    centre, factor = (np.asarray(part) for part in grid.whitening)
    z = centre + grid.nodes @ factor.T
    slope = np.linalg.slogdet(factor)[1]
    return slope - np.sum(np.abs(z) + 2 * np.log1p(np.exp(-np.abs(z))), axis=1)


def _moments(grid: Grid) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean and covariance of w; no narrower than the nodes can tell."""
    mean = grid.weights @ grid.nodes
    left = grid.nodes - mean
    covariance = (grid.weights[:, None] * left).T @ left
    values, vectors = np.linalg.eigh(covariance)
    return mean, vectors * np.maximum(values, (0.3 * grid.spacing) ** 2) @ vectors.T
