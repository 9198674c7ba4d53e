r"""A posterior of the user, with any prior of one number a parameter, ready to be calibrated.

Samplers know the uniform prior in a box; every other one is that of its quantiles,

$$\theta_i = F_i^{-1}(u_i), \qquad u_i \sim U(0, 1)$$

and ranks are those of u.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpyro.distributions as dist
from jax.lax import stop_gradient
from jax.tree_util import Partial
from jaxtyping import Array, Float, Key, PyTree
from numpyro.distributions.transforms import biject_to

from jbw.errors import ConfigError
from jbw.inference.calibration.replications import Model
from jbw.inference.space.box import box
from jbw.inference.space.problem import LogLikelihood, Theta

HALVINGS = 100
FARTHEST = 500.0  # of the unconstrained coordinate, whose exponential is still a number
EDGE = 1e-15  # of the unit interval
WITHOUT = NotImplementedError, ImportError  # NumPyro has none, or has it of another library

Prior = Mapping[str, dist.Distribution]
Simulate = Callable[[Key[Array, ""], Theta], PyTree]


def own_model(simulate: Simulate, log_likelihood: LogLikelihood, prior: Prior) -> Model:
    """The posterior of a simulator, a log likelihood and a prior.

    Raises:
        ConfigError: One of the priors is no distribution of one real number, or has neither
            quantiles nor a cumulative distribution.
    """
    if not isinstance(prior, Mapping):
        raise ConfigError(
            f"Argument `prior` must give a distribution to every parameter's name, not {prior!r}."
        )
    for name, distribution in prior.items():
        _require_quantiles(name, distribution)
    theta = Partial(
        theta_of,
        quantiles={name: _quantile_of(distribution) for name, distribution in prior.items()},
    )

    def simulated(key: Key[Array, ""], u: Theta) -> PyTree:
        return simulate(key, theta(u))

    def terms(u: Theta, data: Any) -> Float[Array, "..."]:
        return jnp.asarray(log_likelihood(theta(u), data))

    return Model(simulated, terms, box(dict.fromkeys(prior, (0.0, 1.0))))


def theta_of(u: Theta, quantiles: Mapping[str, Callable[[Array], Array]]) -> dict[str, Array]:
    """Parameters at the quantiles u of their priors."""
    return {name: of(jnp.clip(u[name], EDGE, 1.0 - EDGE)) for name, of in quantiles.items()}


def _quantile_of(prior: dist.Distribution) -> Callable[[Array], Array]:
    """The quantiles of a prior, its own or by halving its cumulative distribution."""
    try:
        jax.eval_shape(prior.icdf, jnp.asarray(0.5))
    except WITHOUT:
        return partial(_inverted, prior)
    return prior.icdf


def _inverted(prior: dist.Distribution, u: Array) -> Array:
    """A quantile with its derivative, one over the density."""
    onto = biject_to(prior.support)

    def halved(_: int, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = ends
        middle = 0.5 * (low + high)
        below = prior.cdf(onto(middle)) < u
        return jnp.where(below, middle, low), jnp.where(below, high, middle)

    ends = jnp.full_like(u, -FARTHEST), jnp.full_like(u, FARTHEST)
    low, high = jax.lax.fori_loop(0, HALVINGS, halved, stop_gradient(ends))
    quantile = stop_gradient(onto(0.5 * (low + high)))
    return quantile + (u - stop_gradient(u)) / jnp.exp(stop_gradient(prior.log_prob(quantile)))


def _require_quantiles(name: str, prior: Any) -> None:
    kind = type(prior).__name__
    if not isinstance(prior, dist.Distribution) or prior.batch_shape or prior.event_shape:
        raise ConfigError(
            f"The prior of `{name}` must be a NumPyro distribution of one number, but it is a "
            f"{kind}.",
            remedy=f"Write {name} = numpyro.distributions.Normal(0.0, 1.0), one for each number.",
        )
    if prior.is_discrete:
        raise ConfigError(f"The prior of `{name}` must be of a real number, but {kind} counts.")
    middle = jnp.asarray(0.5)
    for function, at in ((prior.icdf, middle), (prior.cdf, biject_to(prior.support)(0.0 * middle))):
        try:
            jax.eval_shape(function, at)
        except WITHOUT:
            continue
        return
    raise ConfigError(
        f"The prior of `{name}` must have quantiles, but NumPyro's {kind} has neither `icdf` nor "
        "`cdf`.",
        remedy="Take one that has, such as Normal, LogNormal, Gamma, Beta or StudentT.",
    )
