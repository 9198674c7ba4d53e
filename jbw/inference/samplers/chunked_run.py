"""Chains that run in chunks of steps with checkpoints, which do not change the draws."""

import hashlib
import warnings
from collections.abc import Callable, Mapping
from time import perf_counter
from typing import Any, NamedTuple, Protocol

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PyTree

from jbw.errors import ModelError
from jbw.inference.samplers.chains import (
    Draw,
    MakeKernel,
    Starts,
    advance_chains,
    start_chains,
    terms_at,
)
from jbw.inference.space.problem import Problem

CHUNK = 250  # largest number of steps per chunk, small enough for a progress bar
# duration of a chunk [s], the most time that is lost if the process is killed
CHUNK_S = 10.0
# At the end of each chunk, all devices wait for the slowest one, which costs less in a long chunk.
# With slow steps, a chunk takes this fraction of the time spent before, but a minute at most.
CHUNK_SHARE, LONGEST_S = 0.05, 60.0
GROWTH = 4  # largest ratio of the numbers of steps in two successive chunks

Arrays = Mapping[str, np.ndarray]
Rows = tuple[Draw, np.ndarray]
"""Draws, and terms of their log likelihood, of shape (chain, draw, ...)."""


class SoFar(NamedTuple):
    """The progress of running chains.

    Attributes:
        done: Number of steps taken by every chain, including the warm-up.
        total: Total number of steps.
        draws: Draws so far by name, (chain, draw); empty during the warm-up.
        divergences: Divergent trajectories of each chain after the warm-up; None if the sampler has
            none.
        left_s: Remaining time at the rate of the steps after warm-up and compilation [s]; None
            before it is known, and if the end depends on the draws.
        in_rounds: Whether the steps are rounds of points, at most `total`.
    """

    done: int
    total: int
    draws: dict[str, Any]
    divergences: np.ndarray | None
    left_s: float | None
    in_rounds: bool = False


class Kept(Protocol):
    """The stored checkpoint of the chains of one posterior."""

    def grown(self, so_far: SoFar) -> None:
        """Report the progress of the chains; called after each chunk of steps."""
        ...

    def load(self) -> Arrays | None:
        """Return the arrays that were saved last, or None."""
        ...

    def due(self) -> bool:
        """Return whether it is time to save the checkpoint."""
        ...

    def save(self, arrays: Arrays, *, last: bool) -> None:
        """Save the arrays in place of earlier arrays; set `last` when the chains are complete."""
        ...


class Until(NamedTuple):
    """The condition that ends chains; it is tested each time the number of draws has doubled.

    Attributes:
        enough: Function that returns whether the draws by name, (chain, draw), are enough.
        budget_s: Time after which chains end in any case [s].
    """

    enough: Callable[[dict[str, Any]], bool]
    budget_s: float


Keep = Callable[[str], Kept | None]
Progress = Callable[[SoFar], None]


class Supervision(NamedTuple):
    """The supervision of chains while they run: progress, checkpoints and end.

    Attributes:
        progress: Function that is called with a `SoFar` after every chunk of steps, or round.
        kept: Checkpoint from which an interrupted run continues unchanged.
        until: Condition on chains that are doubled until it holds; without it they end at
            `num_samples`.
    """

    progress: Progress | None = None
    kept: Kept | None = None
    until: Until | None = None


UNSUPERVISED = Supervision()


def no_checkpoint(name: str) -> None:
    """Return None, so that no checkpoint of the chains is saved."""


class Chains(NamedTuple):
    """The chains so far: states, number of steps, draws, and time spent [s]."""

    states: list[np.ndarray]
    done: int
    rows: list[Rows]
    wall_s: float


