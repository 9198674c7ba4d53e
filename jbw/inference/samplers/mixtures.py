r"""Mixtures of Student's t distributions: draws, densities, and fits to weighted points.

$$q(x) = \sum_k a_k\,t_\nu(x;\, \mu_k, L_k L_k^T)$$

Their tails are heavier than a posterior's, so that no relevant point gets a very large weight.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.special import gammaln, logsumexp, softmax

from jbw.inference.samplers.evidence import HEAVY

STEPS = 20  # steps of expectation-maximisation
ENOUGH = 3000  # largest number of points to which a mixture is fitted
POINTS_A_DIMENSION = 10.0  # effective points that a component needs per dimension
COUNTS = (1, 2, 4, 8)  # numbers of components with which a fit is tried
# weight of the overall covariance in each component's covariance, as a number of points per
# dimension
PRIOR_POINTS = 0.5
# weight and relative width of an additional component that covers all points
BEYOND, WIDER = 0.1, 2.0
SLIGHT = 1e-4  # fraction of the total weight that is neglected, in the points of smallest weight
NUGGET = 1e-10  # relative increase of variances, in case points coincide

Points = Float[np.ndarray, "point parameter"]
Weights = Float[np.ndarray, " point"]


class Mixture(NamedTuple):
    """The components of a mixture: shares, centres and lower triangular roots of their scales."""

    shares: Float[np.ndarray, " component"]
    centres: Float[np.ndarray, "component parameter"]
    roots: Float[np.ndarray, "component parameter parameter"]


def standard(size: int) -> Mixture:
    """Return a mixture of one component at zero with unit scale."""
    return Mixture(np.ones(1), np.zeros((1, size)), np.eye(size)[None])


def draw(rng: np.random.Generator, mixture: Mixture, count: int) -> Points:
    """Draw points from a mixture."""
    size = mixture.centres.shape[1]
    which = rng.choice(len(mixture.shares), count, p=mixture.shares)
    normal = rng.standard_normal((count, size))
    stretch = np.sqrt(HEAVY / rng.chisquare(HEAVY, count))[:, None]
    return mixture.centres[which] + stretch * np.einsum("nij,nj->ni", mixture.roots[which], normal)


def log_density(mixture: Mixture, x: Points) -> Weights:
    """Return the log density of a mixture at points."""
    return np.asarray(logsumexp(_log_components(mixture, _squares(mixture, x)), axis=1))


def _squares(mixture: Mixture, x: Points) -> Float[np.ndarray, "point component"]:
    r"""Return squared distances to the components, $|L_k^{-1} (x - \mu_k)|^2$."""
    # With few parameters, einsum has finished before BLAS would have started its threads.
    away = x - mixture.centres[:, None]
    white = np.einsum("kij,knj->kni", np.linalg.inv(mixture.roots), away)
    return np.einsum("kni,kni->nk", white, white)


def _log_components(
    mixture: Mixture, squares: Float[np.ndarray, "point component"]
) -> Float[np.ndarray, "point component"]:
    """Return the log of each component's density times its share, at each point."""
    size = mixture.centres.shape[1]
    log_det = np.sum(np.log(np.diagonal(mixture.roots, axis1=1, axis2=2)), axis=1)
    scale = gammaln((HEAVY + size) / 2) - gammaln(HEAVY / 2) - 0.5 * size * np.log(HEAVY * np.pi)
    tail = -0.5 * (HEAVY + size) * np.log1p(squares / HEAVY)
    return np.log(mixture.shares) + scale - log_det + tail


