"""Exact likelihoods whose gradient is that of their quadratic approximation: cheap trajectories.

A leapfrog step conserves volume and is reversible under any force field, and NUTS weighs the points
of a trajectory by their exact density. So a wrong gradient costs acceptance, never correctness; and
where a posterior is nearly Gaussian the gradient of its Laplace approximation is as good as the
true one, at no cost beside a solve.
"""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from jbw.inference.fitting import Fit
from jbw.inference.model import LogLikelihood


class Quadratic(eqx.Module):
    r"""A log likelihood's data, and its quadratic approximation.

    $$\ell(\theta) \approx \ell(\hat\theta) - \tfrac12
      (\theta - \hat\theta)^T \Sigma^{-1} (\theta - \hat\theta)$$

    Attributes:
        data: What the log likelihood takes.
        names: Parameters in the order of the arrays; static (a dictionary would be sorted by JAX).
        centre: The optimum.
        precision: Inverse of Sigma.
    """

    data: PyTree
    names: tuple[str, ...] = eqx.field(static=True)
    centre: Float[Array, " parameter"]
    precision: Float[Array, "parameter parameter"]


def quadratic(data: PyTree, best: Fit) -> Quadratic:
    """The quadratic approximation that a least-squares fit gives.

    Args:
        data: What the log likelihood takes.
        best: The fit, with its covariance.

    Returns:
        The data with the approximation.
    """
    scale = np.sqrt(np.diag(best.covariance))
    correlation = best.covariance / np.outer(scale, scale)
    precision = np.linalg.inv(correlation) / np.outer(scale, scale)
    centre = jnp.asarray(list(best.theta.values()))
    return Quadratic(data, tuple(best.theta), centre, jnp.asarray(precision))


@lru_cache
def driven_by_quadratic(log_likelihood: LogLikelihood) -> LogLikelihood:
    """The same log likelihood on a `Quadratic`, its derivative that of the approximation.

    The same function comes back for the same argument, so that samplers compile it once.

    Args:
        log_likelihood: (theta, data) to terms [nats].

    Returns:
        (theta, Quadratic) to the same terms.
    """

    @jax.custom_jvp
    def driven(theta: Mapping[str, Array], known: Quadratic) -> Float[Array, "..."]:
        return log_likelihood(theta, known.data)

    @driven.defjvp
    def _(primals: tuple, tangents: tuple) -> tuple[Any, Any]:
        theta, known = primals
        offset = jnp.stack([theta[name] for name in known.names]) - known.centre
        change = jnp.stack([tangents[0][name] for name in known.names])
        terms = driven(theta, known)
        # Only the sum of the terms counts: the whole change is shared out among them.
        slope = -(known.precision @ offset) @ change / terms.size
        return terms, jnp.broadcast_to(slope, terms.shape)

    return driven
