"""Importance sampling under vmap: the posteriors of many data sets without a lane that waits."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key, PyTree

from jbw.inference.box import Box
from jbw.inference.bridge import FORBIDDEN, Bridge, bridge
from jbw.inference.kernels import Problem
from jbw.inference.lane_fit import About
from jbw.inference.lanes import Draws, LaneSampler, in_lanes, placed
from jbw.inference.laplace import Whitening
from jbw.inference.model import LogLikelihood

FEW = 0.05  # share of the draws that moments are taken from at least
DEEPEST = 200.0  # nats below the best that a draw is told apart
HALVINGS = 30
NUGGET = 1e-8  # of the variance of the coordinate, where draws coincide


def weighted(
    about: About,
    num_draws: int = 4096,
    num_kept: int = 1000,
    num_groups: int = 4,
    num_rounds: int = 2,
) -> LaneSampler:
    r"""Importance sampling about a located posterior: no lane waits for another.

    $$w_i \propto p(\theta_i \mid D) / t_5(\theta_i)$$

    Every round but the last gives its weighted moments to the t distribution of the next, weights
    flattened where a few would decide. Draws of the last are kept in proportion to their weights,
    in groups that do not know each other. The sampler has arrived where the weights are worth a
    tenth of the draws kept.

    Args:
        about: How to locate the posterior.
        num_draws: Points that are weighed in each round.
        num_kept: Draws that are left of the last.
        num_groups: Groups, which stand for chains.
        num_rounds: Rounds.

    Returns:
        The sampler.

    Reference:
        Cappé et al. (2008), Statistics and Computing 18, 447, with one t distribution.
    """

    def draw(key: Key[Array, ""], log_likelihood: LogLikelihood, box: Box, data: PyTree) -> Draws:
        key_locate, key_rounds, key_keep = jax.random.split(key, 3)
        problem, whitened, theta = placed(key_locate, log_likelihood, box, data, about)

        def placed_by(whitening: Whitening) -> Bridge:
            return bridge(Problem(
                problem.log_likelihood, problem.log_prior, problem.box, data, whitening
            ), whitened)  # fmt: skip

        def weigh(whitening: Whitening, key: Key[Array, ""]) -> tuple[Whitening, Any]:
            way = placed_by(whitening)
            w = way.draw(key, num_draws)
            log_ratio = in_lanes(way.log_ratio, w)
            return _moved(whitening, w, log_ratio), (whitening, w, log_ratio)

        keys = jax.random.split(key_rounds, num_rounds)
        rounds = jax.lax.scan(weigh, problem.whitening, keys)[1]
        whitening, w, log_ratio = jax.tree.map(lambda rows: rows[-1], rounds)
        w = w.reshape(num_groups, -1, len(box.names))
        share = jax.nn.softmax(log_ratio.reshape(num_groups, -1), axis=1)
        keys = jax.random.split(key_keep, num_groups)
        kept = jax.vmap(lambda k, p: _stratified(k, p, num_kept // num_groups))(keys, share)
        drawn = placed_by(whitening).theta(jnp.take_along_axis(w, kept[..., None], axis=1))
        worth = jnp.sum(1 / jnp.sum(share**2, axis=1))
        possible = jnp.any(log_ratio > FORBIDDEN / 2)
        return Draws(theta(drawn), (worth >= num_kept / 10) & possible)

    return draw


def _moved(
    whitening: Whitening, w: Float[Array, "draw parameter"], log_ratio: Float[Array, " draw"]
) -> Whitening:
    """The whitening by the weighted moments of draws."""
    size, d = w.shape
    log_ratio = jnp.maximum(log_ratio, jnp.max(log_ratio) - DEEPEST)

    def worth(power: Float[Array, ""]) -> Float[Array, ""]:
        return 1 / jnp.sum(jax.nn.softmax(power * log_ratio) ** 2)

    def halve(_: int, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = ends
        middle = (low + high) / 2
        enough = worth(middle) >= FEW * size
        return jnp.where(enough, middle, low), jnp.where(enough, high, middle)

    low, _ = jax.lax.fori_loop(0, HALVINGS, halve, (jnp.zeros(()), jnp.ones(())))
    power = jnp.where(worth(jnp.ones(())) >= FEW * size, 1.0, low)
    share = jax.nn.softmax(power * log_ratio)
    mean = share @ w
    covariance = (share[:, None] * (w - mean)).T @ (w - mean)
    root = jnp.linalg.cholesky(covariance + NUGGET * jnp.eye(d))
    factor = whitening.factor @ root
    return Whitening(whitening.centre + whitening.factor @ mean, factor)


def _stratified(
    key: Key[Array, ""], share: Float[Array, " draw"], count: int
) -> Int[Array, " kept"]:
    """Indices in proportion to shares, one from each of `count` equal strata, in random order."""
    key_place, key_order = jax.random.split(key)
    places = (jnp.arange(count) + jax.random.uniform(key_place, (count,))) / count
    found = jnp.searchsorted(jnp.cumsum(share), places)
    return jax.random.permutation(key_order, jnp.minimum(found, share.size - 1))
