r"""The sampler of Teloli et al., section 3.2: a Metropolis-Hastings random walk.

$$x' = x + \sigma_p L \eta, \quad \eta \sim N(0, I); \qquad
P(\text{accept}) = \min\{1, p(x')/p(x)\}\ \text{inside}, \ 0\ \text{outside}$$

A proposal outside of the box repeats the current state, because clipping would break detailed
balance.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from jbw.inference.samplers.chains import Draw, Kernel
from jbw.inference.space.box import named
from jbw.inference.space.problem import Problem, log_density

AVERAGING = 0.75  # exponent of the weights with which step sizes are averaged, as in dual averaging
# Exponent of the gain. With it the sum of the gain diverges, and the sum of its squares converges.
FORGETTING = 0.6
# first step sizes of the warm-up: without a fit; with coordinates that a fit has normalised
FIRST_STEP = (0.1, 1.0)


class Options(NamedTuple):
    """The options of the random walk.

    `step_size` is a proposal's fixed standard deviation in x, in all directions. If None, the
    warm-up tunes it to `target_accept`, with the shape of a fit's covariance.
    """

    num_warmup: int = 1000
    num_samples: int = 1000
    num_chains: int = 4
    chain_method: str = "sequential"
    target_accept: float = 0.5
    step_size: float | None = None


PAPER = Options(num_warmup=85, num_samples=765, step_size=2.5108e-3)
"""The published chain: 850 draws of which 10 % are burn-in, and sigma_p."""


class WalkState(NamedTuple):
    """The state of one random walk after i steps, with the outcome of the last step.

    `log_step` is the log of the proposal's standard deviation in x; its average is used after the
    burn-in. `failed` marks a proposal in the box with no finite density.
    """

    i: Int[Array, ""]
    x: Float[Array, " parameter"]
    log_density: Float[Array, ""]
    log_step: Float[Array, ""]
    log_step_average: Float[Array, ""]
    accept_prob: Float[Array, ""]
    accepted: Bool[Array, ""]
    failed: Bool[Array, ""]
    rng_key: Key[Array, ""]


def kernel(problem: Problem, options: Options) -> Kernel:
    """Return the kernel of the random-walk Metropolis sampler for a problem."""
    unit = problem.unit_coordinate
    shaped = problem.located and options.step_size is None
    # Transform the fit's covariance from the logit to x at its centre, where the slope is x (1 -
    # x).
    centre = jax.nn.sigmoid(problem.whitening.centre)
    scale = (centre * (1 - centre))[:, None] * problem.whitening.factor

    def density(x: Float[Array, " parameter"]) -> Float[Array, ""]:
        return log_density(problem, unit, x)

    def init(key: Key[Array, ""], w: Float[Array, " parameter"]) -> WalkState:
        x = jax.nn.sigmoid(problem.whitening.forward(w))
        first = FIRST_STEP[shaped] if options.step_size is None else options.step_size
        log_step = jnp.log(jnp.asarray(first, dtype=float))
        none, no = jnp.zeros(()), jnp.array(False)
        return WalkState(jnp.array(0), x, density(x), log_step, log_step, none, no, no, key)

    def step(state: WalkState) -> WalkState:
        rng_key, key_proposal, key_accept = jax.random.split(state.rng_key, 3)
        move = jax.random.normal(key_proposal, state.x.shape)
        proposal = state.x + jnp.exp(state.log_step) * (scale @ move if shaped else move)
        inside = jnp.all((proposal >= 0) & (proposal <= 1))
        # Evaluate the model inside the prior range, even if the proposal will be rejected.
        proposed = density(jnp.where(inside, proposal, state.x))
        failed = ~jnp.isfinite(proposed)
        ratio = jnp.exp(jnp.minimum(proposed - state.log_density, 0.0))
        accept_prob = jnp.where(inside & ~failed, ratio, 0.0)
        accepted = jax.random.uniform(key_accept) < accept_prob
        log_step, average = tuned(state, accept_prob, options)
        return WalkState(
            state.i + 1,
            jnp.where(accepted, proposal, state.x),
            jnp.where(accepted, proposed, state.log_density),
            log_step,
            average,
            accept_prob,
            accepted,
            inside & failed,
            rng_key,
        )

    def read(state: WalkState) -> Draw:
        stats = {
            "acceptance_rate": state.accept_prob,
            "accepted": state.accepted,
            "failed": state.failed,
            "step_size": jnp.exp(state.log_step),
        }
        return Draw(named(unit.forward(state.x), problem.box), stats)

    return Kernel(init, step, read)


def tuned(
    state: WalkState, accept_prob: Float[Array, ""], options: Options
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Return the next log step size by the Robbins-Monro rule, and its average."""
    if options.step_size is not None:
        return state.log_step, state.log_step_average
    t = state.i + 1.0
    log_step = state.log_step + 2 * t**-FORGETTING * (accept_prob - options.target_accept)
    weight = t**-AVERAGING
    average = weight * log_step + (1 - weight) * state.log_step_average
    last = state.i + 1 >= options.num_warmup
    tuning = state.i < options.num_warmup
    return (
        jnp.where(tuning, jnp.where(last, average, log_step), state.log_step),
        jnp.where(tuning, average, state.log_step_average),
    )
