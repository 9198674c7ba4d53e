"""Adaptive tempered sequential Monte Carlo through BlackJAX, with its evidence."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from blackjax.mcmc import random_walk
from blackjax.smc import adaptive_tempered, resampling
from jaxtyping import Array, Bool, Float, Int, Key

from jbw.inference.bridge import FORBIDDEN, Bridge, Drawn, bridge, require_possible
from jbw.inference.chains import over_chains
from jbw.inference.evidence import pooled_evidence
from jbw.inference.kernels import Problem

TARGET_ESS = 0.6  # share of the particles that a step of the temperature leaves effective
TARGET_ACCEPT = 0.3  # of the moves
MOST_STEPS = 500  # of the temperature; a run that needs more is stopped
NUGGET = 1e-10  # of the variances: particles that coincide have no covariance


class Run(NamedTuple):
    """What one run left.

    Attributes:
        y: Particles, in the coordinate of the bridge.
        log_evidence: Logarithm of the evidence [nats].
        variance: Of log_evidence, as the weights of its steps show it.
        num_steps: Steps of the temperature.
        inverse_temperature: Where it ended; below 1 it never arrived.
        possible: Whether the posterior was possible at any first particle.
    """

    y: Float[Array, "... draw parameter"]
    log_evidence: Float[Array, "..."]
    variance: Float[Array, "..."]
    num_steps: Int[Array, "..."]
    inverse_temperature: Float[Array, "..."]
    possible: Bool[Array, "..."]


def tempered_draws(
    key: Key[Array, ""],
    problem: Problem,
    num_samples: int,
    num_chains: int,
    *,
    whitened: bool,
    chain_method: str,
) -> Drawn:
    r"""Carry particles from a reference to the posterior through rising powers of their ratio.

    $$p_\beta(y) \propto r(y)\, e^{\beta \ell(y)}, \qquad 0 = \beta_0 < \dots < \beta_T = 1,
    \qquad \log \hat Z = \sum_t \log \frac1N \sum_i e^{(\beta_t - \beta_{t-1}) \ell(y_i)}$$

    Steps of beta leave six tenths of the particles effective; between them every particle takes
    5 d + 5 moves of a random walk shaped by the particles' covariance. A chain is a run of its own,
    so that R-hat compares independent runs. Descendants of one particle stay neighbours among the
    draws, where autocorrelation sees them.

    Args:
        key: Random key.
        problem: The posterior.
        num_samples: Particles of each run.
        num_chains: Runs.
        whitened: Whether to start from the Laplace approximation instead of the whole box.
        chain_method: How runs share the machine.

    Returns:
        The particles at the end, after moves on the posterior itself.

    Reference:
        Del Moral, Doucet, Jasra (2006), J. R. Stat. Soc. B 68, 411.
    """
    d = len(problem.box.names)
    num_moves = 5 * d + 5
    keys = jax.random.split(key, num_chains)
    found = runs(keys, problem, num_samples, num_moves, whitened, chain_method)
    require_possible(bool(np.all(found.possible)))
    theta = bridge(problem, whitened).theta(found.y)
    evaluations = (np.asarray(found.num_steps) + 1) * num_samples * (num_moves + 3)
    return Drawn(
        {name: np.asarray(values) for name, values in theta.items()},
        {},
        {
            **pooled_evidence(np.asarray(found.log_evidence), np.asarray(found.variance)),
            "num_steps": [int(n) for n in found.num_steps],
            "inverse_temperature": float(np.min(found.inverse_temperature)),
            "num_evaluations": int(np.sum(evaluations)),
        },
    )


@eqx.filter_jit
def runs(
    keys: Key[Array, " chain"],
    problem: Problem,
    num_particles: int,
    num_moves: int,
    whitened: bool,
    chain_method: str,
) -> Run:
    """Independent runs, usable under jit and vmap.

    Args:
        keys: One key a run.
        problem: The posterior.
        num_particles: Particles of each run.
        num_moves: Moves of every particle between two temperatures.
        whitened: Whether to start from the Laplace approximation instead of the whole box.
        chain_method: How runs share the machine.
    """

    def one(key: Key[Array, ""], problem: Problem) -> Run:
        return _run(key, bridge(problem, whitened), num_particles, num_moves)

    return over_chains(one, chain_method)(keys, problem)


class _Carry(NamedTuple):
    key: Key[Array, ""]
    state: Any
    log_scale: Float[Array, ""]
    log_evidence: Float[Array, ""]
    variance: Float[Array, ""]
    num_steps: Int[Array, ""]


def _run(key: Key[Array, ""], way: Bridge, num_particles: int, num_moves: int) -> Run:
    walk = random_walk.build_additive_step()

    def move(key: Array, state: Any, log_density: Any, factor: Array) -> Any:
        def step(key: Array, y: Array) -> Array:
            return factor @ jax.random.normal(key, y.shape)

        return walk(key, state, log_density, step)

    kernel = adaptive_tempered.build_kernel(
        way.log_reference, way.log_ratio, move, random_walk.init, resampling.systematic, TARGET_ESS
    )

    def advance(carry: _Carry) -> _Carry:
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
            carry.num_steps + 1,
        )

    key, key_draw = jax.random.split(key)
    y = way.draw(key_draw, num_particles)
    state = adaptive_tempered.init(y)._replace(tempering_param=jnp.zeros(()))
    possible = jnp.any(jax.vmap(way.log_ratio)(y) > FORBIDDEN / 2)
    log_scale = jnp.log(2.38 / jnp.sqrt(y.shape[1]))
    first = _Carry(key, state, log_scale, jnp.zeros(()), jnp.zeros(()), jnp.array(0))

    def again(carry: _Carry) -> Bool[Array, ""]:
        return possible & (carry.state.tempering_param < 1) & (carry.num_steps < MOST_STEPS)

    last = jax.lax.while_loop(again, advance, first)
    beta = last.state.tempering_param
    # With no room left for beta one more step only resamples and moves on the posterior.
    y = advance(last).state.particles
    return Run(y, last.log_evidence, last.variance, last.num_steps, beta, possible)


def _root(
    y: Float[Array, "draw parameter"], weights: Float[Array, " draw"]
) -> Float[Array, "parameter parameter"]:
    """Cholesky factor of the weighted covariance of particles."""
    left = y - weights @ y
    covariance = (weights[:, None] * left).T @ left
    return jnp.linalg.cholesky(covariance + NUGGET * jnp.diag(jnp.diagonal(covariance) + 1e-300))
