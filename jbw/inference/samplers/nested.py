r"""Nested slice sampling with its evidence, by BlackJAX.

$$Z = \int_0^1 \ell(X)\,\mathrm{d}X, \qquad w_i = \ell_i\, (X_{i-1} - X_{i+1}) / 2$$

The reference density is restricted to rising contours of the ratio ell of posterior to reference:
repeatedly, the lowest tenth of the live points is replaced by points from 2 d slices (at least 5)
above their contour. A chain is a separate run, resampled to draws of equal weight in random order.

Reference:
    Skilling (2006), Bayesian Analysis 1, 833; Yallup, Kroupa, Handley (2026), arXiv:2601.23252.
"""

from functools import partial
from typing import Any, NamedTuple

import blackjax
import jax
import jax.numpy as jnp
from blackjax.smc import resampling
from jaxtyping import Array, Bool, Float, Int, Key

from jbw.errors import ModelError
from jbw.inference.samplers.chains import Draws, over_chains
from jbw.inference.samplers.evidence import (
    effective_draws,
    is_possible,
    log_ratio,
    pooled_evidence,
    reference,
)
from jbw.inference.space.problem import Problem

LEFT = 1e-3  # A run ends when the live points contain no more than this fraction of the evidence.
ROOM = 150  # storage for dead points, in multiples of the live points; each multiple covers one nat
TOGETHER = 10  # Each step replaces the fraction 1 / TOGETHER of the live points, in parallel.
# number of simulated sequences of prior volumes, from which the error of the evidence follows
VOLUMES = 200


class Options(NamedTuple):
    """The options of nested sampling: numbers of draws of each run, and of runs."""

    num_samples: int = 1000
    num_chains: int = 4


class NestedRun(NamedTuple):
    """One nested sampling run: draws, evidence with variance [nats], and number of evaluations."""

    theta: dict[str, Float[Array, " draw"]]
    log_evidence: Float[Array, ""]
    variance: Float[Array, ""]
    effective: Float[Array, ""]
    num_evaluations: Int[Array, ""]
    live_share: Float[Array, ""]
    possible: Bool[Array, ""]


