"""Whitening by a Laplace approximation: the logit of the box in which a fit is standard normal."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

from jbw.errors import ConfigError
from jbw.inference.space.coordinates import Affine

# A uniform prior in the box is a logistic distribution of the logit, of variance pi^2 / 3.
LOGIT_PRIOR_PRECISION = 3 / np.pi**2


def no_whitening(num_parameters: int) -> Affine:
    """The identity: the sampler walks on the logit itself."""
    return Affine(jnp.zeros(num_parameters), jnp.eye(num_parameters))


def laplace_whitening(
    start: Float[np.ndarray, " parameter"],
    covariance: Float[np.ndarray, "parameter parameter"],
    lower: Float[Array, " parameter"],
    upper: Float[Array, " parameter"],
) -> Affine:
    r"""Whitening in which a Gaussian of this covariance about `start` is standard normal.

    $$\Sigma_z^{-1} = J \Sigma_x^{-1} J + \tfrac{3}{\pi^2} I, \qquad J = x (1 - x), \qquad
    L L^T = \Sigma_z$$

    with x the place of the start between the bounds, 0 to 1, and z its logit. The last term is the
    prior's precision in z: directions of which the data say nothing keep the width of the box. A
    centre closer to a bound than its standard deviation is moved inside.

    Returns:
        The linear map to the logit.

    Raises:
        ConfigError: The covariance is not finite, symmetric and positive definite.
    """
    low, width = np.asarray(lower), np.asarray(upper) - np.asarray(lower)
    covariance_x = np.asarray(covariance, dtype=float) / np.outer(width, width)
    std, precision = _checked_precision(covariance_x, len(width))
    x = (np.asarray(start, dtype=float) - low) / width
    margin = np.minimum(std, 0.5)
    x = np.clip(x, margin, 1 - margin)
    slope = x * (1 - x)
    scaled = precision * np.outer(slope / std, slope / std)
    root = np.linalg.cholesky(scaled + LOGIT_PRIOR_PRECISION * np.eye(len(x)))
    return Affine(jnp.asarray(np.log(x) - np.log1p(-x)), jnp.asarray(np.linalg.inv(root).T))


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
