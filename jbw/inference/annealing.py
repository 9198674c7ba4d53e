"""Where a posterior lies: moments on grids that shrink from the prior as the likelihood rises."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.optimize import brentq

from jbw.inference.bridge import FORBIDDEN, require_possible
from jbw.inference.grid import Grid, grid_within
from jbw.inference.kernels import Problem
from jbw.inference.laplace import LOGIT_PRIOR_PRECISION
from jbw.inference.straightening import Straight, round_about, straightened
from jbw.inference.weights import effective_draws

REACH = 6.0  # standard deviations to either side
NODES = {1: 128, 2: 80, 3: 40, 4: 20}  # along each coordinate, by the number of parameters
SHRINK = 0.4  # share of the effective nodes that a rise of the power leaves
MOST_ROUNDS = 120
RESOLVED = 0.3  # of a spacing: what is narrower a grid cannot tell
STEADY = 0.03  # change of the moments, in standard deviations, at which they are settled


class Settled(NamedTuple):
    """Where a posterior lies, as a logit of the unit box.

    Attributes:
        z: Nodes of the last grid.
        weights: Their share of the posterior.
        least: Least scale of each parameter that this grid could tell.
        spacing: Between its nodes, in standard deviations.
        num_nodes: Nodes that were spent on all grids.
        bends: Whether the coordinate follows the posterior's bends.
    """

    z: Float[np.ndarray, "node parameter"]
    weights: Float[np.ndarray, " node"]
    least: Float[np.ndarray, " parameter"]
    spacing: float
    num_nodes: int
    bends: bool

    def place(self, first: int) -> Straight:
        """The coordinate whose first axis moves one parameter alone."""
        d = self.z.shape[1]
        order = (first, *(i for i in range(d) if i != first))
        return straightened(self.z, self.weights, order, self.least, bends=self.bends)


def settled(problem: Problem, *, bends: bool) -> Settled:
    r"""Where a posterior lies, from the prior down.

    $$p_\beta \propto \pi\, L^\beta, \qquad 0 < \beta_1 < \dots \le 1$$

    Every grid is straightened by the nodes of the one before, and its power is so high that four
    tenths of the effective nodes are left: separate modes keep their share until the end.

    Args:
        problem: The posterior; its whitening is not used.
        bends: Whether the coordinate follows the posterior's bends, or its correlations alone.

    Raises:
        ModelError: The posterior is impossible at every node.
    """
    d = len(problem.box.names)
    spacing = 2 * REACH / NODES[d]
    reach = np.full((d, 2), NODES[d] // 2)
    place = round_about(np.zeros(d), np.full(d, LOGIT_PRIOR_PRECISION**-0.5))
    power, spent = 0.0, 0
    for rounds in range(1, MOST_ROUNDS + 1):
        grid = grid_within(problem, place, spacing, reach)
        spent += grid.log_p.size
        power, log_share = _raised(grid, power)
        found = grid._replace(log_p=log_share)
        z, least = place.logit(grid.nodes), np.empty(d)
        least[list(place.order)] = RESOLVED * spacing * np.array(place.scales)
        last = Settled(z, found.weights, least, spacing, spent, bends)
        if (power == 1 and _round(found)) or rounds == MOST_ROUNDS:
            break
        place = last.place(0)
    return last


def _round(grid: Grid) -> bool:
    """Whether the posterior is centred, round and of unit width in the grid's coordinate."""
    shift = grid.weights @ grid.nodes
    left = grid.nodes - shift
    spread = (grid.weights[:, None] * left).T @ left
    return bool(max(np.max(np.abs(shift)), np.max(np.abs(spread - np.eye(len(shift))))) < STEADY)


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
    """Log density of y under the uniform box: logistic in the logit."""
    z = grid.place.logit(grid.nodes)
    return grid.place.log_slope - np.sum(np.abs(z) + 2 * np.log1p(np.exp(-np.abs(z))), axis=1)
