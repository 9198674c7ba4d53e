"""A posterior to sample: likelihood, prior bounds, and coordinates for samplers."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree
from numpy.typing import NDArray

from jbw.errors import ConfigError
from jbw.inference.lanes import seen_by
from jbw.inference.space.box import Box, named
from jbw.inference.space.coordinates import Affine, Composed, Coordinate, interval, namespace, unit
from jbw.inference.space.reparametrisation import Reparametrisation

Theta = Mapping[str, Float[Array, "..."]]
LogLikelihood = Callable[[Theta, Any], Float[Array, "..."]]
# variance of the logit of a uniformly distributed number: pi^2 / 3
LOGIT_PRIOR_PRECISION = 3 / np.pi**2


class Target(NamedTuple):
    """A posterior to sample, before its coordinates are chosen.

    Attributes:
        log_likelihood: Function of (theta, data) that returns independent terms [nats].
        box: Prior bounds.
        data: Data argument of the likelihood.
        is_costly: Whether an evaluation steps through time.
    """

    log_likelihood: LogLikelihood
    box: Box
    data: PyTree = None
    is_costly: bool = False


class Problem(eqx.Module):
    r"""A posterior to sample, in coordinates composed of three changes of variable.

    $$w \;\to\; \mathrm{logit}\ z = z_0 + L w \;\to\; u = u_{min} + \frac{u_{max} - u_{min}}
    {1 + e^{-z}} \;\to\; \theta$$

    Most samplers use w: any real numbers, and standard normal to second order if the problem is
    `located` by a fit. The `outer` step, from u within bounds `lower` and `upper`, is the identity,
    logarithms, or a ridge. The box bounds theta; the likelihood returns terms [nats].
    """

    log_likelihood: LogLikelihood
    box: Box
    data: PyTree
    outer: Coordinate
    lower: Float[Array, " parameter"]
    upper: Float[Array, " parameter"]
    whitening: Affine
    located: bool = eqx.field(static=True)

    @property
    def coordinate(self) -> Composed:
        """The map from normalised coordinates w to the parameters."""
        return Composed((self.whitening, interval(self.lower, self.upper), self.outer))

    @property
    def unit_coordinate(self) -> Composed:
        """The map from the unit cube to the parameters."""
        return Composed((unit(self.lower, self.upper), self.outer))

    def theta(self, w: Float[Array, " parameter"]) -> dict[str, Array]:
        """Return the parameters by name at normalised coordinates w."""
        return named(self.coordinate.forward(w), self.box)

    def log_density(self, w: Float[Array, " parameter"]) -> Float[Array, ""]:
        """Return the log posterior density at normalised coordinates w [nats]."""
        return log_density(self, self.coordinate, w)


def problem_of(
    log_likelihood: LogLikelihood, box: Box, data: PyTree, place: Reparametrisation
) -> Problem:
    """Return the posterior in given coordinates."""
    bounds, size = (place.lower, place.upper), len(box.names)
    whitening, located = Affine(np.zeros(size), np.eye(size)), False
    if place.start is not None and place.covariance is not None:
        whitening, located = laplace_whitening(place.start, place.covariance, *bounds), True
    seen = seen_by(log_likelihood, data)
    return Problem(log_likelihood, box, seen, place.outer, *bounds, whitening, located)


def log_density(
    problem: Problem, coordinate: Coordinate, x: Float[Array, " parameter"]
) -> Float[Array, ""]:
    r"""Return the unnormalised log posterior density [nats] in given coordinates.

    $$\log p(x | D) = \sum_i \log L_i(\theta) + \log \pi(x)$$

    by eqs. (32), (33), (35)-(37); -inf outside the box and where a solve failed.
    """
    theta = named(coordinate.forward(x), problem.box)
    likelihood = jnp.sum(problem.log_likelihood(theta, problem.data))
    density = likelihood + log_prior(problem, coordinate, x)
    return jnp.where(jnp.isfinite(likelihood), density, -jnp.inf)


def log_prior(
    problem: Problem, coordinate: Coordinate, x: Float[Array, " parameter"]
) -> Float[Array, ""]:
    r"""Return the log prior density in given coordinates; -inf outside bounds of volume V.

    $$\log \pi(x) = -\log V + \log\left|\det \frac{\partial\theta}{\partial x}\right|$$
    """
    box, values = problem.box, coordinate.forward(x)
    inside = jnp.all((values >= box.lower) & (values <= box.upper))
    slope = coordinate.log_abs_det_jacobian(x) - log_volume(box)
    return jnp.where(inside, slope, -jnp.inf)


def log_volume(box: Box) -> Float[Array, ""]:
    """Return the log volume between the prior bounds, in the parameters' units."""
    xp = namespace(box.lower)
    return xp.sum(xp.log(box.upper - box.lower))


def laplace_whitening(
    start: Float[np.ndarray, " parameter"],
    covariance: Float[np.ndarray, "parameter parameter"],
    lower: Float[Array, " parameter"],
    upper: Float[Array, " parameter"],
) -> Affine:
    r"""Return coordinates in which a Gaussian of given covariance at `start` is standard normal.

    $$\Sigma_z^{-1} = J \Sigma_x^{-1} J + \tfrac{3}{\pi^2} I, \qquad J = x (1 - x), \qquad
    L L^T = \Sigma_z$$

    with x the position of the start between the bounds, 0 to 1, and z its logit, whose prior
    precision is 3 / pi^2. A centre closer to a bound than its standard deviation is moved inside.
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
    return Affine(np.log(x) - np.log1p(-x), np.linalg.inv(root).T)


def _checked_precision(
    covariance: NDArray[np.float64], num_parameters: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the standard deviations, and the inverse of the correlation matrix."""
    if covariance.shape != (num_parameters, num_parameters):
        raise ConfigError(
            f"Argument `covariance` must be {num_parameters} x {num_parameters}, with one row "
            f"per parameter, but its shape is {covariance.shape}."
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
        why="The covariance determines the steps of the sampler.",
        remedy="Pass the covariance of a fit, or omit the argument.",
    )
