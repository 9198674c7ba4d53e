"""A posterior to draw from: likelihood, prior box, and the coordinates that samplers walk in."""

from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from jbw.inference.space.box import Box
from jbw.inference.space.coordinates import Affine, Composed, Coordinate, Interval, Unit
from jbw.inference.space.reparametrisation import Reparametrisation
from jbw.inference.space.whitening import laplace_whitening, no_whitening

Theta = Mapping[str, Float[Array, "..."]]
LogLikelihood = Callable[[Theta, Any], Float[Array, "..."]]
LogPrior = Callable[[Theta], Float[Array, "..."]]


class Problem(eqx.Module):
    r"""A posterior to draw from, in coordinates that are composed of three changes of variable.

    $$w \;\to\; \mathrm{logit}\ z = z_0 + L w \;\to\; u = u_{min} + \frac{u_{max} - u_{min}}
    {1 + e^{-z}} \;\to\; \theta$$

    w is what most samplers walk in: any real numbers, and where a fit is known, standard normal
    about it to second order. The last step is the identity, logarithms, or a ridge.

    Attributes:
        log_likelihood: (theta, data) to independent terms [nats].
        log_prior: theta to a further log prior density [nats], or None.
        box: Prior bounds, uniform inside.
        data: Whatever the likelihood takes.
        outer: From u to the parameters.
        lower: Lower bounds of u.
        upper: Upper bounds of u.
        whitening: z_0 and L.
        located: Whether the whitening comes from a fit; static.
    """

    log_likelihood: LogLikelihood
    log_prior: LogPrior | None
    box: Box
    data: PyTree
    outer: Coordinate
    lower: Float[Array, " parameter"]
    upper: Float[Array, " parameter"]
    whitening: Affine
    located: bool = eqx.field(static=True)

    @property
    def coordinate(self) -> Composed:
        """From the whitened w to the parameters."""
        return Composed((self.whitening, Interval(self.lower, self.upper), self.outer))

    @property
    def unit_coordinate(self) -> Composed:
        """From the unit cube to the parameters."""
        return Composed((Unit(self.lower, self.upper), self.outer))

    def theta(self, w: Float[Array, " parameter"]) -> dict[str, Array]:
        """The parameters by name at a whitened point."""
        return named(self.coordinate.forward(w), self.box)

    def log_density(self, w: Float[Array, " parameter"]) -> Float[Array, ""]:
        """Log posterior density of w, the uniform prior normalised [nats]."""
        return log_density(self, self.coordinate, w)


def problem_of(
    log_likelihood: LogLikelihood,
    box: Box,
    data: PyTree,
    place: Reparametrisation,
    log_prior: LogPrior | None = None,
) -> Problem:
    """The posterior in given coordinates."""
    located = place.start is not None and place.covariance is not None
    whitening = no_whitening(len(box.names))
    if place.start is not None and place.covariance is not None:
        whitening = laplace_whitening(place.start, place.covariance, place.lower, place.upper)
    where = place.outer, place.lower, place.upper, whitening
    return Problem(log_likelihood, log_prior, box, data, *where, located)


def named(values: Float[Array, "... parameter"], box: Box) -> dict[str, Array]:
    """Parameters by name from the last axis of an array."""
    return {name: values[..., i] for i, name in enumerate(box.names)}


def log_density(
    problem: Problem, coordinate: Coordinate, x: Float[Array, " parameter"]
) -> Float[Array, ""]:
    r"""Log posterior density of a coordinate, not divided by the evidence.

    $$\log p(x | D) = \sum_i \log L_i(\theta) + \log\pi(\theta) - \log V
    + \log\left|\det \frac{\partial\theta}{\partial x}\right|$$

    with V the volume of the box; minus infinity outside of it. A failed solve is data for the
    sampler: such parameters are impossible, not an error.

    Reference:
        Eqs. (32), (33), (35), (36), (37).
    """
    box, values = problem.box, coordinate.forward(x)
    theta = named(values, box)
    likelihood = jnp.sum(problem.log_likelihood(theta, problem.data))
    prior = 0.0 if problem.log_prior is None else problem.log_prior(theta)
    slope = coordinate.log_abs_det_jacobian(x) - log_volume(box)
    inside = jnp.all((values >= box.lower) & (values <= box.upper))
    return jnp.where(inside & jnp.isfinite(likelihood), likelihood + prior + slope, -jnp.inf)


def log_volume(box: Box) -> Float[Array, ""]:
    """Logarithm of the box's volume, in the parameters' units."""
    return jnp.sum(jnp.log(box.upper - box.lower))
