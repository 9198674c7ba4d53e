"""Chains grown chunk by chunk: the draws do not depend on where the chunks are cut."""

import warnings
from collections.abc import Callable
from time import perf_counter
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from jbw.errors import ModelError
from jbw.inference.samplers.chains import (
    MakeKernel,
    Starts,
    advance_chains,
    evaluate_chains,
    start_chains,
)
from jbw.inference.samplers.checkpointing import (
    Chains,
    Kept,
    Rows,
    SoFar,
    as_arrays,
    fingerprint,
    from_arrays,
    plain_states,
    states_like,
)
from jbw.inference.space.problem import Problem

Progress = Callable[[SoFar], None]
CHUNK = 250  # steps at most between two looks at the clock; short enough for a progress bar
CHUNK_S = 10.0  # what a chunk lasts where chains are kept: so much is lost by a kill
# Devices wait for the slowest at the end of a chunk, the less the more steps it has: where steps
# are long, chunks last a share of the time spent before, up to a minute.
CHUNK_SHARE, LONGEST_S = 0.05, 60.0
GROWTH = 4  # of a chunk over the one before, whose time is the only measure of a step


def grow_chains(
    starts: Starts,
    problem: Problem,
    make: MakeKernel,
    options: Any,
    progress: Progress | None = None,
    kept: Kept | None = None,
) -> tuple[Rows, float]:
    """Run all chains to their end, from where they were kept if they were.

    Every chunk runs the same compiled loop with another count of steps: chains that were kept go
    on to the very draws that they would have come to without a break.

    Returns:
        Draws, terms of the log likelihood and further log prior, (chain, draw); and the time that
        earlier processes spent on them [s].

    Raises:
        ModelError: No possible start.
    """
    began, total = perf_counter(), options.num_warmup + options.num_samples
    mark = "" if kept is None else fingerprint(starts, problem, make, options)
    options = options._replace(num_samples=0, num_chains=0)  # not compiled in
    found = _resumed(kept, mark)
    done, rows, count = found.done, [found.rows], CHUNK if kept is None else 1
    states = _states(found, starts, problem, make, options) if done < total else None
    told = [one for one in (progress, None if kept is None else kept.grown) if one is not None]
    while done < total:
        clock, count = perf_counter(), min(count, total - done)
        states, new = _grown(states, done, count, problem, make, options)
        rows, done = [*rows, new], done + count
        if kept is not None:
            spent = found.wall_s + perf_counter() - began
            count = _next_count(count, perf_counter() - clock, spent)
            if done == total or kept.due():
                rows = [_joined(rows)]
                chains = Chains(plain_states(states), done, rows[0], spent)
                kept.save(as_arrays(chains, mark), last=done == total)
        if told:
            rate = (perf_counter() - began) / (done - found.done)
            so_far = _so_far(done, total, rows, rate)
            for tell in told:
                tell(so_far)
    joined = _joined(rows)
    if joined is None:
        raise ModelError("Argument `num_samples` must be at least 1, but is 0.")
    return joined, found.wall_s


def _resumed(kept: Kept | None, mark: str) -> Chains:
    """The chains as they were kept; none grown where there are none of this posterior."""
    arrays = None if kept is None else kept.load()
    if arrays is None:
        return Chains([], 0, None, 0.0)
    found = from_arrays(arrays, mark)
    if found is None:
        warnings.warn(
            "The chains that were kept were drawn from another posterior, or by another number "
            "of devices: they start again.",
            stacklevel=3,
        )
        return Chains([], 0, None, 0.0)
    return found


def _states(
    found: Chains, starts: Starts, problem: Problem, make: MakeKernel, options: Any
) -> PyTree:
    """States to go on from: the kept ones, or the first."""
    first, possible = start_chains(starts, problem, make, options)
    if not np.all(possible):
        raise ModelError(
            f"The log likelihood is not finite at the start of {np.sum(~np.asarray(possible))} of "
            f"{len(possible)} chains.",
            why="A sampler cannot leave a point that the model calls impossible.",
            remedy="Check the data for NaN, the noise for zero, and the prior for parameters that "
            "the model cannot solve.",
        )
    return states_like(found.states, first) if found.done else first


def _grown(
    states: PyTree, done: int, count: int, problem: Problem, make: MakeKernel, options: Any
) -> tuple[PyTree, Rows | None]:
    """The states after a chunk of steps, and its draws after the warm-up."""
    states, draws = advance_chains(states, jnp.asarray(count), CHUNK, problem, make, options)
    first = min(count, max(0, options.num_warmup - done))
    if first == count:
        return jax.block_until_ready(states), None
    bounds = jnp.asarray(first), jnp.asarray(count)
    terms = evaluate_chains(draws.theta, *bounds, problem, options.chain_method)
    return states, jax.tree.map(lambda r: np.asarray(r)[:, first:count], (draws, *terms))


def _so_far(done: int, total: int, rows: list[Rows | None], rate: float) -> SoFar:
    """What is known of the chains after a chunk, at a rate of seconds a step."""
    joined, left_s = _joined(rows), rate * (total - done)
    if joined is None:
        return SoFar(done, total, {}, None, left_s)
    draws, _, _ = joined
    diverging = draws.stats.get("diverging")
    count = None if diverging is None else np.sum(diverging, axis=1)
    theta = {name: np.asarray(values) for name, values in draws.theta.items()}
    return SoFar(done, total, theta, count, left_s)


def _next_count(count: int, seconds: float, spent: float) -> int:
    """Steps of the next chunk, to last as long as it may if steps take as long as those before."""
    lasting = max(CHUNK_S, min(CHUNK_SHARE * spent, LONGEST_S))
    wanted = int(count * lasting / max(seconds, 1e-9))
    return max(1, min(wanted, GROWTH * count, CHUNK))


def _joined(rows: list[Rows | None]) -> Rows | None:
    """Rows of all chunks, one after the other."""
    known = [row for row in rows if row is not None]
    if not known:
        return None
    return jax.tree.map(lambda *parts: np.concatenate(parts, axis=1), *known)
