r"""The result of a calibration: ranks of true values, failures, coverage of intervals, verdict.

N ranks with values 0 ... L are uniform if the count below i follows

$$C_i = \#\{r < i\} \sim \mathrm{Bin}(N,\, i / (L + 1)), \qquad i = 1, \dots, L$$

for all i together. The counts are a Markov chain in i, so the probability that all stay between
pointwise quantiles is a recursion (Säilynoja, Bürkner, Vehtari (2022), Stat. Comput. 32, 32).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float, Int
from numpy.typing import NDArray
from scipy import stats
from scipy.optimize import brentq
from scipy.special import gammaln

from jbw.inference.posterior.finding import Finding, Verdict, checked, judge

MOST_R_HAT = 1.1  # limit of R-hat in one replication, whose chains have only a few hundred draws
MOST_FAILED = 0.01  # largest allowed fraction of failed replications
LEVEL = 0.99  # probability of the intervals, and of the statements on them
LEAST_P = 0.01  # smallest allowed p-value, corrected for the number of tests
NUM_BINS = 20
# A p-value below this one is replaced by an upper bound, the sum of the pointwise tail
# probabilities.
LEAST = 1e-9


class Ranked(NamedTuple):
    """Ranks of the true values among posterior draws, and whether 99 % intervals contain them.

    Further fields are whether all draws are finite, whether the sampler finished, and the largest
    split R-hat.
    """

    rank: Int[Array, "... quantity"]
    inside: Bool[Array, "... quantity"]
    finite: Bool[Array, "..."]
    arrived: Bool[Array, "..."]
    r_hat: Float[Array, "..."]


@dataclass(frozen=True)
class Calibration:
    """The result of many replications of a posterior, by name of the ranked quantity.

    Attributes:
        ranks: Rank of the truth among `num_ranks` draws, from 0 to `num_ranks`, (replication,
            quantity).
        inside: Whether the truth is inside the central 99 % interval, (replication, quantity).
        failures: Whether each replication failed, by reason.
        p_chi_square: p-value of each quantity's ranks in 20 bins.
        p_ecdf: p-value of each quantity's ECDF of ranks, simultaneous over its points.
        coverage: Share of the replications with the truth inside, and its 99 % Clopper-Pearson
            interval.
    """

    names: tuple[str, ...]
    ranks: NDArray[np.int64]
    num_ranks: int
    inside: NDArray[np.bool_]
    failures: dict[str, NDArray[np.bool_]]
    p_chi_square: dict[str, float]
    p_ecdf: dict[str, float]
    coverage: dict[str, tuple[float, float, float]]
    verdict: Verdict

    @property
    def failed(self) -> NDArray[np.bool_]:
        """Whether each replication failed for any reason."""
        return np.any(list(self.failures.values()), axis=0)


def judged(names: tuple[str, ...], replications: Ranked, num_ranks: int) -> Calibration:
    """Test the ranks of all replications, including failed ones, and return the calibration."""
    ranks, inside = np.asarray(replications.rank), np.asarray(replications.inside)
    finite = np.asarray(replications.finite)
    failures = {
        "not finite": ~finite,
        "not arrived": ~np.asarray(replications.arrived),
        # A quantity with NaN draws has no R-hat. Because NaN exceeds no limit, this comparison
        # counts the quantity as failed.
        "not mixed": finite & ~(np.asarray(replications.r_hat) <= MOST_R_HAT),
    }
    columns = dict(zip(names, ranks.T, strict=True))
    p_chi_square = {name: chi_square_p(column, num_ranks) for name, column in columns.items()}
    p_ecdf = {name: ecdf_p(column, num_ranks) for name, column in columns.items()}
    coverage = {
        name: (float(column.mean()), *coverage_interval(int(column.sum()), len(column), LEVEL))
        for name, column in zip(names, inside.T, strict=True)
    }
    findings = (
        _uniform(p_chi_square, p_ecdf),
        _covered(coverage, len(ranks)),
        _came_through(failures),
    )
    return Calibration(
        names, ranks, num_ranks, inside, failures, p_chi_square, p_ecdf, coverage, judge(findings)
    )


def _uniform(p_chi_square: dict[str, float], p_ecdf: dict[str, float]) -> Finding:
    """Return the finding on uniform ranks, from the smallest p-value with Bonferroni's factor."""
    both = [(p, name, "chi-square") for name, p in p_chi_square.items()]
    both += [(p, name, "ECDF") for name, p in p_ecdf.items()]
    p, name, test = min(both)
    p = min(1.0, p * len(both))
    values = {"name": name, "p": p, "test": test, "count": len(both), "limit": LEAST_P}
    return checked("calibration_ranks", p >= LEAST_P, values, p)


def _covered(coverage: dict[str, tuple[float, float, float]], count: int) -> Finding:
    """Return the finding on whether 99 % intervals contain 99 % of the true values."""
    corrected = 1 - (1 - LEVEL) / len(coverage)
    shares = {name: estimate[0] for name, estimate in coverage.items()}
    for name in (min(shares, key=shares.__getitem__), max(shares, key=shares.__getitem__)):
        share = shares[name]
        low, high = coverage_interval(round(share * count), count, corrected)
        if not low <= LEVEL <= high:
            values = {"name": name, "share": share, "count": count, "low": low, "high": high}
            return checked("calibration_coverage", False, values, share)
    share = min(shares.values())
    return Finding("calibration_coverage", "ok", {"share": share, "count": count}, share)


