"""Weighted draws: smooth the weights, count what they are worth, make draws of equal weight."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

SMALLEST = -700.0  # log weight that counts as zero, and is still a number


def smoothed(log_weights: Float[np.ndarray, " draw"]) -> tuple[NDArray[np.float64], float]:
    """Normalised weights, their tail smoothed by a generalised Pareto fit, and its shape k-hat.

    Args:
        log_weights: Raw log weights [nats], minus infinity where there is no weight.

    Returns:
        Weights that sum to one, and k-hat: below 0.7 they can be trusted.

    Reference:
        Vehtari et al. (2024), JMLR 25, 72.
    """
    from arviz_stats.base.array import array_stats  # a second of imports, needed only here

    stats: Any = array_stats  # its annotations admit tuples that it never returns here
    # ArviZ takes the negative of the log weights, as a leave-one-out log likelihood gives them.
    found, khat = stats.psislw(-np.maximum(log_weights - np.max(log_weights), SMALLEST))
    weights = np.exp(found - np.max(found))
    return weights / weights.sum(), float(khat)


def effective_draws(weights: Float[np.ndarray, " draw"]) -> float:
    r"""Effective number of weighted draws.

    $$\left(\sum_i w_i\right)^2 / \sum_i w_i^2$$

    Args:
        weights: Weights of any sum.

    Reference:
        Kish (1965), Survey Sampling.
    """
    return float(np.sum(weights) ** 2 / np.sum(weights**2))


def stratified(
    generator: np.random.Generator, weights: Float[np.ndarray, " draw"], count: int
) -> Int[np.ndarray, " count"]:
    """Indices of draws of equal weight, by stratified resampling, in the order of the draws.

    Copies of a draw stand next to each other: an effective sample size from autocorrelation then
    counts them for what they are worth.

    Args:
        generator: Source of random numbers.
        weights: Weights of any sum.
        count: Indices to draw.
    """
    places = (np.arange(count) + generator.uniform(size=count)) / count
    cumulative = np.cumsum(weights)
    return np.minimum(np.searchsorted(cumulative / cumulative[-1], places), len(weights) - 1)