def grow_chains(
    starts: Starts,
    problem: Problem,
    make: MakeKernel,
    options: Any,
    progress: Progress | None = None,
    checkpoint: Kept | None = None,
    until: Until | None = None,
) -> tuple[Rows, float]:
    """Run all chains to their end, from a checkpoint if there is one.

    Every chunk runs the same compiled loop with another number of steps, so resumed chains give the
    same draws as without a break. With `until`, the number of draws is doubled until they are
    enough, or the time runs out. The time that earlier processes spent on the draws [s] is returned
    too.
    """
    began, total = perf_counter(), options.num_warmup + options.num_samples
    mark = "" if checkpoint is None else fingerprint(starts, problem, make, options)
    # With these options at 0, other numbers of draws and chains cause no new compilation.
    options = options._replace(num_samples=0, num_chains=0)
    arrays = kept_arrays(checkpoint, mark)
    before = Chains([], 0, [], 0.0) if arrays is None else _from_arrays(arrays)
    done, rows, count = before.done, before.rows, CHUNK if checkpoint is None else 1

    def end(spent: float) -> int:
        """Return the number of steps at which the chains end, from draws and elapsed time [s]."""
        if until is not None and rows and spent >= until.budget_s:
            return done
        if done < total or until is None or until.enough(_joined(rows)[0][0].theta):
            return total
        return 2 * done - options.num_warmup

    while total < done:
        total += total - options.num_warmup
    total = end(before.wall_s)
    states = _states(before, starts, problem, make, options) if done < total else None
    # number of steps and time at which the measurement of the speed began
    timed: tuple[int, float] | None = None
    watching = [
        listener
        for listener in (progress, None if checkpoint is None else checkpoint.grown)
        if listener is not None
    ]
    while done < total:
        clock, count = perf_counter(), min(count, total - done)
        states, new = _grown(states, done, count, problem, make, options)
        rows, done = [*rows, *new], done + count
        spent = before.wall_s + perf_counter() - began
        total = end(spent)
        if checkpoint is not None:
            count = _next_count(count, perf_counter() - clock, spent)
            if done == total or checkpoint.due():
                rows = _joined(rows)
                plain = [np.asarray(_plain(leaf)) for leaf in jax.tree.leaves(states)]
                checkpoint.save(
                    _as_arrays(Chains(plain, done, rows, spent), mark), last=done == total
                )
        if watching:
            rate = None if timed is None else (perf_counter() - timed[1]) / (done - timed[0])
            so_far = _so_far(done, total, rows, rate)
            for tell in watching:
                tell(so_far)
        # The first chunk of draws includes compilation and is not timed.
        if timed is None and rows:
            timed = done, perf_counter()
    return _joined(rows)[0], before.wall_s


def kept_arrays(checkpoint: Kept | None, mark: str) -> Arrays | None:
    """Load the checkpoint if its fingerprint matches; otherwise warn and return None."""
    arrays = None if checkpoint is None else checkpoint.load()
    if arrays is None or str(arrays.get("fingerprint")) == mark:
        return arrays
    warnings.warn(
        "The stored chains belong to another posterior or to another number of devices; new chains "
        "are started.",
        stacklevel=4,
    )
    return None


def _states(
    before: Chains, starts: Starts, problem: Problem, make: MakeKernel, options: Any
) -> PyTree:
    """Return the states from which chains continue: from a checkpoint, or initial states."""
    first, possible = start_chains(starts, problem, make, options)
    if not np.all(possible):
        raise ModelError(
            f"The log likelihood is not finite at the start of {np.sum(~np.asarray(possible))} of "
            f"{len(possible)} chains.",
            why="A sampler cannot move away from a point at which the posterior density is zero.",
            remedy="Check the data for NaN and the noise for zero. Check whether the prior "
            "contains parameters for which the model has no solution.",
        )
    if not before.done:
        return first
    return jax.tree.map(
        _restored, first, jax.tree.unflatten(jax.tree.structure(first), before.states)
    )


