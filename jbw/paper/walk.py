r"""The random walk of Metropolis and Hastings as section 3.2 has it, in a box of uniform priors.

$$\theta = (1 - x)\,\theta_{min} + x\,\theta_{max}, \qquad x' = x + \sigma_p \eta, \quad
  \eta \sim N(0, I)$$
"""

from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key

from jbw.errors import ConfigError
from jbw.inference.samplers.random_walk import PAPER, Options, kernel
from jbw.inference.space.box import Box, box, require_float64
from jbw.inference.space.problem import problem_of
from jbw.inference.space.reparametrisation import in_box
from jbw.oscillator.checks import require_at_least
from jbw.paper.likelihoods import Prior, Theta, unit_of

STEP_SIZE = PAPER.step_size
"""Standard deviation sigma_p of the paper's proposals, in x [-]."""


class Walk(eqx.Module):
    """Draws of one random walk, its burn-in left out.

    Attributes:
        theta: Draws by name of the parameter.
        log_density: Log posterior density of each draw [nats].
        accepted: Whether the step that led to the draw was accepted.
    """

    theta: dict[str, Float[Array, " draw"]]
    log_density: Float[Array, " draw"]
    accepted: Bool[Array, " draw"]

    @property
    def map(self) -> Theta:
        """The draw of the greatest density."""
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
    r"""One chain of the paper's sampler.

    A proposal outside the box is rejected and the state repeated. 850 steps of the published size
    cannot cross the box: the draws then show where the walk began, not the posterior. Run several
    chains from dispersed starts, or let the step be tuned.

    Args:
        key: Random key.
        log_likelihood: Log likelihood of theta, terms to be summed [nats].
        prior: Bounds of each parameter's uniform prior.
        start: Where the chain starts, inside the prior.
        num_steps: Steps in all.
        burn_in: Part of the steps that is left out at the beginning [-].
        step_size: Standard deviation sigma_p of the proposals in x [-]; None tunes it during the
            burn-in until half of the proposals are accepted.

    Returns:
        The draws after the burn-in.

    Raises:
        ConfigError: A prior is no pair of finite numbers, `start` lies outside, an option is out of
            range, or JAX runs in float32.

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
    """Every step of one chain."""

    def terms(theta: Any, _: Any) -> Array:
        return log_likelihood(theta)

    problem = problem_of(terms, bounds, None, in_box(bounds, None, None, 1))
    chain = kernel(problem, options)

    def onward(state: Any, _: None) -> tuple[Any, tuple]:
        state = chain.step(state)
        return state, (chain.read(state).theta, state.log_density, state.accepted)

    state = chain.init(key, jnp.log(x) - jnp.log1p(-x))
    return Walk(*jax.lax.scan(onward, state, length=options.num_samples)[1])
