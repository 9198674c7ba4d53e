"""Importance sampling about the Laplace approximation: the posterior for a few hundred solves."""

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key, PyTree
from numpy.typing import NDArray

from jbw.inference.box import Box
from jbw.inference.fitting import Fit
from jbw.inference.laplace import HEAVY
from jbw.inference.model import LogLikelihood
from jbw.inference.weights import effective_draws, smoothed


@dataclass(frozen=True)
class Weighted:
    """Draws about the Laplace approximation with the weights that make them the posterior's.

    Attributes:
        theta: Draws by name.
        weights: Normalised, Pareto-smoothed weights.
        khat: Pareto shape of the raw weights; below 0.7 they can be trusted.
    """

    theta: dict[str, NDArray[np.float64]]
    weights: NDArray[np.float64]
    khat: float

    @property
    def ess(self) -> float:
        """Effective number of draws, 1 / sum of squared weights."""
        return effective_draws(self.weights)

    def mean(self, name: str) -> float:
        """Posterior mean of one parameter."""
        return float(np.sum(self.weights * self.theta[name]))

    def sd(self, name: str) -> float:
        """Posterior standard deviation of one parameter."""
        spread = (self.theta[name] - self.mean(name)) ** 2
        return float(np.sqrt(np.sum(self.weights * spread)))


def importance(
    key: Key[Array, ""],
    log_likelihood: LogLikelihood,
    box: Box,
    data: PyTree,
    best: Fit,
    num_draws: int = 200,
) -> Weighted:
    r"""Draw about the Laplace approximation of a posterior and weigh by the posterior.

    $$w_i \propto p(D | \theta_i)\, / \,t_\kappa(\theta_i; \hat\theta, \Sigma)$$

    in the box, zero outside; smoothed by a generalised Pareto fit to their tail. The draws have the
    tails of a t distribution of kappa = 5 degrees of freedom, which a posterior seldom leaves.

    Args:
        key: Random key.
        log_likelihood: (theta, data) to terms [nats].
        box: Prior bounds.
        data: Whatever `log_likelihood` takes.
        best: Least-squares fit with its covariance.
        num_draws: Draws.

    Returns:
        The weighted draws.

    Reference:
        Vehtari et al. (2024), JMLR 25, 72; for the t distribution, Geweke (1989), Econometrica 57.
    """
    root = np.linalg.cholesky(best.covariance)
    key_normal, key_scale = jax.random.split(key)
    normal = jax.random.normal(key_normal, (num_draws, len(box.names)))
    scale = jax.random.gamma(key_scale, HEAVY / 2, (num_draws, 1)) * 2 / HEAVY
    white = np.asarray(normal / jnp.sqrt(scale))
    points = np.array(list(best.theta.values())) + white @ root.T
    theta = {name: points[:, i] for i, name in enumerate(box.names)}
    inside = np.all((points > np.asarray(box.lower)) & (points < np.asarray(box.upper)), axis=1)
    values = np.asarray(
        _evaluate(log_likelihood, {k: jnp.asarray(v) for k, v in theta.items()}, data)
    )
    log_weights = np.where(inside & np.isfinite(values), values, -np.inf)
    tails = np.log1p(np.sum(white**2, axis=1) / HEAVY)
    log_weights = log_weights + 0.5 * (HEAVY + white.shape[1]) * tails
    weights, khat = smoothed(log_weights)
    return Weighted(theta, weights, khat)


@eqx.filter_jit
def _evaluate(
    log_likelihood: LogLikelihood, theta: dict[str, Array], data: PyTree
) -> Float[Array, " draw"]:
    return jax.lax.map(lambda one: jnp.sum(log_likelihood(one, data)), theta)
