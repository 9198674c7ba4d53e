"""Samplers that run under vmap: the posteriors of many data sets at once, one lane each."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key, PyTree

from jbw.errors import ConfigError
from jbw.inference.box import Box
from jbw.inference.bridge import FORBIDDEN, bridge
from jbw.inference.chains import advance_chains, start_chains
from jbw.inference.kernels import Problem, Settings
from jbw.inference.lane_fit import About, locate
from jbw.inference.laplace import no_whitening
from jbw.inference.model import LogLikelihood, Theta
from jbw.inference.random_walk import PAPER
from jbw.inference.start import OVERDISPERSION
from jbw.inference.tempering import runs

TOGETHER = 64  # points evaluated side by side
WIDE = 8.0  # standard deviations to either side that a second grid spans
CHAINS = ("nuts", "random_walk", "random_walk_paper", "elliptical_slice")


class Draws(NamedTuple):
    """Draws from one posterior.

    Attributes:
        theta: By name, chains or runs that do not know each other along the first axis.
        arrived: Whether the sampler came to its end: a possible start, the whole likelihood.
    """

    theta: dict[str, Float[Array, "chain draw"]]
    arrived: Bool[Array, ""]


LaneSampler = Callable[[Key[Array, ""], LogLikelihood, Box, PyTree], Draws]


def tempered(
    num_particles: int = 512,
    num_runs: int = 2,
    num_moves: int | None = None,
    about: About | None = None,
) -> LaneSampler:
    """Tempered sequential Monte Carlo, from the whole prior or about a located posterior.

    Args:
        num_particles: Particles of each run.
        num_runs: Independent runs.
        num_moves: Moves of every particle between two temperatures; 5 d + 5 when None.
        about: How to locate the posterior; from the whole box when None.

    Returns:
        The sampler.
    """

    def draw(key: Key[Array, ""], log_likelihood: LogLikelihood, box: Box, data: PyTree) -> Draws:
        key_locate, key_runs = jax.random.split(key)
        moves = 5 * len(box.names) + 5 if num_moves is None else num_moves
        problem, whitened, theta = placed(key_locate, log_likelihood, box, data, about)
        keys = jax.random.split(key_runs, num_runs)
        found = runs(keys, problem, num_particles, moves, whitened, "vectorized")
        drawn = theta(bridge(problem, whitened).theta(found.y))
        return Draws(drawn, jnp.all(found.possible & (found.inverse_temperature >= 1)))

    return draw


def chains(
    sampler: str,
    num_warmup: int = 500,
    num_samples: int = 500,
    num_chains: int = 4,
    about: About | None = None,
) -> LaneSampler:
    """Markov chains, dispersed over the prior or about a located posterior.

    Args:
        sampler: "nuts", "random_walk", "random_walk_paper" or "elliptical_slice".
        num_warmup: Steps of adaptation, discarded.
        num_samples: Draws kept of each chain.
        num_chains: Chains.
        about: How to locate the posterior; chains start over the whole box when None.

    Returns:
        The sampler.

    Raises:
        ConfigError: An unknown sampler, or elliptical slices about nothing.
    """
    if sampler not in CHAINS:
        raise ConfigError(
            f"Argument `sampler` must be one of {', '.join(CHAINS)}, not {sampler!r}."
        )
    if sampler == "elliptical_slice" and about is None:
        raise ConfigError(
            "Sampler elliptical_slice needs to know where the posterior lies, but `about` is None."
        )
    paper = sampler == "random_walk_paper"
    settings = Settings(
        sampler="random_walk" if paper else sampler,
        num_warmup=num_warmup,
        chain_method="vectorized",
        target_accept=0.8 if sampler == "nuts" else 0.3,
        step_size=PAPER.step_size if paper else None,
        adapt_mass=True,
        whitened=about is not None,
        forward_mode=False,
        max_tree_depth=8,
    )

    def draw(key: Key[Array, ""], log_likelihood: LogLikelihood, box: Box, data: PyTree) -> Draws:
        key_locate, key_chains = jax.random.split(key)
        problem, whitened, theta = placed(key_locate, log_likelihood, box, data, about)
        z = jnp.tile(problem.whitening.centre, (num_chains, 1))
        spread = jnp.asarray(OVERDISPERSION if whitened else 1.0)
        keys = jax.random.split(key_chains, num_chains)
        states, possible = start_chains(keys, z, spread, problem, settings)
        count = jnp.asarray(num_warmup)
        # One row: what is written beyond it is dropped, which is what becomes of warm-up.
        states, _ = advance_chains(states, count, 1, problem, settings)
        count = jnp.asarray(num_samples)
        _, drawn = advance_chains(states, count, num_samples, problem, settings)
        return Draws(theta(drawn.theta), jnp.all(possible))

    return draw


def in_lanes(f: Callable[[PyTree], Array], points: PyTree) -> Array:
    """Map a function over points, 64 side by side, compiled once whatever their number.

    Args:
        f: Of one point.
        points: Arrays with a leading axis.
    """
    count = len(jax.tree.leaves(points)[0])
    missing = -count % TOGETHER
    padded = jax.tree.map(lambda v: jnp.concatenate([v, v[:1].repeat(missing, 0)]), points)
    return jax.lax.map(f, padded, batch_size=TOGETHER)[:count]


def gridded(num_nodes: int = 512, num_draws: int = 1000, num_groups: int = 4) -> LaneSampler:
    """Quadrature of one parameter on two grids: over the whole box, then where the mass lies.

    Draws are independent, by the inverse distribution function of the second grid.

    Args:
        num_nodes: Nodes of each grid; the posterior is overlooked that falls between two.
        num_draws: Draws.
        num_groups: Groups, which stand for chains.

    Returns:
        The sampler.
    """

    def draw(key: Key[Array, ""], log_likelihood: LogLikelihood, box: Box, data: PyTree) -> Draws:
        if len(box.names) != 1:
            raise ConfigError(
                f"Sampler quadrature takes one parameter here, but the posterior has "
                f"{len(box.names)}.",
                remedy="Use importance or tempered_smc.",
            )

        def density(theta: Float[Array, " node"]) -> Float[Array, " node"]:
            def one(value: Float[Array, ""]) -> Float[Array, ""]:
                return jnp.sum(log_likelihood({box.names[0]: value}, data))

            value = in_lanes(one, theta)
            return jnp.where(jnp.isfinite(value), value, FORBIDDEN)

        lower, upper = box.lower[0], box.upper[0]
        nodes = jnp.linspace(lower, upper, num_nodes)
        p = jax.nn.softmax(density(nodes))
        mean = jnp.sum(p * nodes)
        sd = jnp.sqrt(jnp.sum(p * (nodes - mean) ** 2)) + (upper - lower) / num_nodes
        ends = jnp.clip(jnp.stack([mean - WIDE * sd, mean + WIDE * sd]), lower, upper)
        nodes = jnp.linspace(ends[0], ends[1], num_nodes)
        log_p = density(nodes)
        p = jnp.exp(log_p - jnp.max(log_p))
        cumulated = jnp.concatenate([jnp.zeros(1), jnp.cumsum((p[1:] + p[:-1]) / 2)])
        share = jax.random.uniform(key, (num_groups, num_draws // num_groups))
        drawn = jnp.interp(share * cumulated[-1], cumulated, nodes)
        return Draws({box.names[0]: drawn}, jnp.max(log_p) > FORBIDDEN / 2)

    return draw


class Placed(NamedTuple):
    """A posterior in the coordinate that it is drawn in, and the way back."""

    problem: Problem
    whitened: bool
    theta: Callable[[Theta], dict[str, Array]]


def placed(
    key: Key[Array, ""],
    log_likelihood: LogLikelihood,
    box: Box,
    data: PyTree,
    about: About | None,
) -> Placed:
    """Place a posterior in the coordinate that it is drawn in.

    Args:
        key: Random key.
        log_likelihood: (theta, data) to terms [nats].
        box: Prior bounds.
        data: Whatever the likelihood takes.
        about: How to locate it; the whole box when None.
    """
    if about is None:
        whitening = no_whitening(len(box.names))
        return Placed(Problem(log_likelihood, None, box, data, whitening), False, dict)
    found = locate(key, about, log_likelihood, box, data)
    problem = Problem(found.log_likelihood, found.log_prior, found.box, data, found.whitening)
    return Placed(problem, True, found.theta)
