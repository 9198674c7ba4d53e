"""Parametrisations of a posterior: coordinates, their bounds, and a fit expressed in them."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

from jbw.errors import ConfigError
from jbw.inference.space.box import Box, bounds_by_name
from jbw.inference.space.coordinates import IDENTITY, Coordinate, Logarithms

Theta = Mapping[str, Any]
Covariance = Float[np.ndarray, "parameter parameter"]

EDGE = 1e-6  # smallest distance of starting points from a bound, where the logit would be infinite
# A sign is certain if a parameter is this many (conditional) standard deviations away from zero.
CERTAIN = 3.0
WIDER = 10.0  # distance by which bounds are extended on both sides, in widths of the prior range
FLOOR = 1e-6  # lower bound that replaces zero, relative to the optimum


class Reparametrisation(NamedTuple):
    """The sampling coordinates of a posterior, with the map to the parameters.

    `start` is one point with a Laplace covariance of u around it, or one point per chain, or None.
    """

    outer: Coordinate
    lower: Float[Array, " parameter"]
    upper: Float[Array, " parameter"]
    start: NDArray[np.float64] | None = None
    covariance: NDArray[np.float64] | None = None


def in_box(
    box: Box, start: Theta | None, covariance: Covariance | None, num_chains: int
) -> Reparametrisation:
    """Return the parameters themselves as sampling coordinates, with checked starting points."""
    parametrisation = Reparametrisation(IDENTITY, box.lower, box.upper)
    if start is None:
        if covariance is not None:
            raise ConfigError(
                "Argument `covariance` needs `start`, the point of the fit.",
                remedy="Pass the `theta` of the fit with its covariance.",
            )
        return parametrisation
    points = _checked_start(start, box, num_chains)
    if covariance is None:
        width = box.upper - box.lower
        x = jnp.clip((points - box.lower) / width, EDGE, 1 - EDGE)
        return parametrisation._replace(start=np.asarray(box.lower + x * width))
    if any(np.ndim(value) for value in start.values()):
        raise ConfigError("Argument `start` must be one point when `covariance` is given.")
    return parametrisation._replace(start=points[0], covariance=np.asarray(covariance))


def _checked_start(start: Theta, box: Box, num_chains: int) -> Float[np.ndarray, "chain parameter"]:
    if set(start) != set(box.names):
        raise ConfigError(
            f"Argument `start` must name {', '.join(box.names)}, "
            f"but it names {', '.join(map(str, start))}."
        )
    columns = []
    for name, (lower, upper) in bounds_by_name(box).items():
        value = np.asarray(start[name], dtype=float)
        if value.shape not in ((), (num_chains,)):
            raise ConfigError(
                f"Start of `{name}` must be one number, or one per chain ({num_chains}), but "
                f"its shape is {value.shape}."
            )
        if not np.all((value >= lower) & (value <= upper)):
            raise ConfigError(
                f"Start of `{name}` must lie within its prior [{lower:g}, {upper:g}], but is "
                f"{value}.",
                remedy="Widen the prior, or start inside it.",
            )
        columns.append(np.broadcast_to(value, num_chains))
    return np.stack(columns, axis=-1)


def never_zero(theta: Theta, covariance: Covariance, box: Box) -> tuple[str, ...]:
    """Return the parameters that are certainly positive, whose logarithms can be sampled."""
    conditional = 1 / np.sqrt(np.diag(np.linalg.inv(covariance)))
    return tuple(
        name
        for name, low, std in zip(box.names, np.asarray(box.lower), conditional, strict=True)
        if low > 0 or theta[name] > CERTAIN * std
    )


def along_logarithms(
    theta: Theta, covariance: Covariance, box: Box, names: tuple[str, ...]
) -> Reparametrisation:
    """Return coordinates with some parameters as logarithms, and the others unchanged.

    Bounds are ten widths of the box further out: the sampler's logit is then nearly linear over the
    box and does not bend a ridge. The posterior itself remains within the prior box.
    """
    place = in_logarithms(theta, covariance, box, names)
    reach = WIDER * (place.upper - place.lower)
    return place._replace(lower=place.lower - reach, upper=place.upper + reach)


def in_logarithms(
    theta: Theta, covariance: Covariance, box: Box, names: tuple[str, ...]
) -> Reparametrisation:
    r"""Return log coordinates within the bounds; covariance $\Sigma_{ij} / (\theta_i \theta_j)$."""
    value = np.array([float(theta[name]) for name in box.names])
    outer = Logarithms(tuple(name in names for name in box.names))
    lower = np.where(outer.chosen, np.maximum(box.lower, FLOOR * value), box.lower)
    positive = np.where(outer.chosen, value, 1.0)
    return Reparametrisation(
        outer,
        outer.inverse(np.asarray(lower)),
        outer.inverse(np.asarray(box.upper)),
        np.where(outer.chosen, np.log(positive), value),
        covariance / np.outer(positive, positive),
    )
