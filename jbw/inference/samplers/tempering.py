r"""Adaptive tempered sequential Monte Carlo through BlackJAX, with its evidence.

$$p_\beta(w) \propto r(w)\, e^{\beta \ell(w)}, \qquad 0 = \beta_0 < \dots < \beta_T = 1,
\qquad \log \hat Z = \sum_t \log \frac1N \sum_i e^{(\beta_t - \beta_{t-1}) \ell(w_i)}$$

Particles are carried from a reference density r to the posterior through rising powers of their
ratio. Steps of beta leave six tenths of the particles effective; between them every particle takes
moves of a random walk shaped by the particles' covariance. A chain is a run of its own, so that
R-hat compares independent runs. Descendants of one particle stay neighbours among the draws, where
autocorrelation sees them.

Reference:
    Del Moral, Doucet, Jasra (2006), J. R. Stat. Soc. B 68, 411.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from blackjax.mcmc import random_walk
from blackjax.smc import adaptive_tempered, resampling
from jaxtyping import Array, Bool, Float, Int, Key

from jbw.inference.samplers.chains import over_chains
from jbw.inference.samplers.reference_density import is_possible, log_ratio, reference
from jbw.inference.samplers.sampler import Draws
from jbw.inference.samplers.weights import pooled_evidence
from jbw.inference.space.problem import Problem

TARGET_ESS = 0.6  # share of the particles that a step of the temperature leaves effective
TARGET_ACCEPT = 0.3  # of the moves
MOST_STEPS = 500  # of the temperature; a run that needs more is stopped
NUGGET = 1e-10  # of the variances: particles that coincide have no covariance


class Options(NamedTuple):
    """Options of tempering.

    Attributes:
        num_samples: Particles of each run.
        num_chains: Runs.
        chain_method: How runs share the machine.
        num_moves: Moves of every particle between two temperatures; 5 d + 5 when None.
    """

    num_samples: int = 1000
    num_chains: int = 4
    chain_method: str = "sequential"
    num_moves: int | None = None


class Run(NamedTuple):
    """What one run left.

    Attributes:
        theta: Particles by name.
        log_evidence: Logarithm of the evidence [nats].
        variance: Of log_evidence, as the weights of its steps show it.
        num_steps: Steps of the temperature.
        inverse_temperature: Where it ended; below 1 it never arrived.
        possible: Whether the posterior was possible at any first particle.
    """

    theta: dict[str, Float[Array, " draw"]]
    log_evidence: Float[Array, ""]
    variance: Float[Array, ""]
    num_steps: Int[Array, ""]
    inverse_temperature: Float[Array, ""]
    possible: Bool[Array, ""]


def draw(key: Key[Array, ""], problem: Problem, options: Options) -> Draws:
    """The particles at the end of each run, after moves on the posterior itself."""
    keys = jax.random.split(key, options.num_chains)
    moves = options.num_moves or 5 * len(problem.box.names) + 5

    def one(key: Key[Array, ""], problem: Problem) -> Run:
        return _run(key, problem, options.num_samples, moves)

    found = over_chains(one, options.chain_method)(keys, problem)
    evaluations = (found.num_steps + 1) * options.num_samples * (moves + 3)
    facts = {
        **pooled_evidence(found.log_evidence, found.variance),
        "num_steps": found.num_steps,
        "inverse_temperature": jnp.min(found.inverse_temperature),
        "num_evaluations": jnp.sum(evaluations),
    }
    arrived = jnp.all(found.inverse_temperature >= 1)
    return Draws(found.theta, {}, jnp.all(found.possible), arrived, facts)


class _Carry(NamedTuple):
    key: Key[Array, ""]
    state: Any
    log_scale: Float[Array, ""]
    log_evidence: Float[Array, ""]
    variance: Float[Array, ""]
    num_steps: Int[Array, ""]
    ended: Bool[Array, ""]


def _run(key: Key[Array, ""], problem: Problem, num_particles: int, num_moves: int) -> Run:
    about = reference(problem)

    def ratio(w: Float[Array, " parameter"]) -> Float[Array, ""]:
        return log_ratio(problem, w)

    walk = random_walk.build_additive_step()

    def move(key: Array, state: Any, log_density: Any, factor: Array) -> Any:
        def step(key: Array, y: Array) -> Array:
            return factor @ jax.random.normal(key, y.shape)

        return walk(key, state, log_density, step)

    kernel = adaptive_tempered.build_kernel(
        about.log_prob, ratio, move, random_walk.init, resampling.systematic, TARGET_ESS
    )

    def advance(carry: _Carry) -> _Carry:
        # With no room left for beta, the last step only resamples and moves on the posterior.
        ended = carry.state.tempering_param >= 1
        key, key_step = jax.random.split(carry.key)
        factor = jnp.exp(carry.log_scale) * _root(carry.state.particles, carry.state.weights)
        state, info = kernel(key_step, carry.state, num_moves, {"factor": factor[None]})
        accept = jnp.mean(info.update_info.acceptance_rate)
        return _Carry(
            key,
            state,
            carry.log_scale + accept - TARGET_ACCEPT,
            carry.log_evidence + info.log_likelihood_increment,
            carry.variance + jnp.sum(state.weights**2) - 1 / num_particles,
            carry.num_steps + ~ended,
            ended,
        )

    key, key_draw = jax.random.split(key)
    w = jnp.asarray(about.sample(key_draw, (num_particles,)))
    state = adaptive_tempered.init(w)._replace(tempering_param=jnp.zeros(()))
    possible = is_possible(jax.vmap(ratio)(w))
    log_scale = jnp.log(2.38 / jnp.sqrt(w.shape[1]))
    first = _Carry(
        key, state, log_scale, jnp.zeros(()), jnp.zeros(()), jnp.array(0), jnp.array(False)
    )

    def again(carry: _Carry) -> Bool[Array, ""]:
        return possible & ~carry.ended & (carry.num_steps < MOST_STEPS)

    last = jax.lax.while_loop(again, advance, first)
    beta = last.state.tempering_param
    theta = jax.vmap(problem.theta)(last.state.particles)
    return Run(theta, last.log_evidence, last.variance, last.num_steps, beta, possible)


def _root(
    y: Float[Array, "draw parameter"], weights: Float[Array, " draw"]
) -> Float[Array, "parameter parameter"]:
    """Cholesky factor of the weighted covariance of particles."""
    left = y - weights @ y
    covariance = (weights[:, None] * left).T @ left
    return jnp.linalg.cholesky(covariance + NUGGET * jnp.diag(jnp.diagonal(covariance) + 1e-300))
