"""Nested slice sampling through BlackJAX, with its evidence."""

from typing import Any, NamedTuple

import blackjax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from blackjax.ns.base import NSInfo
from blackjax.ns.utils import log_weights
from jaxtyping import Array, Int, Key
from numpy.typing import NDArray

from jbw.errors import ModelError
from jbw.inference.bridge import FORBIDDEN, Bridge, Drawn, bridge, require_possible
from jbw.inference.evidence import pooled_evidence
from jbw.inference.kernels import Problem
from jbw.inference.weights import effective_draws, stratified

LEFT = np.log(1e-3)  # share of the evidence that may be left in the live points at the end
CHUNK = 20  # replacements between two looks at what is left
MOST_CHUNKS = 5000
TOGETHER = 10  # a tenth of the live points is replaced at once, side by side
VOLUMES = 200  # simulated shrinkages of the prior volume


class Run(NamedTuple):
    """One run: points that died and those alive at the end, with their weights."""

    theta: dict[str, NDArray[np.float64]]
    weights: NDArray[np.float64]
    log_evidence: float
    variance: float
    num_evaluations: int


def nested_draws(
    key: Key[Array, ""],
    problem: Problem,
    num_samples: int,
    num_chains: int,
    *,
    whitened: bool,
) -> Drawn:
    r"""Shrink a reference through rising contours of its ratio to the posterior.

    $$Z = \int_0^1 \ell(X)\,\mathrm{d}X, \qquad w_i = \ell_i\, (X_{i-1} - X_{i+1}) / 2$$

    Half as many points live as draws are asked for, at least 8 d; a tenth of them, the lowest, is
    replaced at a time by 2 d slices (at least 5) above their contour. A chain is a run of its own,
    resampled to draws of equal weight in random order. Runs follow one another.

    Args:
        key: Random key.
        problem: The posterior.
        num_samples: Draws of each run.
        num_chains: Runs.
        whitened: Whether to start from the Laplace approximation instead of the whole box.

    Returns:
        The draws, equally weighted.

    Raises:
        ModelError: A run did not come to its end.

    Reference:
        Skilling (2006), Bayesian Analysis 1, 833; Yallup, Kroupa, Handley (2026),
        arXiv:2601.23252.
    """
    d = len(problem.box.names)
    num_live = max(num_samples // 2, 8 * d, 20)
    keys = jax.random.split(key, num_chains)
    runs = [_run(one, problem, num_live, max(5, 2 * d), whitened) for one in keys]
    rows = [_equal(one, run, num_samples) for one, run in zip(keys, runs, strict=True)]
    theta = {name: np.stack([row[name] for row in rows]) for name in problem.box.names}
    evidence = pooled_evidence(
        np.array([run.log_evidence for run in runs]), np.array([run.variance for run in runs])
    )
    worth = sum(effective_draws(run.weights) for run in runs)
    evaluations = sum(run.num_evaluations for run in runs)
    facts = {"ess_weights": worth, "num_live": num_live, "num_evaluations": evaluations}
    return Drawn(theta, {}, {**evidence, **facts})


def _equal(key: Key[Array, ""], run: Run, count: int) -> dict[str, NDArray[np.float64]]:
    """Draws of equal weight; in random order, for the points came from the edge inwards."""
    generator = np.random.default_rng(np.asarray(jax.random.key_data(key)))
    order = generator.permutation(len(run.weights))
    kept = order[stratified(generator, run.weights[order], count)]
    return {name: values[kept] for name, values in run.theta.items()}


def _run(
    key: Key[Array, ""], problem: Problem, num_live: int, num_slices: int, whitened: bool
) -> Run:
    key_start, key_run, key_volume = jax.random.split(key, 3)
    state = _start(key_start, problem, num_live, num_slices, whitened)
    require_possible(bool(jnp.any(state.particles.loglikelihood > FORBIDDEN / 2)))
    dead, evaluations = [], num_live
    for key_chunk in jax.random.split(key_run, MOST_CHUNKS):
        state, points, count = _advance(key_chunk, state, problem, num_live, num_slices, whitened)
        dead.append(points)
        evaluations += int(count)
        found = state.integrator
        if float(found.logZ_live - jnp.logaddexp(found.logZ, found.logZ_live)) < LEFT:
            break
    else:
        raise ModelError(
            f"Nested sampling left the share {float(jnp.exp(found.logZ_live - found.logZ)):.2g} of "
            f"the evidence in its live points after {MOST_CHUNKS * CHUNK} replacements.",
            remedy="Narrow the prior, or pass the start and covariance of a fit.",
        )
    points = jax.tree.map(lambda *parts: jnp.concatenate(parts), *dead, state.particles)
    volumes = np.asarray(log_weights(key_volume, NSInfo(points, ()), VOLUMES))  # pyright: ignore
    largest = np.max(volumes, axis=0)
    shares = np.exp(volumes - largest)
    totals = np.log(np.sum(shares, axis=0)) + largest
    theta = bridge(problem, whitened).theta(jnp.asarray(points.position))
    return Run(
        {name: np.asarray(values) for name, values in theta.items()},
        np.mean(shares / np.sum(shares, axis=0), axis=1),
        float(np.mean(totals)),
        float(np.var(totals)),
        evaluations,
    )


def _algorithm(way: Bridge, num_live: int, num_slices: int) -> Any:
    together = max(1, num_live // TOGETHER)
    return blackjax.nss(way.log_reference, way.log_ratio, num_slices, num_delete=together)


@eqx.filter_jit
def _start(
    key: Key[Array, ""], problem: Problem, num_live: int, num_slices: int, whitened: bool
) -> Any:
    way = bridge(problem, whitened)
    key_draw, key_init = jax.random.split(key)
    return _algorithm(way, num_live, num_slices).init(way.draw(key_draw, num_live), key_init)


@eqx.filter_jit
def _advance(
    key: Key[Array, ""],
    state: Any,
    problem: Problem,
    num_live: int,
    num_slices: int,
    whitened: bool,
) -> tuple[Any, Any, Int[Array, ""]]:
    """Replace points for one chunk; the state, who died, and points that were looked at."""
    step = _algorithm(bridge(problem, whitened), num_live, num_slices).step

    def one(state: Any, key: Array) -> tuple[Any, tuple[Any, Array]]:
        state, info = step(key, state)
        # Both ends of a bracket are looked at before it grows.
        looked = info.update_info.num_expansions + info.update_info.num_shrink + 2
        return state, (info.particles, jnp.sum(looked))

    state, (points, counts) = jax.lax.scan(one, state, jax.random.split(key, CHUNK))
    flat = jax.tree.map(lambda rows: rows.reshape(-1, *rows.shape[2:]), points)
    return state, flat, jnp.sum(counts)