def draw(key: Key[Array, ""], problem: Problem, options: Options) -> Draws:
    """Return equally weighted draws of several nested sampling runs."""
    num_live = max(options.num_samples // 2, 8 * len(problem.box.names), 20)
    keys = jax.random.split(key, options.num_chains)

    def single_run(key: Key[Array, ""], problem: Problem) -> NestedRun:
        return _run(key, problem, num_live, options.num_samples)

    runs = over_chains(single_run, "sequential")(keys, problem)
    facts = {
        **pooled_evidence(runs.log_evidence, runs.variance),
        "ess_weights": jnp.sum(runs.effective),
        "num_live": num_live,
        "num_evaluations": jnp.sum(runs.num_evaluations),
    }
    return Draws(runs.theta, {}, jnp.all(runs.possible), jnp.all(runs.live_share <= LEFT), facts)


def require_arrival(arrived: bool) -> None:
    """Raise a ModelError if runs filled their storage before they ended."""
    if not arrived:
        raise ModelError(
            f"Nested sampling stopped after {ROOM} replacements per live point, but the live "
            f"points still contain more than the fraction {LEFT:g} of the evidence.",
            remedy="Narrow the prior, or pass the start and covariance of a fit.",
        )


class _Carry(NamedTuple):
    """The state of a run: random key, live points, evidence, dead points, counts."""

    key: Key[Array, ""]
    state: Any
    dead: Any
    count: Int[Array, ""]
    evaluations: Int[Array, ""]


def _run(key: Key[Array, ""], problem: Problem, num_live: int, num_draws: int) -> NestedRun:
    reference_density, d = reference(problem), len(problem.box.names)
    together = max(1, num_live // TOGETHER)
    ratio = partial(log_ratio, problem)
    slices: Any = blackjax.nss(
        reference_density.log_prob, ratio, max(5, 2 * d), num_delete=together
    )
    key_first, key_init, key_run, key_volume, key_keep, key_order = jax.random.split(key, 6)
    state = slices.init(reference_density.sample(key_first, (num_live,)), key_init)
    possible = is_possible(state.particles.loglikelihood)
    last = _shrunk(key_run, slices, state, possible, together)
    points = jax.tree.map(lambda *parts: jnp.concatenate(parts), last.dead, last.state.particles)
    room = len(points.loglikelihood) - num_live
    filled = jnp.concatenate([jnp.arange(room) < last.count, jnp.ones(num_live, bool)])
    shares, totals = _weights(key_volume, points, filled)
    # The points are sorted by rising likelihood.
    order = jax.random.permutation(key_order, shares.size)
    chosen = order[resampling.stratified(key_keep, shares[order], num_draws)]
    return NestedRun(
        jax.vmap(problem.theta)(points.position[chosen]),
        jnp.mean(totals),
        jnp.var(totals),
        effective_draws(shares),
        last.evaluations,
        _live_share(last.state),
        possible,
    )


def _live_share(state: Any) -> Float[Array, ""]:
    """Return the share of the evidence that the live points still contain."""
    live = state.integrator.logZ_live
    return jnp.exp(live - jnp.logaddexp(state.integrator.logZ, live))


def _shrunk(
    key: Key[Array, ""], slices: Any, state: Any, possible: Bool[Array, ""], together: int
) -> _Carry:
    """Run nested sampling from its first live points to its end."""
    num_live = len(state.particles.loglikelihood)
    room = ROOM * num_live // together * together
    # Entries without a dead point get the largest likelihood: the prior volume there is zero, so
    # that they add nothing to the evidence.
    empty = jax.tree.map(
        lambda v: jnp.full((room, *v.shape[1:]), jnp.inf, v.dtype), state.particles
    )

    def unfinished(at: _Carry) -> Bool[Array, ""]:
        return possible & (_live_share(at.state) > LEFT) & (at.count < room)

    def replace(at: _Carry) -> _Carry:
        key, key_step = jax.random.split(at.key)
        state, step_info = slices.step(key_step, at.state)
        # Both ends of a slice are evaluated before it grows.
        looked = step_info.update_info.num_expansions + step_info.update_info.num_shrink + 2
        dead = jax.tree.map(
            lambda rows, new: jax.lax.dynamic_update_slice_in_dim(rows, new, at.count, 0),
            at.dead,
            step_info.particles,
        )
        return _Carry(key, state, dead, at.count + together, at.evaluations + jnp.sum(looked))

    first = _Carry(key, state, empty, jnp.array(0), jnp.array(num_live))
    return jax.lax.while_loop(unfinished, replace, first)


def _weights(
    key: Key[Array, ""], points: Any, filled: Bool[Array, " point"]
) -> tuple[Float[Array, " point"], Float[Array, " volume"]]:
    r"""Return each point's share of the evidence, and the log evidence, for simulated volumes.

    At the death of a point, the number n of live points is that of points born below it that have
    not died. The volume shrinks by the largest of n uniform numbers, $\log X_i - \log X_{i-1} =
    \log(u_i) / n_i$.
    """
    order = jnp.argsort(points.loglikelihood)
    deaths = points.loglikelihood[order]
    # BlackJAX marks the first points, which were drawn from the reference itself, by NaN.
    births = jnp.sort(jnp.nan_to_num(points.loglikelihood_birth, nan=-jnp.inf, posinf=jnp.inf))
    num_live = jnp.maximum(jnp.searchsorted(births, deaths) - jnp.arange(deaths.size), 1)

    def simulated_volume(total: Array, key: Key[Array, ""]) -> tuple[Array, Array]:
        log_x = jnp.cumsum(jnp.log1p(-jax.random.uniform(key, deaths.shape)) / num_live)
        before = jnp.concatenate([jnp.zeros(1), log_x[:-1]])
        after = jnp.concatenate([log_x[1:], jnp.full(1, -jnp.inf)])
        width = before + jnp.log(-jnp.expm1(after - before)) - jnp.log(2.0)
        weights = jnp.where(filled[order], width + deaths, -jnp.inf)
        return total + jax.nn.softmax(weights) / VOLUMES, jax.nn.logsumexp(weights)

    shares, totals = jax.lax.scan(
        simulated_volume, jnp.zeros(filled.size), jax.random.split(key, VOLUMES)
    )
    return jnp.zeros_like(shares).at[order].set(shares), totals
