"""The record of a calibration: ranks, failures, coverage, p-values and the verdict."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float, Int
from numpy.typing import NDArray

from jbw.inference.calibration.uniformity import chi_square_p, coverage_interval, ecdf_p
from jbw.inference.posterior.finding import Finding, Verdict, checked, judge

MOST_R_HAT = 1.1  # of the chains of one replication, each a few hundred draws long
MOST_FAILED = 0.01  # share of the replications
LEVEL = 0.99  # of the intervals, and of what is said about them
LEAST_P = 0.01  # of all p-values together


class Ranked(NamedTuple):
    """What one replication gave, or many along a leading axis.

    Attributes:
        rank: Draws below the truth, of each quantity.
        inside: Whether the truth is inside the central 99 % of the draws.
        finite: Whether all draws and quantities are numbers.
        arrived: Whether the sampler came to its end.
        r_hat: The largest split R-hat of all quantities.
    """

    rank: Int[Array, "... quantity"]
    inside: Bool[Array, "... quantity"]
    finite: Bool[Array, "..."]
    arrived: Bool[Array, "..."]
    r_hat: Float[Array, "..."]


@dataclass(frozen=True)
class Calibration:
    """What many replications say of a posterior.

    Attributes:
        names: Quantities.
        ranks: Rank of the truth among `num_ranks` draws, (replication, quantity).
        num_ranks: L; a rank is between 0 and L.
        inside: Whether the truth is inside the central 99 % interval, (replication, quantity).
        failures: Reason to whether each replication failed by it.
        p_chi_square: Of the ranks in 20 bins, each quantity.
        p_ecdf: Of the ranks' ECDF, simultaneous over its points, each quantity.
        coverage: Share of the replications inside, and its 99 % Clopper-Pearson interval.
        verdict: ok, failed or not assessed, with reasons.
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
        """Whether each replication failed, for whatever reason."""
        return np.any(list(self.failures.values()), axis=0)


def judged(names: tuple[str, ...], found: Ranked, num_ranks: int) -> Calibration:
    """Test the ranks of all replications, those that failed among them.

    Args:
        names: Quantities.
        found: Ranks and failures of every replication.
        num_ranks: L.

    Returns:
        The calibration.
    """
    ranks, inside = np.asarray(found.rank), np.asarray(found.inside)
    finite = np.asarray(found.finite)
    failures = {
        "not finite": ~finite,
        "not arrived": ~np.asarray(found.arrived),
        # Of draws that are no numbers there is no R-hat, and NaN is above no limit.
        "not mixed": finite & ~(np.asarray(found.r_hat) <= MOST_R_HAT),
    }
    columns = dict(zip(names, ranks.T, strict=True))
    p_chi_square = {name: chi_square_p(column, num_ranks) for name, column in columns.items()}
    p_ecdf = {name: ecdf_p(column, num_ranks) for name, column in columns.items()}
    coverage = {}
    for name, column in zip(names, inside.T, strict=True):
        low, high = coverage_interval(int(column.sum()), len(column), LEVEL)
        coverage[name] = float(column.mean()), low, high
    findings = (
        _uniform(p_chi_square, p_ecdf),
        _covered(coverage, len(ranks)),
        _came_through(failures),
    )
    return Calibration(
        names, ranks, num_ranks, inside, failures, p_chi_square, p_ecdf, coverage, judge(findings)
    )


def _uniform(p_chi_square: dict[str, float], p_ecdf: dict[str, float]) -> Finding:
    """The least p-value times their number, by Bonferroni."""
    both = [(p, name, "chi-square") for name, p in p_chi_square.items()]
    both += [(p, name, "ECDF") for name, p in p_ecdf.items()]
    p, name, test = min(both)
    p = min(1.0, p * len(both))
    return checked(
        "calibration_ranks",
        p >= LEAST_P,
        f"The ranks of {name} are the least uniform: p = {p:.2g} by the {test}, the least of "
        f"{len(both)} times their number; it must be at least {LEAST_P:g}.",
        p,
        "Look at the figure: a slope is a bias, a hump too wide an interval, a trough too narrow "
        "a one.",
    )


def _covered(coverage: dict[str, tuple[float, float, float]], count: int) -> Finding:
    """Whether 99 % intervals hold 99 % of the truths, the worst quantity first."""
    corrected = 1 - (1 - LEVEL) / len(coverage)
    worst = min(coverage, key=lambda name: coverage[name][0])
    widest = max(coverage, key=lambda name: coverage[name][0])
    for name in (worst, widest):
        share = coverage[name][0]
        low, high = coverage_interval(round(share * count), count, corrected)
        if not low <= LEVEL <= high:
            return checked(
                "calibration_coverage",
                False,
                f"The 99 % interval of {name} holds the truth in {share:.2%} of {count} "
                f"replications, which says {low:.2%} to {high:.2%}.",
                share,
                "Do not quote these intervals as 99 %.",
            )
    share = coverage[worst][0]
    reason = f"The 99 % intervals hold the truth in {share:.2%} of {count} or more, by quantity."
    return Finding("calibration_coverage", "ok", reason, share)


def _came_through(failures: dict[str, NDArray[np.bool_]]) -> Finding:
    counts = {reason: int(np.sum(each)) for reason, each in failures.items()}
    share = float(np.mean(np.any(list(failures.values()), axis=0)))
    told = ", ".join(f"{count} {reason}" for reason, count in counts.items())
    return checked(
        "calibration_failures",
        share <= MOST_FAILED,
        f"{share:.2%} of the replications failed ({told}); it must be below {MOST_FAILED:.0%}.",
        share,
        "Use a sampler that crosses this posterior, or give it more draws.",
    )
