r"""Draws of a Gaussian distribution within bounds, even if its mean lies far outside.

$$x = m + L w, \quad L L^T = \Sigma, \qquad
  w_i \sim N(0, 1) \text{ within } [a_i, b_i], \quad
  a_i = \Bigl(l_i - m_i - \sum_{j < i} L_{ij} w_j\Bigr) / L_{ii}, \qquad
  \log p = \sum_i \log\,(\Phi(b_i) - \Phi(a_i))$$

with b by the upper bounds u. Weighted by p, the draws follow the Gaussian within the bounds. The
component that is least likely to lie within its bounds comes first, so that weights are nearly
equal.

Reference:
    Genz (1992), J. Comput. Graph. Stat. 1, 141.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy.special import log_ndtr, ndtri_exp, softmax

Vector = Float[np.ndarray, " parameter"]
Rows = Float[np.ndarray, " draw"]


def draws_within(
    rng: np.random.Generator,
    mean: Vector,
    covariance: Float[np.ndarray, "parameter parameter"],
    lower: Vector,
    upper: Vector,
    count: int,
) -> tuple[Float[np.ndarray, "draw parameter"], Float[np.ndarray, "draw parameter"], Rows]:
    """Draw points of a Gaussian within bounds; return them in normal coordinates, with weights."""
    std = np.sqrt(np.diag(covariance))
    order = np.argsort(log_mass((lower - mean) / std, (upper - mean) / std), kind="stable")
    root = np.linalg.cholesky(covariance[np.ix_(order, order)])
    low, high = (bound[order] - mean[order] for bound in (lower, upper))
    w, log_weight = np.zeros((count, len(mean))), np.zeros(count)
    for i in range(len(mean)):
        before = w[:, :i] @ root[i, :i]
        a, b = (low[i] - before) / root[i, i], (high[i] - before) / root[i, i]
        log_weight += log_mass(a, b)
        w[:, i] = normal_within(rng.random(count), a, b)
    points = np.empty_like(w)
    points[:, order] = mean[order] + w @ root.T
    return points, w, log_weight


def mixture_within(
    rng: np.random.Generator,
    gaussians: Sequence[tuple[float, Vector, Float[np.ndarray, "parameter parameter"]]],
    member: Int[np.ndarray, " draw"],
    lower: Vector,
    upper: Vector,
) -> tuple[Float[np.ndarray, "draw parameter"], Float[np.ndarray, "draw parameter"]]:
    """Draw points of a mixture of Gaussians within bounds; return them in normal coordinates.

    Each Gaussian is given by share, mean and covariance; `member` gives the Gaussian of every point
    before the bounds are applied.
    """
    points, w = (np.zeros((len(member), len(lower))) for _ in range(2))
    log_weight = np.zeros(len(member))
    for number, count in zip(*np.unique(member, return_counts=True), strict=True):
        _, mean, covariance = gaussians[number]
        drawn = draws_within(rng, mean, covariance, lower, upper, count)
        is_member = member == number
        points[is_member], w[is_member], log_weight[is_member] = drawn
    chosen = rng.choice(len(member), len(member), p=softmax(log_weight))
    return points[chosen], w[chosen]


def log_mass(a: Rows, b: Rows) -> Rows:
    r"""Return the logarithm of $\Phi(b) - \Phi(a)$, which is accurate even far out in a tail."""
    # Differences in the lower tail have more digits.
    a, b = np.where(a > 0, -b, a), np.where(a > 0, -a, b)
    return log_ndtr(b) + np.log(-np.expm1(np.minimum(log_ndtr(a) - log_ndtr(b), 0.0)))


def normal_within(share: Rows, a: Rows, b: Rows) -> Rows:
    r"""Return x with $\Phi(x) = \Phi(a) + p\,(\Phi(b) - \Phi(a))$, for fractions p."""
    is_upper = a > 0
    low, high = np.where(is_upper, -b, a), np.where(is_upper, -a, b)
    log_share = np.log(np.maximum(share, np.finfo(float).tiny))
    x = ndtri_exp(np.logaddexp(log_ndtr(low), log_share + log_mass(low, high)))
    return np.clip(np.where(is_upper, -x, x), a, b)
