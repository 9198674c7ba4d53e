r"""Sequential Monte Carlo with rising powers of the likelihood and its evidence, by BlackJAX.

$$p_\beta(w) \propto r(w)\, e^{\beta \ell(w)}, \qquad 0 = \beta_0 < \dots < \beta_T = 1,
\qquad \log \hat Z = \sum_t \log \frac1N \sum_i e^{(\beta_t - \beta_{t-1}) \ell(w_i)}$$

Particles move from a reference density r to the posterior through rising powers of their ratio.
Between these steps every particle takes moves of a random walk with the shape of the particles'
covariance. A chain is a separate run, so that R-hat compares independent runs. Descendants of one
particle stay neighbours among the draws, where autocorrelation detects them.

Reference:
    Del Moral, Doucet, Jasra (2006), J. R. Stat. Soc. B 68, 411.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from blackjax.mcmc import random_walk
from blackjax.smc import adaptive_tempered, resampling
from jaxtyping import Array, Bool, Float, Int, Key

from jbw.inference.samplers.chains import Draws, over_chains
from jbw.inference.samplers.evidence import (
    is_possible,
    log_ratio,
    pooled_evidence,
    reference,
    weighted_moments,
)
from jbw.inference.space.problem import Problem

# effective fraction of the particles that remains after each change of the likelihood's power
TARGET_ESS = 0.6
TARGET_ACCEPT = 0.3  # target acceptance rate of the particles' moves
MOST_STEPS = 500  # largest number of powers of the likelihood between 0 and 1
NUGGET = 1e-10  # relative increase of variances, in case particles coincide


class Options(NamedTuple):
    """The options of tempering: numbers of particles, runs, and moves per likelihood power.

    A particle takes `num_moves` moves at each temperature, 5 d + 5 if None.
    """

    num_samples: int = 1000
    num_chains: int = 4
    chain_method: str = "sequential"
    num_moves: int | None = None


def draw(key: Key[Array, ""], problem: Problem, options: Options) -> Draws:
    """Return equally weighted particles of several runs, with the evidence."""
    keys = jax.random.split(key, options.num_chains)
    moves = options.num_moves or 5 * len(problem.box.names) + 5

    def single_run(key: Key[Array, ""], problem: Problem) -> tuple[Any, _State, Array]:
        return _run(key, problem, options.num_samples, moves)

    theta, runs, possible = over_chains(single_run, options.chain_method)(keys, problem)
    beta = runs.particles.tempering_param
    facts = {
        **pooled_evidence(runs.log_evidence, runs.variance),
        "num_steps": runs.num_steps,
        "inverse_temperature": jnp.min(beta),
        "num_evaluations": jnp.sum((runs.num_steps + 1) * options.num_samples * (moves + 3)),
    }
    return Draws(theta, {}, jnp.all(possible), jnp.all(beta >= 1), facts)


class _State(NamedTuple):
    """The state of a run: key, particles, length of moves, evidence [nats] with variance."""

    key: Key[Array, ""]
    particles: Any
    log_scale: Float[Array, ""]
    log_evidence: Float[Array, ""]
    variance: Float[Array, ""]
    num_steps: Int[Array, ""]
    ended: Bool[Array, ""]


def _run(
    key: Key[Array, ""], problem: Problem, num_particles: int, num_moves: int
) -> tuple[dict[str, Float[Array, " draw"]], _State, Bool[Array, ""]]:
    """Return the final particles and state, and whether any first particle had positive density."""
    reference_density = reference(problem)
    ratio = partial(log_ratio, problem)
    walk = random_walk.build_additive_step()

    def move(key: Array, state: Any, log_density: Any, factor: Array) -> Any:
        def step(key: Array, y: Array) -> Array:
            return factor @ jax.random.normal(key, y.shape)

        return walk(key, state, log_density, step)

    kernel = adaptive_tempered.build_kernel(
        reference_density.log_prob, ratio, move, random_walk.init, resampling.systematic, TARGET_ESS
    )

    def advance(at: _State) -> _State:
        # At beta = 1, the last step only resamples and moves on the posterior.
        ended = at.particles.tempering_param >= 1
        key, key_step = jax.random.split(at.key)
        covariance = weighted_moments(at.particles.weights, at.particles.particles)[1]
        nugget = NUGGET * jnp.diag(jnp.diagonal(covariance) + 1e-300)
        factor = jnp.exp(at.log_scale) * jnp.linalg.cholesky(covariance + nugget)
        particles, step_info = kernel(key_step, at.particles, num_moves, {"factor": factor[None]})
        accept = jnp.mean(step_info.update_info.acceptance_rate)
        return _State(
            key,
            particles,
            at.log_scale + accept - TARGET_ACCEPT,
            at.log_evidence + step_info.log_likelihood_increment,
            at.variance + jnp.sum(particles.weights**2) - 1 / num_particles,
            at.num_steps + ~ended,
            ended,
        )

    key, key_draw = jax.random.split(key)
    w = jnp.asarray(reference_density.sample(key_draw, (num_particles,)))
    particles = adaptive_tempered.init(w)._replace(tempering_param=jnp.zeros(()))
    possible = is_possible(jax.vmap(ratio)(w))
    log_scale = jnp.log(2.38 / jnp.sqrt(w.shape[1]))
    zero = jnp.zeros(())
    first = _State(key, particles, log_scale, zero, zero, jnp.array(0), jnp.array(False))

    def unfinished(at: _State) -> Bool[Array, ""]:
        return possible & ~at.ended & (at.num_steps < MOST_STEPS)

    last = jax.lax.while_loop(unfinished, advance, first)
    return jax.vmap(problem.theta)(last.particles.particles), last, possible