def _came_through(failures: dict[str, NDArray[np.bool_]]) -> Finding:
    counted = [f"{int(np.sum(failed))} {reason}" for reason, failed in failures.items()]
    share = float(np.mean(np.any(list(failures.values()), axis=0)))
    values = {"share": share, "counted": counted, "limit": MOST_FAILED}
    return checked("calibration_failures", share <= MOST_FAILED, values, share)


def chi_square_p(ranks: Int[np.ndarray, " replication"], num_ranks: int) -> float:
    """Return the p-value of Pearson's chi-square test of the ranks in about 20 bins."""
    bins = np.array_split(np.arange(num_ranks + 1), min(NUM_BINS, num_ranks + 1))
    expected = len(ranks) * np.array([len(bin_ranks) for bin_ranks in bins]) / (num_ranks + 1)
    edges = [bin_ranks[0] for bin_ranks in bins] + [num_ranks + 1]
    observed = np.histogram(ranks, edges)[0]
    return float(stats.chi2.sf(np.sum((observed - expected) ** 2 / expected), len(bins) - 1))


def counts_below(
    ranks: Int[np.ndarray, " replication"], num_ranks: int
) -> Int[np.ndarray, " rank"]:
    """Return the number of ranks below i, for i = 1 ... L, from ranks between 0 and L."""
    return np.searchsorted(np.sort(ranks), np.arange(1, num_ranks + 1), side="left")


def ecdf_p(ranks: Int[np.ndarray, " replication"], num_ranks: int) -> float:
    r"""Return the p-value of the largest deviation of the ranks' ECDF from a uniform one.

    $$\gamma = \min_i 2 \min\{P(C_i \le c_i),\, P(C_i \ge c_i)\}$$
    """
    law = _law(len(ranks), num_ranks)
    counts = counts_below(ranks, num_ranks)
    gamma = float(np.min(2 * np.minimum(law.cdf(counts), law.sf(counts - 1))))
    if gamma * num_ranks < LEAST:
        return gamma * num_ranks
    # Counts that are less extreme than gamma lie inside the band. The factor prevents rounding from
    # counting gamma itself as inside.
    return 1 - _stays_inside(len(ranks), num_ranks, gamma * (1 + 1e-9))


def ecdf_envelope(
    num_replications: int, num_ranks: int, level: float = 0.99
) -> tuple[Float[np.ndarray, " rank"], Float[np.ndarray, " rank"]]:
    """Return bounds that the ECDF of uniform ranks stays within, with probability `level`."""

    def excess(log_gamma: float) -> float:
        return _stays_inside(num_replications, num_ranks, float(np.exp(log_gamma))) - level

    # The search runs between two levels: at Bonferroni's level the bounds are too wide, and at the
    # level of a single point the bounds are too narrow.
    least = np.log((1 - level) / num_ranks) - 1.0
    most = 0.0 if num_ranks == 1 else np.log(1 - level) + 0.1
    root: float = brentq(excess, least, most, xtol=1e-3)  # pyright: ignore
    # Counts are discrete, so the bisection may end on the wrong side of a jump.
    lower, upper = _bounds(num_replications, num_ranks, float(np.exp(root - 2e-3)))
    return lower / num_replications, upper / num_replications


def coverage_interval(inside: int, count: int, level: float = 0.99) -> tuple[float, float]:
    """Return the Clopper-Pearson interval of a probability, from `inside` of `count` cases."""
    interval = stats.binomtest(inside, count).proportion_ci(level, method="exact")
    return float(interval.low), float(interval.high)


def _law(num_replications: int, num_ranks: int) -> stats.distributions.rv_frozen:
    return stats.binom(num_replications, np.arange(1, num_ranks + 1) / (num_ranks + 1))


def _bounds(
    num_replications: int, num_ranks: int, gamma: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the bounds beyond each of which a count lies with probability gamma/2 at most."""
    law = _law(num_replications, num_ranks)
    lower, upper = law.ppf(gamma / 2), law.isf(gamma / 2)
    # The quantile of a discrete distribution is the wanted bound or a neighbouring count.
    lower = np.where(2 * law.cdf(lower) < gamma, lower + 1, lower)
    upper = np.where(2 * law.sf(upper - 1) < gamma, upper - 1, upper)
    return np.maximum(lower, 0), np.minimum(upper, num_replications)


def _stays_inside(num_replications: int, num_ranks: int, gamma: float) -> float:
    """Return the probability that all counts of uniform ranks stay between their bounds."""
    lower, upper = (side.astype(int) for side in _bounds(num_replications, num_ranks, gamma))
    log_factorial = gammaln(np.arange(num_replications + 1) + 1.0)
    count, p = np.array([0]), np.array([1.0])
    for i in range(num_ranks):
        next_count = np.arange(lower[i], upper[i] + 1)
        step, remaining = next_count - count[:, None], (num_replications - count)[:, None]
        # probability that a rank has value i, given that it has no smaller value
        share = 1 / (num_ranks + 1 - i)
        possible = (step >= 0) & (step <= remaining)
        k = np.where(possible, step, 0)
        log_p = log_factorial[remaining] - log_factorial[k] - log_factorial[remaining - k]
        log_p = log_p + k * np.log(share) + (remaining - k) * np.log1p(-share)
        count, p = next_count, p @ np.where(possible, np.exp(log_p), 0.0)
    return float(np.sum(p))
