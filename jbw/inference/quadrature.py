"""The posterior by quadrature: exact to a stated error, for up to four parameters."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from jbw.errors import ConfigError
from jbw.inference.annealing import Settled, settled
from jbw.inference.bridge import Drawn
from jbw.inference.grid import Grid, grid_of, log_density_at, whitened_by
from jbw.inference.kernels import Problem
from jbw.inference.laplace import from_logit
from jbw.inference.marginal import Marginal, marginal
from jbw.inference.weights import stratified

MOST_PARAMETERS = 4
MOST_NODES = 6_000_000  # of one grid
HALVINGS = 7.0  # of the spacing at most
ENOUGH = 1e-7  # change of log evidence, and of means and deviations over the deviation
PROBABILITIES = (0.005, 0.01, 0.05, 0.5, 0.95, 0.99, 0.995)


class Exact(NamedTuple):
    """What one spacing of the nodes gives."""

    log_evidence: float
    marginals: tuple[Marginal, ...]
    grid: Grid
    num_nodes: int


def quadrature_draws(
    key: Key[Array, ""], problem: Problem, num_samples: int, num_chains: int
) -> Drawn:
    r"""Posterior by the trapezoidal rule in the whitened logit of the box.

    $$Z = |\det L|\, h^d \sum_{n \in \mathbb{Z}^d} p(w = h n)$$

    The density vanishes smoothly to all sides there, bounds of the box included, so that the rule
    converges exponentially in 1 / h. The whitening is that of the posterior's own moments, found
    from the whole prior down, without any start. Nodes are refined by a factor of root two until
    log evidence, means and standard deviations change by less than 1e-7 (of the deviation), or
    memory ends; the last change is the stated error, of which the finer grid keeps a fraction.
    Each parameter has a grid of its own along its axis, which gives its distribution function and
    quantiles. A mode is overlooked that is a few times narrower than the first spacing: a tenth of
    the posterior's deviation for two parameters, a third for three, two thirds for four. A thin
    ridge that bends through the box takes more nodes than there are: the stated error is then
    large, and the verdict fails.

    Args:
        key: Random key.
        problem: The posterior, of four parameters at most.
        num_samples: Draws of each chain.
        num_chains: Groups of independent draws.

    Returns:
        Draws by the inverse distribution function of the grid, exact by weights for the density
        inside its cells; group `exact` with mean, sd and quantiles.

    Raises:
        ConfigError: More than four parameters.

    Reference:
        Trefethen, Weideman (2014), SIAM Review 56, 385.
    """
    names = problem.box.names
    if len(names) > MOST_PARAMETERS:
        raise ConfigError(
            f"Sampler quadrature takes at most {MOST_PARAMETERS} parameters, but the posterior has "
            f"{len(names)}.",
            remedy="Compare with nested or tempered_smc, which give the evidence too.",
        )
    start = settled(problem)
    found, error = _refined(problem, start)
    draws, tried = _draws(key, problem, found.grid, num_samples * num_chains)
    theta = from_logit(jnp.asarray(draws), problem.box)
    shape = (num_chains, num_samples)
    return Drawn(
        {name: np.asarray(values).reshape(shape) for name, values in theta.items()},
        {},
        {
            "log_evidence": found.log_evidence,
            "log_evidence_error": error,
            "quadrature_error": error,
            "num_nodes": found.num_nodes,
            "num_evaluations": start.num_nodes + found.num_nodes + tried,
        },
        {"exact": _table(found, names)},
    )


def _table(found: Exact, names: tuple[str, ...]) -> dict[str, tuple[tuple[str, ...], object]]:
    quantiles = np.array([one.quantiles for one in found.marginals])
    return {
        "parameter": (("parameter",), np.array(names)),
        "probability": (("probability",), np.array(PROBABILITIES)),
        "mean": (("parameter",), np.array([one.mean for one in found.marginals])),
        "sd": (("parameter",), np.array([one.sd for one in found.marginals])),
        "quantiles": (("parameter", "probability"), quantiles),
    }


def _refined(problem: Problem, start: Settled) -> tuple[Exact, float]:
    """The finest grids that are needed, or that fit, and the change that they brought."""
    last, error = None, float("inf")
    for halvings in np.arange(0.0, HALVINGS, 0.5):
        found = _exact(problem, start, start.spacing / 2**halvings)
        if found is None:
            break
        if last is not None:
            error = _change(last, found)
        last = found
        if error < ENOUGH:
            break
    if last is None or not np.isfinite(error):
        raise ConfigError(
            f"Quadrature of this posterior takes more than {MOST_NODES:,} nodes.",
            why="Its tails are long in some direction, so that the grid is wide.",
            remedy="Narrow the prior, or compare with nested or tempered_smc.",
        )
    return last, error


def _change(before: Exact, after: Exact) -> float:
    parts = [abs(after.log_evidence - before.log_evidence)]
    for old, new in zip(before.marginals, after.marginals, strict=True):
        parts += [abs(new.mean - old.mean) / new.sd, abs(new.sd / old.sd - 1)]
    return float(np.max(parts))


def _exact(problem: Problem, start: Settled, spacing: float) -> Exact | None:
    grids, marginals = [], []
    for i in range(len(problem.box.names)):
        whitening = whitened_by(start.mean, start.covariance, first=i)
        grid = grid_of(problem, whitening, spacing, MOST_NODES)
        if grid is None:
            return None
        grids.append(grid)
        marginals.append(marginal(grid, i, problem.box, PROBABILITIES))
    evidence = float(np.mean([grid.log_evidence for grid in grids]))
    return Exact(evidence, tuple(marginals), grids[-1], sum(grid.log_p.size for grid in grids))


def _draws(
    key: Key[Array, ""], problem: Problem, grid: Grid, count: int
) -> tuple[Float[np.ndarray, "draw parameter"], int]:
    """Logits drawn cell by cell, and weighed by the density where they fell in the cell."""
    generator = np.random.default_rng(np.asarray(jax.random.key_data(key)))
    p = grid.weights
    order = generator.permutation(p.size)
    cells = order[stratified(generator, p[order], count)]
    generator.shuffle(cells)
    moved = generator.uniform(-0.5, 0.5, (count, grid.nodes.shape[1])) * grid.spacing
    w = grid.nodes[cells] + moved
    problem = eqx.tree_at(lambda one: one.whitening, problem, grid.whitening)
    log_ratio = log_density_at(problem, w) - grid.log_p[cells]
    kept = stratified(generator, np.exp(log_ratio - np.max(log_ratio)), count)
    centre, factor = (np.asarray(part) for part in grid.whitening)
    return centre + w[kept] @ factor.T, count