def _grown(
    states: PyTree, done: int, count: int, problem: Problem, make: MakeKernel, options: Any
) -> tuple[PyTree, list[Rows]]:
    """Advance the chains by one chunk; return their states, and the draws after the warm-up."""
    states, draws = advance_chains(states, jnp.asarray(count), CHUNK, problem, make, options)
    first = min(count, max(0, options.num_warmup - done))
    if first == count:
        return jax.block_until_ready(states), []
    rows = jax.tree.map(lambda row: np.asarray(row)[:, first:count], draws)
    return states, [(rows, terms_at(rows.theta, problem))]


def _so_far(done: int, total: int, rows: list[Rows], rate: float | None) -> SoFar:
    """Return the progress of the chains, with the remaining time if the rate is known."""
    left_s = None if rate is None else rate * (total - done)
    if not rows:
        return SoFar(done, total, {}, None, left_s)
    draws = _joined(rows)[0][0]
    diverging = draws.stats.get("diverging")
    count = None if diverging is None else np.sum(diverging, axis=1)
    return SoFar(done, total, draws.theta, count, left_s)


def _next_count(count: int, seconds: float, spent: float) -> int:
    """Return the number of steps of the next chunk, from the duration of the last one."""
    lasting = max(CHUNK_S, min(CHUNK_SHARE * spent, LONGEST_S))
    target = int(count * lasting / max(seconds, 1e-9))
    return max(1, min(target, GROWTH * count, CHUNK))


def _joined(rows: list[Rows]) -> list[Rows]:
    """Return the draws of all chunks, joined into one array for each quantity."""
    return [jax.tree.map(lambda *parts: np.concatenate(parts, axis=1), *rows)] if rows else []


def _is_key(leaf: Array) -> bool:
    return jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def _plain(leaf: Array) -> Array:
    return jax.random.key_data(leaf) if _is_key(leaf) else leaf


def _restored(like: Array, plain: np.ndarray) -> Array:
    value = jnp.asarray(plain)
    if _is_key(like):
        value = jax.random.wrap_key_data(value, impl=jax.random.key_impl(like))
    return jax.device_put(value, like.sharding)


def fingerprint(starts: PyTree, problem: Problem, make: Callable, options: Any) -> str:
    """Return a hash of everything that determines the draws: key, starts, data, options."""
    functions = [
        getattr(f, "__qualname__", type(f).__name__) for f in (problem.log_likelihood, make)
    ]
    identity = functions, make.__module__, problem.box.names, problem.located, options
    digest = hashlib.sha256(repr(identity).encode())
    for leaf in jax.tree.leaves(eqx.filter((starts, problem), eqx.is_array)):
        values = np.asarray(_plain(leaf))
        digest.update(f"{values.dtype}{values.shape}".encode())
        digest.update(np.ascontiguousarray(values))
    return digest.hexdigest()


def _as_arrays(chains: Chains, mark: str) -> dict[str, np.ndarray]:
    """Return the chains as arrays by name, for a checkpoint."""
    arrays = {"fingerprint": mark, "done": chains.done, "wall_s": chains.wall_s}
    arrays |= {f"state/{i}": leaf for i, leaf in enumerate(chains.states)}
    for draw, terms in chains.rows:
        arrays |= {f"theta/{name}": values for name, values in draw.theta.items()}
        arrays |= {f"stats/{name}": values for name, values in draw.stats.items()}
        arrays["terms"] = terms
    return {name: np.asarray(values) for name, values in arrays.items()}


def _from_arrays(arrays: Arrays) -> Chains:
    """Return the chains from a checkpoint's arrays."""

    def under(prefix: str) -> dict[str, Any]:
        return {n.removeprefix(prefix): v for n, v in arrays.items() if n.startswith(prefix)}

    leaves, rows = under("state/"), []
    if "terms" in arrays:
        rows = [(Draw(under("theta/"), under("stats/")), arrays["terms"])]
    states = [leaves[str(i)] for i in range(len(leaves))]
    return Chains(states, int(arrays["done"]), rows, float(arrays["wall_s"]))
