r"""Pareto-smoothed importance sampling around a Gaussian approximation, with the evidence.

$$w_i = \frac{p(D | \theta_i)\,\pi(\theta_i)}{t_5(\theta_i)}, \qquad
\hat Z = \frac1N \sum_i w_i, \qquad \mathrm{se}(\log\hat Z)^2 = \frac{1}{N_{eff}} - \frac1N$$

Draws of Student's t distribution around a fit are weighted by the posterior, and resampled in
proportion to their weights. All points are known beforehand, so that under `vmap` no posterior
waits for another.

Reference:
    Vehtari et al. (2024), JMLR 25, 72; for the t distribution, Geweke (1989), Econometrica 57; for
    several rounds, Cappé et al. (2008), Statistics and Computing 18, 447.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key
from numpy.typing import NDArray

from jbw.inference.samplers.chains import Draws, in_batches
from jbw.inference.samplers.evidence import (
    FORBIDDEN,
    effective_draws,
    highest_power,
    is_possible,
    log_ratio,
    reference,
    weighted_moments,
)
from jbw.inference.space.coordinates import Affine
from jbw.inference.space.problem import Problem

FEW = 0.05  # smallest effective fraction of the draws from which moments are computed
DEEPEST = 200.0  # lowest log weight that is used, relative to the highest [nats]
HALVINGS = 30  # number of bisections for the power of the weights that makes them more equal
SMALLEST = -700.0  # finite log weight that represents zero weight
NUGGET = 1e-8  # variance that is added to the coordinates in case draws coincide
# Sampling succeeds if effective draws are at least this fraction of the returned draws.
ENOUGH = 0.1


class Options(NamedTuple):
    """The options of importance sampling: numbers of draws, weighted points and rounds.

    `num_draws` is the number of weighted points of each round; as many as draws if None. The
    weighted moments of a round determine the t distribution of the next.
    """

    num_samples: int = 1000
    num_chains: int = 4
    num_draws: int | None = None
    num_rounds: int = 1


def draw(key: Key[Array, ""], problem: Problem, options: Options) -> Draws:
    """Return equally weighted draws by importance sampling.

    The statistic `log_weight` is the raw weight [nats] of each copied point.
    """
    count = options.num_draws or options.num_samples * options.num_chains
    key_rounds, key_keep = jax.random.split(key)

    def weigh(whitening: Affine, key: Key[Array, ""]) -> tuple[Affine, tuple[Affine, Array, Array]]:
        rewhitened = eqx.tree_at(lambda posterior: posterior.whitening, problem, whitening)
        w = jnp.asarray(reference(rewhitened).sample(key, (count,)))
        ratio = in_batches(lambda point: log_ratio(rewhitened, point), w)
        return moved(whitening, w, ratio), (whitening, w, ratio)

    keys = jax.random.split(key_rounds, options.num_rounds)
    # A loop is used even for a single round, so that the likelihood is compiled once.
    rounds = jax.lax.scan(weigh, problem.whitening, keys)[1]
    whitening, w, ratio = jax.tree.map(lambda rows: rows[-1], rounds)
    raw = jnp.where(ratio > FORBIDDEN, ratio, -jnp.inf)
    weights, khat = smoothed(raw)
    effective = effective_draws(weights)
    rows = _resampled(key_keep, weights, options)
    rewhitened = eqx.tree_at(lambda posterior: posterior.whitening, problem, whitening)
    theta = jax.vmap(jax.vmap(rewhitened.theta))(w[rows])
    facts = {
        "log_evidence": jax.nn.logsumexp(raw) - jnp.log(count),
        "log_evidence_error": jnp.sqrt(jnp.maximum(1 / effective - 1 / count, 0.0)),
        "khat": khat,
        "ess_weights": effective,
        "num_evaluations": count * options.num_rounds,
    }
    possible = is_possible(ratio)
    arrived = possible & (effective >= ENOUGH * rows.size)
    return Draws(theta, {"log_weight": raw[rows]}, possible, arrived, facts)


def smoothed(log_weights: Float[Array, " draw"]) -> tuple[Float[Array, " draw"], Float[Array, ""]]:
    """Return normalised weights with a Pareto-smoothed tail, and k-hat (good below 0.7).

    Under `vmap`, ArviZ is called once for each set of weights.
    """
    raw = jnp.maximum(log_weights - jnp.max(log_weights), SMALLEST)
    shapes = jax.ShapeDtypeStruct(raw.shape, raw.dtype), jax.ShapeDtypeStruct((), raw.dtype)
    log_smoothed, khat = jax.pure_callback(smooth, shapes, raw, vmap_method="sequential")
    return jax.nn.softmax(log_smoothed), khat


def smooth(raw: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return log weights with a smoothed Pareto tail, and their k-hat."""
    from arviz_stats.base.array import array_stats  # an import of one second, needed only here

    stats: Any = array_stats  # ArviZ's annotations do not fit what these calls return.
    # ArviZ expects the negative of the log weights, as in leave-one-out log likelihoods; ArviZ's
    # quantiles overflow for a very large k-hat.
    raw = np.asarray(raw)
    try:
        with np.errstate(over="ignore"):
            log_smoothed, khat = stats.psislw(-raw)
    except ValueError:  # Copies of a single draw have no tail that could be fitted.
        log_smoothed, khat = raw, np.inf if np.ptp(raw) > 0 else 0.0
    return np.asarray(log_smoothed), np.asarray(khat, dtype=float)


def _resampled(key: Key[Array, ""], weights: Float[Array, " draw"], options: Options) -> Array:
    """Return the indices of draws by stratified resampling, separately for each group of draws.

    Copies of a point are adjacent, so an effective size from autocorrelation counts them as one.
    """
    from blackjax.smc import resampling  # loaded when something is sampled

    groups = weights.reshape(options.num_chains, -1)
    shares = groups / jnp.sum(groups, axis=1, keepdims=True)
    keys = jax.random.split(key, options.num_chains)
    chosen = jax.vmap(lambda k, p: resampling.stratified(k, p, options.num_samples))(keys, shares)
    return chosen + groups.shape[1] * jnp.arange(options.num_chains)[:, None]


def moved(
    whitening: Affine, w: Float[Array, "draw parameter"], ratio: Float[Array, " draw"]
) -> Affine:
    """Centre and scale the normalised coordinates by the moments of weighted draws."""
    size, d = w.shape
    ratio = jnp.maximum(ratio, jnp.max(ratio) - DEEPEST)

    def effective(power: Float[Array, ""]) -> Float[Array, ""]:
        return effective_draws(jax.nn.softmax(power * ratio))

    highest = highest_power(effective, FEW * size, (jnp.zeros(()), jnp.ones(())), HALVINGS)
    power = jnp.where(effective(jnp.ones(())) >= FEW * size, 1.0, highest)
    mean, covariance = weighted_moments(jax.nn.softmax(power * ratio), w)
    root = jnp.linalg.cholesky(covariance + NUGGET * jnp.eye(d))
    return Affine(whitening.forward(mean), whitening.factor @ root)
