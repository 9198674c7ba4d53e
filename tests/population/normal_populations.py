r"""Units that vary normally about a line in covariates, in closed form or with unknown variation.

The posterior of unit k with covariates x_k is summarised by m_k and C_k:

$$m_k \sim N(B x_k,\ T + C_k), \qquad \mathrm{vec}\,B \sim N(b_0, P_0)$$

T is the covariance between units. For one coordinate T = tau^2 is integrated over its half-normal
prior by quadrature, for many populations at once.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.special import ndtr

Array = NDArray[np.float64]
# Nodes of the quadrature over tau, exact to 1e-10 where the data determine it with a finite width.
NUM_NODES = 400
# Square root of the largest tau relative to its prior's scale; 1e-18 of the prior is beyond.
REACH = 3.0


class TrendLine(NamedTuple):
    """The posterior of the line B for a given covariance between units.

    Attributes:
        mean: Mean of vec B, coordinate by coordinate.
        cov: Covariance of vec B.
        log_marginal: Log density of all m_k.
    """

    mean: Float[np.ndarray, " coefficient"]
    cov: Float[np.ndarray, "coefficient coefficient"]
    log_marginal: float


def line(
    m: Float[np.ndarray, "unit d"],
    c: Float[np.ndarray, "unit d d"],
    x: Float[np.ndarray, "unit covariate"],
    scatter: Float[np.ndarray, "d d"],
    prior_mean: Float[np.ndarray, " coefficient"],
    prior_cov: Float[np.ndarray, "coefficient coefficient"],
) -> TrendLine:
    """Return the posterior of the line for a given covariance T, in closed form."""
    d = m.shape[1]
    design = [np.kron(np.eye(d), row) for row in x]
    total = scatter + c
    weights = np.linalg.inv(total)
    before = np.linalg.inv(prior_cov)
    precision = before + sum(a.T @ w @ a for a, w in zip(design, weights, strict=True))
    pull = before @ prior_mean + sum(
        a.T @ w @ y for a, w, y in zip(design, weights, m, strict=True)
    )
    mean = np.linalg.solve(precision, pull)
    # The marginal density is that of the data at any B over the posterior's there; here at the
    # mean.
    apart = np.stack([y - a @ mean for y, a in zip(m, design, strict=True)])
    data = -0.5 * np.sum(
        np.einsum("ki,kij,kj->k", apart, weights, apart) + np.linalg.slogdet(2.0 * np.pi * total)[1]
    )
    moved = mean - prior_mean
    prior = 0.5 * (np.linalg.slogdet(before)[1] - np.linalg.slogdet(precision)[1])
    log_marginal = float(data + prior - 0.5 * moved @ before @ moved)
    return TrendLine(mean, np.linalg.inv(precision), log_marginal)


def new_unit(
    line: TrendLine, x: Float[np.ndarray, " covariate"], scatter: Float[np.ndarray, "d d"]
) -> tuple[Float[np.ndarray, " d"], Float[np.ndarray, "d d"]]:
    """Return mean and covariance of an unmeasured unit at its covariates."""
    design = np.kron(np.eye(len(scatter)), x)
    return design @ line.mean, design @ line.cov @ design.T + scatter


def shrunken(
    m: Float[np.ndarray, " d"],
    c: Float[np.ndarray, "d d"],
    prior_mean: Float[np.ndarray, " d"],
    scatter: Float[np.ndarray, "d d"],
) -> tuple[Float[np.ndarray, " d"], Float[np.ndarray, "d d"]]:
    """Return a unit's posterior with the known population as its prior."""
    gain = scatter @ np.linalg.inv(scatter + c)
    return prior_mean + gain @ (m - prior_mean), scatter - gain @ scatter


