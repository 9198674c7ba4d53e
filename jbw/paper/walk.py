r"""The random walk of Metropolis and Hastings, Section 3.2, and its draws relative to the prior.

In a box of uniform priors the walk proposes

$$\theta = (1 - x)\,\theta_{min} + x\,\theta_{max}, \qquad x' = x + \sigma_p \eta, \quad
  \eta \sim N(0, I)$$

The coefficient of variation and the Kullback-Leibler divergence show what the data add to the
prior.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import log_ndtr
from jaxtyping import Array, ArrayLike, Bool, Float, Key
from scipy.special import ndtri
from scipy.stats import rankdata

from jbw.errors import ConfigError, DataError
from jbw.inference.posterior.summary import kl_from_uniform
from jbw.inference.samplers.random_walk import PAPER, Options, kernel
from jbw.inference.space.box import Box, box, require_float64
from jbw.inference.space.problem import problem_of
from jbw.inference.space.reparametrisation import in_box
from jbw.oscillator.checks import is_concrete, require_at_least
from jbw.paper.likelihoods import Prior, Theta, unit_of

STEP_SIZE = PAPER.step_size
"""Standard deviation sigma_p of the paper's proposals, in x [-]."""

Real = Float[ArrayLike, "..."]


class Walk(eqx.Module):
    """The draws of one random walk, without its burn-in.

    Attributes:
        theta: Draws by parameter name.
        log_density: Log posterior density of each draw [nats].
        accepted: Whether the proposal at each draw was accepted.
    """

    theta: dict[str, Float[Array, " draw"]]
    log_density: Float[Array, " draw"]
    accepted: Bool[Array, " draw"]

    @property
    def map(self) -> Theta:
        """The draw of greatest posterior density."""
        best = jnp.argmax(self.log_density)
        return {name: draws[best] for name, draws in self.theta.items()}


def random_walk(
    key: Key[Array, ""],
    log_likelihood: Callable[[Theta], Float[Array, "..."]],
    prior: Prior,
    start: Mapping[str, float],
    *,
    num_steps: int = 850,
    burn_in: float = 0.1,
    step_size: float | None = STEP_SIZE,
) -> Walk:
    r"""Return one chain of the random-walk sampler of Teloli et al.

    A proposal outside the box is rejected and the state repeated. 850 steps of the published size
    cannot cross the box: the draws then show the starting values, not the posterior. Run several
    chains from dispersed starts, or let the step size be tuned.

    Args:
        key: Random key.
        log_likelihood: Log likelihood of theta, terms to be summed [nats].
        prior: Bounds of each parameter's uniform prior.
        start: Starting values of the chain, inside the prior.
        num_steps: Total number of steps.
        burn_in: Fraction of the steps that is discarded at the beginning [-].
        step_size: Standard deviation sigma_p of the proposals in x [-]; None tunes it during the
            burn-in until half of the proposals are accepted.

    Returns:
        The draws after the burn-in.

    Raises:
        ConfigError: A prior is not a pair of finite numbers, `start` lies outside, an option is out
            of range, or JAX runs in float32.

    Reference:
        Section 3.2.
    """
    require_float64()
    require_at_least("num_steps", num_steps, 2)
    if not 0.0 <= burn_in < 1.0:
        raise ConfigError(f"`burn_in` must be from 0 to below 1, but is {burn_in:g}.")
    if step_size is not None:
        require_at_least("step_size", step_size, 0.0, open_end=True)
    bounds = box(prior)
    options = Options(round(burn_in * num_steps), num_steps, step_size=step_size)
    walked = _walk(key, log_likelihood, bounds, unit_of(start, bounds), options)
    return jax.tree.map(lambda values: values[options.num_warmup :], walked)


@eqx.filter_jit
def _walk(
    key: Key[Array, ""],
    log_likelihood: Callable[[Theta], Float[Array, "..."]],
    bounds: Box,
    x: Float[Array, " parameter"],
    options: Options,
) -> Walk:
    """Return the states of one chain after every step."""

    def terms(theta: Any, _: Any) -> Array:
        return log_likelihood(theta)

    problem = problem_of(terms, bounds, None, in_box(bounds, None, None, 1))
    chain = kernel(problem, options)

    def onward(state: Any, _: None) -> tuple[Any, tuple]:
        state = chain.step(state)
        return state, (chain.read(state).theta, state.log_density, state.accepted)

    state = chain.init(key, jnp.log(x) - jnp.log1p(-x))
    return Walk(*jax.lax.scan(onward, state, length=options.num_samples)[1])


def coefficient_of_variation(draws: Float[ArrayLike, "... draw"]) -> Float[Array, "..."]:
    r"""Return the coefficient of variation of draws: sd divided by the modulus of the mean.

    Args:
        draws: Draws of a parameter.

    Returns:
        CV [-].

    Reference:
        Section 3.2 and Table 1.
    """
    draws = jnp.asarray(draws, float)
    return jnp.std(draws, axis=-1, ddof=1) / jnp.abs(jnp.mean(draws, axis=-1))


