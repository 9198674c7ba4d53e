"""The posterior by quadrature: exact to a stated error, for up to four parameters."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from jbw.errors import ConfigError
from jbw.inference.annealing import Settled, settled
from jbw.inference.bridge import Drawn
from jbw.inference.grid import Grid, grid_of, log_density_at
from jbw.inference.kernels import Problem
from jbw.inference.laplace import from_logit
from jbw.inference.marginal import Marginal, marginal
from jbw.inference.weights import stratified

MOST_PARAMETERS = 4
MOST_NODES = 6_000_000  # of one grid
HALVINGS = 7.0  # of the spacing at most
GOOD = 1e-3  # error beyond which bends are looked for
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
    r"""Posterior by the trapezoidal rule in a straightened coordinate of the logit of the box.

    $$Z = h^d \sum_{n \in \mathbb{Z}^d} p(y = h n)$$

    The density vanishes smoothly to all sides there, bounds of the box included, so that the rule
    converges exponentially in 1 / h. The coordinate takes out the posterior's correlations,
    and its bends where that is not enough, found from the whole prior down, without any start.
    Nodes are refined by a factor of root two until
    log evidence, means and standard deviations change by less than 1e-7 (of the deviation), or
    memory ends; the last change is the stated error, of which the finer grid keeps a fraction.
    Each parameter has a grid of its own along its axis, which gives its distribution function and
    quantiles. A mode is overlooked that is a few times narrower than the first spacing: a tenth of
    the posterior's deviation for two parameters, a third for three, two thirds for four.

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
    found, error, spent = _best(problem)
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
            "num_evaluations": spent + found.num_nodes + tried,
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


def _best(problem: Problem) -> tuple[Exact, float, int]:
    """The answer, its error, and nodes spent besides: bends only where they are needed."""
    start = settled(problem, bends=False)
    found, error = _refined(problem, start)
    spent = start.num_nodes
    if len(problem.box.names) > 1 and (found is None or error > GOOD):
        start = settled(problem, bends=True)
        bent, bent_error = _refined(problem, start)
        spent += start.num_nodes
        if bent is not None and bent_error < error:
            found, error = bent, bent_error
    if found is None or not np.isfinite(error):
        raise ConfigError(
            f"Quadrature of this posterior takes more than {MOST_NODES:,} nodes.",
            why="It is too narrow a ridge, or has long tails.",
            remedy="Narrow the prior, or compare with nested or tempered_smc.",
        )
    return found, error, spent


def _refined(problem: Problem, start: Settled) -> tuple[Exact | None, float]:
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
    return last, error


def _change(before: Exact, after: Exact) -> float:
    parts = [abs(after.log_evidence - before.log_evidence)]
    for old, new in zip(before.marginals, after.marginals, strict=True):
        parts += [abs(new.mean - old.mean) / new.sd, abs(new.sd / old.sd - 1)]
    return float(np.max(parts))


def _exact(problem: Problem, start: Settled, spacing: float) -> Exact | None:
    grids, marginals = [], []
    for i in range(len(problem.box.names)):
        grid = grid_of(problem, start.place(i), spacing, MOST_NODES)
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
    y = grid.nodes[cells] + moved
    log_ratio = log_density_at(problem, grid.place, y) - grid.log_p[cells]
    kept = stratified(generator, np.exp(log_ratio - np.max(log_ratio)), count)
    return grid.place.logit(y[kept]), count
