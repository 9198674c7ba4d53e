r"""Prior densities that a campaign states, in addition to uniform priors between bounds.

A parameter with a stated density $\pi$ keeps a box, whose bounds [l, u] contain all of the density
except a negligible tail. Its posterior is that of the box with one more term,

$$\log \pi(\theta) + \log(u - l)$$

which every sampler and every evidence treats like the term of a test. Least squares use the
standard normal score, whose square is that of a measurement of the same weight:

$$r = \Phi^{-1}(F(\theta))$$

with F the distribution function. For a normal density it is (theta - mean) / deviation.
"""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtri
from jaxtyping import Array, Float
from numpyro.distributions import Uniform
from scipy.optimize import brentq

from jbw.inference.density import TAIL, Density
from jbw.inference.space.box import Box, bounds_by_name, box, prior_std

# number of points at which a density is evaluated, enough for moments accurate to 1e-6
NUM_POINTS = 4001
WIDEST = 20.0  # largest ln(upper bound / middle) of a range


class StatedDensities(eqx.Module):
    """The prior densities that a campaign states, by parameter name, with bounds.

    Attributes:
        names: Parameters with a stated density.
        distributions: NumPyro distribution of each.
        log_width: Logarithm of the width of each density's box.
        texts: Text of each density in a campaign file.
    """

    names: tuple[str, ...] = eqx.field(static=True, default=())
    distributions: tuple[Any, ...] = ()
    log_width: tuple[Float[Array, ""] | np.ndarray, ...] = ()
    texts: tuple[str, ...] = eqx.field(static=True, default=())

    @classmethod
    def of(cls, prior: Mapping[str, Any]) -> "StatedDensities":
        """Collect those priors of a campaign that are densities, not only bounds."""
        stated = {name: stated for name, stated in prior.items() if isinstance(stated, Density)}
        return cls(
            tuple(stated),
            tuple(density.build() for density in stated.values()),
            tuple(np.log(upper - lower) for lower, upper in stated.values()),
            tuple(repr(density) for density in stated.values()),
        )


def distributions_of(box: Box, stated: StatedDensities) -> dict[str, Any]:
    """Return the prior distribution of each parameter: its stated density, or a uniform one."""
    densities = dict(zip(stated.names, stated.distributions, strict=True))
    return {
        name: densities.get(name, Uniform(low, high))
        for name, (low, high) in bounds_by_name(box).items()
    }


def log_over_uniform(theta: Mapping[str, Any], stated: StatedDensities) -> Float[Array, " density"]:
    r"""Return the log density terms $\log \pi(\theta) + \log(u - l)$ of stated priors [nats].

    The terms are in the order of the names. A term is zero if a nested model lacks the parameter.
    """
    triples = zip(stated.names, stated.distributions, stated.log_width, strict=True)
    terms = [
        density.log_prob(theta[name]) + log_width if name in theta else jnp.zeros(())
        for name, density, log_width in triples
    ]
    return jnp.stack(terms) if terms else jnp.zeros(0)


def standard_scores(
    theta: Mapping[str, Any], stated: StatedDensities
) -> dict[str, Float[Array, "1"]]:
    r"""Return the normal scores $\Phi^{-1}(F(\theta))$ of stated priors, by parameter name."""
    pairs = zip(stated.names, stated.distributions, strict=True)
    return {
        name: jnp.atleast_1d(_score(density, theta[name]) if name in theta else jnp.zeros(()))
        for name, density in pairs
    }


def _score(density: Any, value: Any) -> Float[Array, ""]:
    return ndtri(jnp.clip(density.cdf(value), TAIL / 2, 1 - TAIL / 2))


def as_wide(prior: Box, stated: StatedDensities) -> Box:
    """Return the bounds of uniform priors that are as wide as the stated densities.

    Widths are compared in the logarithm if the box is positive, otherwise in the parameter itself.
    Comparisons of a posterior with its prior use this box.
    """
    bounds = bounds_by_name(prior)
    for name, distribution in zip(stated.names, stated.distributions, strict=True):
        if name in bounds:
            bounds[name] = _uniform_of_width(distribution, *bounds[name])
    return box(bounds)


def _uniform_of_width(distribution: Any, lower: float, upper: float) -> tuple[float, float]:
    is_log = lower > 0.0
    ends = np.log([lower, upper]) if is_log else np.array([lower, upper])
    grid = np.linspace(ends[0], ends[1], NUM_POINTS)
    values = np.exp(grid) if is_log else grid
    weight = np.exp(np.asarray(distribution.log_prob(values))) * (values if is_log else 1.0)
    weight[~np.isfinite(weight)] = 0.0  # The density may be infinite at an end of its range.
    weight /= np.sum(weight)
    mean = float(weight @ grid)
    std = float(np.sqrt(weight @ (grid - mean) ** 2))
    if not is_log:
        return mean - np.sqrt(3) * std, mean + np.sqrt(3) * std

    # The logarithm of a uniform density has a standard deviation of at most one.
    def excess(log_r: float) -> float:
        return prior_std(np.exp(-log_r), np.exp(log_r)) - std

    reach: Any = brentq(excess, 1e-9, WIDEST) if excess(WIDEST) > 0.0 else WIDEST
    return float(np.exp(mean - reach)), float(np.exp(mean + reach))