def kl_normal(mean: Real, std: Real, lower: Real = 0.0, upper: Real = 1.0) -> Float[Array, "..."]:
    r"""Return the KL divergence of a normal truncated at the prior's bounds from a uniform prior.

    $$D = -\left[\ln(\sqrt{2\pi e}\,s\,C) + \frac{a\phi(a) - b\phi(b)}{2C}\right], \quad
      a = -\mu/s, \quad b = (1 - \mu)/s, \quad C = \Phi(b) - \Phi(a)$$

    with mu and s in the unit coordinate x = (theta - lower)/(upper - lower).

    Args:
        mean: Mean of the normal distribution before truncation.
        std: Standard deviation of the normal distribution before truncation.
        lower: Lower bound of the prior.
        upper: Upper bound of the prior.

    Returns:
        Divergence [nats].

    Raises:
        ConfigError: The prior has no width, or `std` is not positive.

    Reference:
        Section 3.2, corrected: a CV of 0.6 to 1 % needs at least 2.1 to 2.8 nats, printed 0.36.
    """
    mean, std, lower, upper = (jnp.asarray(x, float) for x in (mean, std, lower, upper))
    _require_width(lower, upper)
    require_at_least("std", std, 0.0, open_end=True)
    mu, s = (mean - lower) / (upper - lower), std / (upper - lower)
    # If both ends lie in the upper tail, mirror them, so that their difference keeps its digits.
    mu = jnp.where(mu < 0.0, 1.0 - mu, mu)
    a, b = -mu / s, (1.0 - mu) / s
    log_c = log_ndtr(b) + jnp.log1p(-jnp.exp(log_ndtr(a) - log_ndtr(b)))
    phi_a, phi_b = (jnp.exp(-0.5 * x**2 - log_c) / math.sqrt(2 * math.pi) for x in (a, b))
    edge = (a * phi_a - b * phi_b) / 2
    return -(0.5 * math.log(2 * math.pi * math.e) + jnp.log(s) + log_c + edge)


def kl_draws(draws: Float[ArrayLike, " draw"], lower: float = 0.0, upper: float = 1.0) -> float:
    r"""Return the KL divergence of one parameter's draws from its uniform prior.

    $$D = -h(x), \qquad x = \frac{\theta - \theta_{min}}{\theta_{max} - \theta_{min}}$$

    The result, in NumPy, is infinite where a value repeats more often than a spacing spans.

    Args:
        draws: Draws of one parameter, with repeated ones.
        lower: Lower bound of the prior.
        upper: Upper bound of the prior.

    Returns:
        Divergence [nats]; sometimes slightly below zero for draws of the prior itself.

    Raises:
        ConfigError: The prior has no width.
        DataError: A draw lies outside the prior, or there are fewer than two.

    Reference:
        Section 3.2, corrected: gamma, whose CV is the largest, gains the least and not the most.
    """
    _require_width(lower, upper)
    values = np.asarray(draws, float).ravel()
    if values.size < 2:
        raise DataError(f"A divergence needs at least 2 draws, but has {values.size}.")
    if not np.all((values >= lower) & (values <= upper)):
        raise DataError(
            f"Draws must lie in the prior [{lower:g}, {upper:g}], but reach from "
            f"{np.min(values):g} to {np.max(values):g}."
        )
    return kl_from_uniform((values - lower) / (upper - lower))


def kl_joint(
    draws: Float[ArrayLike, "draw parameter"],
    lower: Float[ArrayLike, "..."] = 0.0,
    upper: Float[ArrayLike, "..."] = 1.0,
) -> float:
    r"""Return the joint KL divergence of several parameters' draws from their uniform priors.

    $$D = \sum_i D_i - \tfrac12 \log\det R$$

    R is the correlation of the normal scores of the ranks. The result, in NumPy, is exact for a
    Gaussian posterior inside the box and for independent parameters of any shape.

    Args:
        draws: Draws, one column per parameter.
        lower: Lower bound of each prior, or one bound for all.
        upper: Upper bound of each prior, or one bound for all.

    Returns:
        Divergence [nats], at least the sum of the marginal ones.

    Raises:
        ConfigError: A prior has no width.
        DataError: A draw lies outside its prior, or there are fewer than two.

    Reference:
        Section 3.2, corrected: the marginal divergences alone leave out the correlation.
    """
    values = np.asarray(draws, float)
    num_draws, num_parameters = values.shape
    bounds = np.broadcast_arrays(lower, upper, np.empty(num_parameters))[:2]
    marginal = sum(
        kl_draws(x, float(a), float(b)) for x, a, b in zip(values.T, *bounds, strict=True)
    )
    scores = ndtri((rankdata(values, axis=0) - 0.5) / num_draws)
    correlation = np.atleast_2d(np.corrcoef(scores, rowvar=False))
    return marginal - 0.5 * float(np.linalg.slogdet(correlation)[1])


def _require_width(lower: Real, upper: Real) -> None:
    if is_concrete(lower, upper) and not np.all(np.asarray(upper) > np.asarray(lower)):
        raise ConfigError(
            "The prior must have a width above zero for a divergence, but reaches from "
            f"{np.asarray(lower)} to {np.asarray(upper)}.",
            remedy="Give `lower` below `upper`.",
        )
