"""What the data taught: Kullback-Leibler divergence of a posterior from the uniform prior."""

import math

import numpy as np
from jaxtyping import Float
from scipy.special import digamma, log_ndtr, ndtri
from scipy.stats import rankdata

Draws = Float[np.ndarray, " draw"]


def kl_from_uniform(x: Draws, window: int | None = None) -> float:
    r"""Divergence of a marginal posterior from U[0, 1] by m-spacings.

    $$D = -h(x), \qquad \hat h = \frac1n \sum_i \left[\log(x_{(i+m)} - x_{(i-m)})
    - \psi(k_i) + \psi(n + 1)\right]$$

    Ranks are cut at 1 and n, and k_i counts the gaps spanned. The digamma terms, in place of
    Vasicek's log(2m/n), make the estimate free of bias for uniform draws.

    Args:
        x: Draws in the unit coordinate, in any order. Repeated draws count; infinite where one
            value repeats more than 2m times.
        window: m; the nearest integer to sqrt(n) when None.

    Returns:
        Divergence [nats], slightly negative at times for draws from the prior.

    Reference:
        Section 3.2; Vasicek (1976), J. R. Stat. Soc. B 38, 54.
    """
    n = len(x)
    m = max(1, round(math.sqrt(n))) if window is None else window
    ordered = np.sort(x)
    rank = np.arange(n)
    last, first = np.minimum(rank + m, n - 1), np.maximum(rank - m, 0)
    with np.errstate(divide="ignore"):
        log_spacing = np.log(ordered[last] - ordered[first])
    return float(-np.mean(log_spacing - digamma(last - first) + digamma(n + 1)))


def joint_kl_from_uniform(x: Float[np.ndarray, "draw parameter"]) -> float:
    r"""Divergence of the joint posterior from the uniform box, through a Gaussian copula.

    $$D = \sum_i D_i - \tfrac12 \log\det R$$

    R is the correlation matrix of the normal scores of the ranks. Exact for a Gaussian posterior
    inside the box and for independent parameters of any shape; a lower bound otherwise in the
    sense that it sees only the dependence that ranks' normal scores show.

    Args:
        x: Draws in the unit coordinate.

    Returns:
        Divergence [nats].
    """
    n, d = x.shape
    scores = ndtri((rankdata(x, axis=0) - 0.5) / n)
    correlation = np.atleast_2d(np.corrcoef(scores, rowvar=False))
    dependence = -0.5 * float(np.linalg.slogdet(correlation)[1])
    return sum(kl_from_uniform(x[:, i]) for i in range(d)) + dependence


def kl_truncated_normal(mean: float, std: float) -> float:
    r"""Divergence from U[0, 1] of a normal distribution truncated to [0, 1].

    $$D = -\left[\log(\sqrt{2\pi e}\, s C) + \frac{a\phi(a) - b\phi(b)}{2C}\right], \quad
    a = -\mu/s, \quad b = (1 - \mu)/s, \quad C = \Phi(b) - \Phi(a)$$

    Args:
        mean: Mean mu of the parent normal, in the unit coordinate.
        std: Standard deviation s of the parent normal.

    Returns:
        Divergence [nats].
    """
    a, b = -mean / std, (1 - mean) / std
    if a > 0:  # both in the upper tail: mirror, so that the difference of tails keeps its digits
        a, b = -b, -a
    log_c = log_ndtr(b) + np.log1p(-np.exp(log_ndtr(a) - log_ndtr(b)))
    log_phi_a, log_phi_b = (-0.5 * t**2 - 0.5 * math.log(2 * math.pi) for t in (a, b))
    edge = (a * np.exp(log_phi_a - log_c) - b * np.exp(log_phi_b - log_c)) / 2
    return float(-(0.5 * math.log(2 * math.pi * math.e) + math.log(std) + log_c + edge))