class Scattered(NamedTuple):
    """The posterior of one coordinate with unknown variation: a mixture over tau, by population.

    The leading axes are populations.

    Attributes:
        tau: Nodes of the quadrature.
        weight: Posterior probability of each node.
        mean: Mean of the line's coefficients at each node.
        cov: Covariance of the line's coefficients at each node.
        log_evidence: Log density of the data.
    """

    tau: Float[np.ndarray, " node"]
    weight: Float[np.ndarray, "... node"]
    mean: Float[np.ndarray, "... node covariate"]
    cov: Float[np.ndarray, "... node covariate covariate"]
    log_evidence: Float[np.ndarray, "..."]


def scattered(
    y: Float[np.ndarray, "... unit"],
    s: Float[np.ndarray, "... unit"],
    x: Float[np.ndarray, "unit covariate"],
    prior_mean: Float[np.ndarray, " covariate"],
    prior_cov: Float[np.ndarray, "covariate covariate"],
    scale: float,
    num_nodes: int = NUM_NODES,
) -> Scattered:
    r"""Return the posterior of one coordinate's line and tau, $\tau \sim$ half-normal of `scale`.

    Gauss-Legendre nodes in the square root of tau are dense near zero.
    """
    at, width = np.polynomial.legendre.leggauss(num_nodes)
    root = 0.5 * REACH * (at + 1.0)
    tau = scale * root**2
    log_weight = np.log(0.5 * REACH * width * 2.0 * scale * root)
    log_weight += np.log(np.sqrt(2.0 / np.pi) / scale) - 0.5 * (tau / scale) ** 2
    variance = np.asarray(s)[..., None, :] ** 2 + tau[:, None] ** 2
    before = np.linalg.inv(prior_cov)
    precision = before + np.einsum("...nk,ki,kj->...nij", 1.0 / variance, x, x)
    pull = before @ prior_mean + np.einsum("...nk,ki->...ni", y[..., None, :] / variance, x)
    cov = np.linalg.inv(precision)
    mean = np.einsum("...nij,...nj->...ni", cov, pull)
    apart = y[..., None, :] - np.einsum("...ni,ki->...nk", mean, x)
    moved = mean - prior_mean
    log_likelihood = -0.5 * np.sum(np.log(2.0 * np.pi * variance) + apart**2 / variance, -1)
    log_likelihood += 0.5 * (np.linalg.slogdet(before)[1] - np.linalg.slogdet(precision)[1])
    log_likelihood -= 0.5 * np.einsum("...ni,ij,...nj->...n", moved, before, moved)
    log_joint = log_likelihood + log_weight
    most = log_joint.max(-1, keepdims=True)
    log_evidence = most[..., 0] + np.log(np.sum(np.exp(log_joint - most), -1))
    return Scattered(tau, np.exp(log_joint - log_evidence[..., None]), mean, cov, log_evidence)


def moments(
    posterior: Scattered, x: Float[np.ndarray, " covariate"] | None = None
) -> tuple[Float[np.ndarray, "..."], Float[np.ndarray, "..."]]:
    """Return mean and sd of tau, or of an unmeasured unit at its covariates."""
    if x is None:
        mean = np.sum(posterior.weight * posterior.tau, -1)
        square = np.sum(posterior.weight * posterior.tau**2, -1)
        return mean, np.sqrt(square - mean**2)
    centre, variance = _of_new_unit(posterior, x)
    mean = np.sum(posterior.weight * centre, -1)
    spread = variance + (centre - mean[..., None]) ** 2
    return mean, np.sqrt(np.sum(posterior.weight * spread, -1))


def probability_below(
    posterior: Scattered, x: Float[np.ndarray, " covariate"], value: Float[np.ndarray, "..."]
) -> Float[np.ndarray, "..."]:
    """Return the probability that an unmeasured unit lies below a value."""
    centre, variance = _of_new_unit(posterior, x)
    return np.sum(posterior.weight * ndtr((value[..., None] - centre) / np.sqrt(variance)), -1)


def _of_new_unit(posterior: Scattered, x: Array) -> tuple[Array, Array]:
    centre = posterior.mean @ x
    return centre, np.einsum("i,...ij,j->...", x, posterior.cov, x) + posterior.tau**2
