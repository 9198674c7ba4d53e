r"""Are ranks uniform? The exact simultaneous envelope of their ECDF, and the chi-square of bins.

N ranks of values 0 ... L are uniform when the count below i follows

$$C_i = \#\{r < i\} \sim \mathrm{Bin}(N,\, i / (L + 1)), \qquad i = 1, \dots, L$$

at every i together. The counts are a Markov chain in i, so the probability that all of them stay
between pointwise quantiles is a recursion and no simulation.
"""

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray
from scipy import stats
from scipy.optimize import brentq
from scipy.special import gammaln

NUM_BINS = 20
LEAST = 1e-9  # below, the sum of the pointwise tails is the p-value, an upper bound


def chi_square_p(ranks: Int[np.ndarray, " replication"], num_ranks: int) -> float:
    """p-value of Pearson's chi-square of the ranks in about 20 bins."""
    bins = np.array_split(np.arange(num_ranks + 1), min(NUM_BINS, num_ranks + 1))
    expected = len(ranks) * np.array([len(one) for one in bins]) / (num_ranks + 1)
    edges = [one[0] for one in bins] + [num_ranks + 1]
    observed = np.histogram(ranks, edges)[0]
    return float(stats.chi2.sf(np.sum((observed - expected) ** 2 / expected), len(bins) - 1))


def counts_below(
    ranks: Int[np.ndarray, " replication"], num_ranks: int
) -> Int[np.ndarray, " rank"]:
    """C_i of i = 1 ... L.

    Args:
        ranks: Each between 0 and `num_ranks`.
        num_ranks: L.
    """
    return np.searchsorted(np.sort(ranks), np.arange(1, num_ranks + 1), side="left")


def ecdf_p(ranks: Int[np.ndarray, " replication"], num_ranks: int) -> float:
    r"""p-value of the ECDF's most extreme point, simultaneous over all points.

    $$\gamma = \min_i 2 \min\{P(C_i \le c_i),\, P(C_i \ge c_i)\}$$

    Returns:
        Probability of a gamma as small or smaller for uniform ranks.

    Reference:
        Säilynoja, Bürkner, Vehtari (2022), Statistics and Computing 32, 32.
    """
    law = _law(len(ranks), num_ranks)
    found = counts_below(ranks, num_ranks)
    gamma = float(np.min(2 * np.minimum(law.cdf(found), law.sf(found - 1))))
    if gamma * num_ranks < LEAST:
        return gamma * num_ranks
    # Inside are the counts less extreme than gamma; its own rounding must not let it in.
    return 1 - _stays_inside(len(ranks), num_ranks, gamma * (1 + 1e-9))


def ecdf_envelope(
    num_replications: int, num_ranks: int, level: float = 0.99
) -> tuple[Float[np.ndarray, " rank"], Float[np.ndarray, " rank"]]:
    """Least and greatest ECDF at every i that uniform ranks keep to with probability `level`.

    Args:
        num_replications: N.
        num_ranks: L.
        level: Simultaneous probability.

    Returns:
        Lower and upper envelope of C_i / N, for i = 1 ... L.

    Reference:
        Säilynoja, Bürkner, Vehtari (2022), Statistics and Computing 32, 32.
    """

    def excess(log_gamma: float) -> float:
        return _stays_inside(num_replications, num_ranks, float(np.exp(log_gamma))) - level

    # Bonferroni's bound is safe; one point alone is not enough.
    least = np.log((1 - level) / num_ranks) - 1.0
    most = 0.0 if num_ranks == 1 else np.log(1 - level) + 0.1
    root: float = brentq(excess, least, most, xtol=1e-3)  # pyright: ignore
    # Counts are discrete: the bisection may end on the wrong side of a step.
    lower, upper = _bounds(num_replications, num_ranks, float(np.exp(root - 2e-3)))
    return lower / num_replications, upper / num_replications


def coverage_interval(inside: int, count: int, level: float = 0.99) -> tuple[float, float]:
    """Clopper-Pearson interval of a probability."""
    found = stats.binomtest(inside, count).proportion_ci(level, method="exact")
    return float(found.low), float(found.high)


def _law(num_replications: int, num_ranks: int) -> stats.distributions.rv_frozen:
    share = np.arange(1, num_ranks + 1) / (num_ranks + 1)
    return stats.binom(num_replications, share)


def _bounds(
    num_replications: int, num_ranks: int, gamma: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Counts of which neither tail's probability, doubled, is below gamma."""
    law = _law(num_replications, num_ranks)
    lower, upper = law.ppf(gamma / 2), law.isf(gamma / 2)
    # Quantiles of a discrete law: the count itself, or its neighbour.
    lower = np.where(2 * law.cdf(lower) < gamma, lower + 1, lower)
    upper = np.where(2 * law.sf(upper - 1) < gamma, upper - 1, upper)
    return np.maximum(lower, 0), np.minimum(upper, num_replications)


def _stays_inside(num_replications: int, num_ranks: int, gamma: float) -> float:
    """Probability that all counts stay between their bounds."""
    lower, upper = (side.astype(int) for side in _bounds(num_replications, num_ranks, gamma))
    log_factorial = gammaln(np.arange(num_replications + 1) + 1.0)
    here, p = np.array([0]), np.array([1.0])
    for i in range(num_ranks):
        there = np.arange(lower[i], upper[i] + 1)
        step, left = there - here[:, None], (num_replications - here)[:, None]
        share = 1 / (num_ranks + 1 - i)  # of those not yet counted
        possible = (step >= 0) & (step <= left)
        k = np.where(possible, step, 0)
        log_p = log_factorial[left] - log_factorial[k] - log_factorial[left - k]
        log_p = log_p + k * np.log(share) + (left - k) * np.log1p(-share)
        here, p = there, p @ np.where(possible, np.exp(log_p), 0.0)
    return float(np.sum(p))