def refitted(rng: np.random.Generator, x: Points, weights: Weights) -> Mixture:
    r"""Fit the most likely mixture to weighted points, by expectation-maximisation.

    $$\rho_{ik} = \frac{a_k t_k(x_i)}{q(x_i)}, \quad u_{ik} = \frac{\nu + d}{\nu + s_{ik}}, \quad
      a_k = \sum_i w_i \rho_{ik}, \quad
      \mu_k = \frac{\sum_i w_i \rho_{ik} u_{ik} x_i}{\sum_i w_i \rho_{ik} u_{ik}}, \quad
      \Sigma_k = \frac1{a_k} \sum_i w_i \rho_{ik} u_{ik} (x_i - \mu_k)(x_i - \mu_k)^T$$

    with s the squared distances and weights that sum to one. The number of components is chosen by
    the likelihood of one half of the points under the fit to the other half: more components would
    follow the points themselves, which biases their weights.

    Reference:
        Cappé, Douc, Guillin, Marin and Robert (2008), Statistics and Computing 18, 447.
    """
    if 1 / np.sum(weights**2) > ENOUGH:  # This many draws determine a mixture well enough.
        x = x[rng.choice(len(x), ENOUGH, p=weights)]
        weights = np.full(ENOUGH, 1 / ENOUGH)
    # All but a ten-thousandth of the weight is kept.
    order = np.argsort(-weights)
    heavy = np.sort(order[: 1 + int(np.searchsorted(np.cumsum(weights[order]), 1 - SLIGHT))])
    x, weights = x[heavy], weights[heavy] / weights[heavy].sum()
    most = 0.5 / np.sum(weights**2) / (POINTS_A_DIMENSION * x.shape[1])
    counts = [count for count in COUNTS if count == 1 or count <= most]
    half = np.arange(len(x)) % 2 == 0
    scores = [_score(rng, x, weights, half, count) for count in counts] if counts[1:] else [0.0]
    return _fitted(rng, x, weights, counts[int(np.argmax(scores))])


def widened(mixture: Mixture, x: Points, weights: Weights) -> Mixture:
    """Add a broad component that covers all points, with a share of a tenth.

    Points that do not yet reach the end of a curved posterior do not show that it continues.
    """
    root = np.linalg.cholesky(_overall(weights, x))
    return Mixture(
        np.append((1 - BEYOND) * mixture.shares, BEYOND),
        np.vstack([mixture.centres, weights @ x]),
        np.concatenate([mixture.roots, WIDER * root[None]]),
    )


def _score(
    rng: np.random.Generator, x: Points, weights: Weights, half: NDArray[np.bool_], count: int
) -> float:
    """Return the mean log density of half of the points under the other half's mixture."""
    mixture = _fitted(rng, x[half], weights[half] / weights[half].sum(), count)
    return float(weights[~half] @ log_density(mixture, x[~half]))


def _fitted(rng: np.random.Generator, x: Points, weights: Weights, count: int) -> Mixture:
    """Fit a mixture of at most `count` components to weighted points."""
    size = x.shape[1]
    effective = 1 / np.sum(weights**2)
    overall = _overall(weights, x)
    first = rng.choice(len(x), count, p=weights)
    shrunk = np.linalg.cholesky(overall) / count ** (1 / size)
    mixture = Mixture(np.full(count, 1 / count), x[first], np.tile(shrunk, (count, 1, 1)))
    for _ in range(STEPS):
        mixture = _improved(mixture, x, weights, effective, overall)
    return mixture


def _improved(
    mixture: Mixture, x: Points, weights: Weights, effective: float, overall: NDArray[np.float64]
) -> Mixture:
    """Return the mixture after one step of expectation-maximisation, without weak components."""
    size = x.shape[1]
    squares = _squares(mixture, x)
    parts = _log_components(mixture, squares)
    belongs = weights[:, None] * softmax(parts, axis=1)
    shares = belongs.sum(axis=0)
    supported = shares * effective > min(size, 0.5 * effective)
    shares, belongs, squares = shares[supported], belongs[:, supported], squares[:, supported]
    pull = (belongs * (HEAVY + size) / (HEAVY + squares)).T
    centres = pull @ x / pull.sum(axis=1)[:, None]
    away = x - centres[:, None]
    spreads = np.swapaxes(pull[..., None] * away, 1, 2) @ away
    lean = PRIOR_POINTS * size
    points = (shares * effective)[:, None, None]
    scales = (effective * spreads + lean * overall) / (points + lean)
    return Mixture(shares / shares.sum(), centres, np.linalg.cholesky(scales))


def _overall(weights: Weights, x: Points) -> NDArray[np.float64]:
    """Return the weighted covariance of all points, kept positive definite."""
    away = x - weights @ x
    overall = (weights[:, None] * away).T @ away
    overall[np.diag_indices(x.shape[1])] *= 1 + NUGGET
    return overall
