"""The sampling coordinate: the logit of the unit box, whitened by a Laplace covariance."""

from collections.abc import Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray
from numpyro.distributions import biject_to, constraints

from jbw.errors import ConfigError
from jbw.inference.box import Box

# A uniform prior in the box is a logistic distribution of the logit, of variance pi^2 / 3.
LOGIT_PRIOR_PRECISION = 3 / np.pi**2

HEAVY = 5.0
"""Degrees of freedom of a t distribution of the Laplace covariance: tails beyond a posterior's."""


class Whitening(NamedTuple):
    r"""Linear map from the coordinate w of the sampler to the logit z of the unit box.

    $$z = z_0 + L w$$

    Attributes:
        centre: z_0.
        factor: L; lower- or upper-triangular makes no difference.
    """

    centre: Float[Array, " parameter"]
    factor: Float[Array, "parameter parameter"]


def no_whitening(num_parameters: int) -> Whitening:
    """The identity: the sampler walks on the logit itself."""
    return Whitening(jnp.zeros(num_parameters), jnp.eye(num_parameters))


def laplace_whitening(
    start: Mapping[str, float], covariance: Float[np.ndarray, "parameter parameter"], box: Box
) -> Whitening:
    r"""Whitening in which a Gaussian of this covariance about `start` is standard normal.

    $$\Sigma_z^{-1} = J \Sigma_x^{-1} J + \tfrac{3}{\pi^2} I, \qquad J = x (1 - x), \qquad
    L L^T = \Sigma_z$$

    The last term is the prior's precision in z: directions of which the data say nothing keep
    the width of the box. A centre closer to a bound than its standard deviation is moved inside.

    Args:
        start: Centre, by name, in the parameters' units.
        covariance: Covariance of the parameters, in their units and in the order of `box.names`.
        box: The prior box.

    Returns:
        The whitening.

    Raises:
        ConfigError: The covariance is not finite, symmetric and positive definite.
    """
    width = np.asarray(box.upper - box.lower)
    lower = np.asarray(box.lower)
    covariance_x = np.asarray(covariance, dtype=float) / np.outer(width, width)
    std, precision = _checked_precision(covariance_x, len(box.names))
    x = (np.array([float(start[name]) for name in box.names]) - lower) / width
    margin = np.minimum(std, 0.5)
    x = np.clip(x, margin, 1 - margin)
    slope = x * (1 - x)
    scaled = precision * np.outer(slope / std, slope / std)
    root = np.linalg.cholesky(scaled + LOGIT_PRIOR_PRECISION * np.eye(len(x)))
    return Whitening(jnp.asarray(np.log(x) - np.log1p(-x)), jnp.asarray(np.linalg.inv(root).T))


def _checked_precision(
    covariance: NDArray[np.float64], num_parameters: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Standard deviations, and the inverse of the correlation matrix."""
    if covariance.shape != (num_parameters, num_parameters):
        raise ConfigError(
            f"Argument `covariance` must be {num_parameters} x {num_parameters}, one row a "
            f"parameter of the box, but its shape is {covariance.shape}."
        )
    variance = np.diagonal(covariance)
    if np.all(np.isfinite(covariance)) and np.all(variance > 0):
        std = np.sqrt(variance)
        correlation = covariance / np.outer(std, std)
        smallest = np.linalg.eigvalsh(correlation)[0]
        if np.allclose(correlation, correlation.T, atol=1e-8) and smallest > 0:
            return std, np.linalg.inv((correlation + correlation.T) / 2)
    raise ConfigError(
        "Argument `covariance` must be finite, symmetric and positive definite, but it is not.",
        why="It shapes the steps of the sampler.",
        remedy="Pass the covariance of a fit, or leave it out.",
    )


def logit(theta: Mapping[str, Float[Array, "..."]], box: Box) -> Float[Array, "... parameter"]:
    """The unconstrained coordinate z of parameters inside the box, as NumPyro defines it."""
    stacked = jnp.stack([jnp.asarray(theta[name]) for name in box.names], axis=-1)
    return biject_to(constraints.interval(box.lower, box.upper)).inv(stacked)


def from_logit(z: Float[Array, "... parameter"], box: Box) -> dict[str, Float[Array, "..."]]:
    """The parameters of an unconstrained coordinate z, as NumPyro defines it."""
    theta = biject_to(constraints.interval(box.lower, box.upper))(z)
    return {name: theta[..., i] for i, name in enumerate(box.names)}
