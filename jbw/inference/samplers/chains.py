"""Compiled Markov chains for any kernel: start, and advance by a chunk of steps.

Bounds, data and whitening are arguments of the compiled functions and not constants in them. Other
data of the same shapes, or another box with the same names, need no new compilation.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec
from jaxtyping import Array, Bool, Float, Int, Key, PyTree

from jbw.inference.lanes import at_points
from jbw.inference.samplers.register import Sampler, module_of
from jbw.inference.space.coordinates import interval
from jbw.inference.space.problem import Problem

# number of random starts that are tried; after that, a chain starts at a point of zero likelihood
MAX_TRIALS = 100
TOGETHER = 64  # number of points at which a function is evaluated in parallel
# standard deviation of starting points, relative to that of the Gaussian approximation
OVERDISPERSION = 2.0


class Draw(NamedTuple):
    """One step of a chain: its parameters by name, and the sampler's statistics."""

    theta: dict[str, Float[Array, "..."]]
    stats: dict[str, Array]


class Kernel(NamedTuple):
    """A Markov chain as three functions: first state, next step, and parameters of a state.

    Its options have `num_warmup`, `num_samples`, `num_chains` and `chain_method`.
    """

    init: Callable[[Key[Array, ""], Float[Array, " parameter"]], PyTree]
    step: Callable[[PyTree], PyTree]
    read: Callable[[PyTree], Draw]


class Draws(NamedTuple):
    """Equally weighted draws from a posterior, with the sampler's statistics.

    `possible` states whether the posterior is possible at all points where the sampler must start,
    `arrived` whether the sampler finished. `facts` concern the whole run, such as log_evidence
    [nats] and its error. `groups` are further groups of the tree: group to variable to (dimensions,
    values).
    """

    theta: dict[str, Float[Array, "chain draw"]]
    stats: dict[str, Array]
    possible: Bool[Array, ""] | bool
    arrived: Bool[Array, ""] | bool
    facts: dict[str, Any] = {}  # noqa: RUF012
    groups: dict[str, dict[str, Any]] = {}  # noqa: RUF012


MakeKernel = Callable[[Problem, Any], Kernel]


class Starts(NamedTuple):
    """The starting points of chains, with the standard deviation of their random spread."""

    key: Key[Array, ""]
    centre: Float[Array, "chain parameter"]
    spread: Float[Array, ""]


def starts_of(
    key: Key[Array, ""], problem: Problem, points: np.ndarray | None, num_chains: int
) -> Starts:
    """Return chains' starting points: around a fit, at given points, or over the prior range."""
    size = len(problem.box.names)
    if problem.located or points is None:
        spread = OVERDISPERSION if problem.located else 1.0
        return Starts(key, jnp.zeros((num_chains, size)), jnp.asarray(spread))
    rows = jnp.broadcast_to(jnp.asarray(points), (num_chains, size))
    logits = jax.vmap(interval(problem.lower, problem.upper).inverse)(rows)
    return Starts(key, jax.vmap(problem.whitening.inverse)(logits), jnp.asarray(0.0))


def draws_of(sampler: Sampler, key: Key[Array, ""], problem: Problem, options: Any) -> Draws:
    """Draw from a posterior by a sampler in one call; usable under `jit` and `vmap`."""
    module = module_of(sampler)
    if hasattr(module, "draw"):
        return module.draw(key, problem, options)
    return draw_chains(module.kernel, key, problem, options)


def draw_chains(make: MakeKernel, key: Key[Array, ""], problem: Problem, options: Any) -> Draws:
    """Run complete chains from dispersed starting points; usable under `jit` and `vmap`."""
    starts = starts_of(key, problem, None, options.num_chains)
    total = options.num_warmup + options.num_samples

    def run_chain(argument: tuple[Key[Array, ""], Array], shared: PyTree) -> PyTree:
        problem, spread = shared
        chain = make(problem, options)
        state, possible = _first_state(chain, argument, problem, spread)
        # Warm-up and draws share one loop, so that the step is compiled once; the states of the
        # warm-up are dropped.
        bounds = jnp.asarray(total), options.num_samples, options.num_warmup
        return possible, _advanced(chain, state, *bounds)[1]

    keys = jax.random.split(key, options.num_chains)
    shared = problem, starts.spread
    possible, draws = over_chains(run_chain, options.chain_method)((keys, starts.centre), shared)
    return Draws(draws.theta, draws.stats, jnp.all(possible), True)


@eqx.filter_jit
def start_chains(
    starts: Starts, problem: Problem, make: MakeKernel, options: Any
) -> tuple[PyTree, Bool[Array, " chain"]]:
    r"""Return the chains' first states, and whether the posterior density is positive at each.

    A chain starts at w + spread eta with eta standard normal (logistic without a fit), drawn again
    while the posterior density is zero there.
    """

    def start(argument: tuple[Key[Array, ""], Array], shared: tuple[Problem, Array]) -> PyTree:
        problem, spread = shared
        return _first_state(make(problem, options), argument, problem, spread)

    keys = jax.random.split(starts.key, len(starts.centre))
    shared = problem, starts.spread
    return over_chains(start, options.chain_method)((keys, starts.centre), shared)


@eqx.filter_jit
def advance_chains(
    states: PyTree,
    count: Int[Array, ""],
    capacity: int,
    problem: Problem,
    make: MakeKernel,
    options: Any,
) -> tuple[PyTree, Draw]:
    """Take `count` steps, compiled for all counts up to `capacity`; unused rows are zero."""

    def advance(state: PyTree, shared: tuple[Problem, Array]) -> tuple[PyTree, Draw]:
        problem, count = shared
        return _advanced(make(problem, options), state, count, capacity, 0)

    return over_chains(advance, options.chain_method)(states, (problem, count))


def terms_at(
    theta: Mapping[str, Float[Any, "chain draw"]], problem: Problem
) -> Float[np.ndarray, "chain draw term"]:
    """Return the log likelihood's terms [nats] at the draws of all chains."""
    shape = np.shape(next(iter(theta.values())))
    points = {name: np.ravel(values) for name, values in theta.items()}
    return at_points(problem.log_likelihood, points, problem.data).reshape(*shape, -1)


def num_devices_for(num_chains: int) -> int:
    """Return the largest number of devices that get equal numbers of chains."""
    return max(n for n in range(1, jax.device_count() + 1) if num_chains % n == 0)


def over_chains(f: Callable[..., PyTree], method: str) -> Callable[..., PyTree]:
    """Map a function of one chain over all chains, by the chosen method."""

    def mapped(chains: PyTree, shared: PyTree) -> PyTree:
        arrays, static = eqx.partition(shared, eqx.is_array)

        def in_turn(chains: PyTree, arrays: PyTree) -> PyTree:
            return jax.lax.map(lambda chain: f(chain, eqx.combine(arrays, static)), chains)

        if method == "vectorized":
            return jax.vmap(lambda chain: f(chain, shared))(chains)
        if method == "sequential":
            return in_turn(chains, arrays)
        devices = num_devices_for(len(jax.tree.leaves(chains)[0]))
        mesh = Mesh(np.array(jax.devices()[:devices]), ("chain",))
        by_chain = PartitionSpec("chain")
        specs = {"in_specs": (by_chain, PartitionSpec()), "out_specs": by_chain}
        return jax.shard_map(in_turn, mesh=mesh, check_vma=False, **specs)(chains, arrays)

    return mapped


def in_batches(f: Callable[[PyTree], PyTree], points: PyTree) -> PyTree:
    """Evaluate a function at many points, 64 in parallel, by one compiled program."""
    count = len(jax.tree.leaves(points)[0])
    batch = min(TOGETHER, count)
    padded = jax.tree.map(lambda v: jnp.concatenate([v, v[:1].repeat(-count % batch, 0)]), points)
    mapped = jax.lax.map(f, padded, batch_size=batch)
    return jax.tree.map(lambda values: values[:count], mapped)


def _advanced(
    kernel: Kernel, state: PyTree, count: Int[Array, ""], capacity: int, skipped: int
) -> tuple[PyTree, Draw]:
    """Return the state of a chain after `count` steps, and its draws after the skipped ones."""

    def step(i: Array, carry: tuple[PyTree, Draw]) -> tuple[PyTree, Draw]:
        state, rows = carry
        state = kernel.step(state)
        # Rows of skipped steps are written beyond the last row, so that JAX drops them.
        row = jnp.where(i < skipped, capacity, i - skipped)
        return state, _set_row(rows, row, kernel.read(state))

    rows = _empty_rows(lambda: kernel.read(state), capacity)
    return jax.lax.fori_loop(0, count, step, (state, rows))


def _empty_rows(f: Callable[[], PyTree], capacity: int) -> PyTree:
    return jax.tree.map(lambda s: jnp.zeros((capacity, *s.shape), s.dtype), jax.eval_shape(f))


def _set_row(rows: PyTree, i: Array, values: PyTree) -> PyTree:
    return jax.tree.map(lambda row, value: row.at[i].set(value), rows, values)


def _first_state(
    kernel: Kernel,
    start: tuple[Key[Array, ""], Float[Array, " parameter"]],
    problem: Problem,
    spread: Array,
) -> tuple[PyTree, Bool[Array, ""]]:
    """Return the first state of a chain, and whether the posterior density is positive there."""
    key_start, key_chain = jax.random.split(start[0])
    # For a uniform x, the logit is logistic, so a spread of 1 covers the whole prior range.
    disperse = jax.random.normal if problem.located else jax.random.logistic

    def propose(carry: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        trial, key, _, _ = carry
        key, key_move = jax.random.split(key)
        w = start[1] + spread * disperse(key_move, start[1].shape, start[1].dtype)
        return trial + 1, key, w, jnp.isfinite(problem.log_density(w))

    def keep_proposing(carry: tuple[Array, Array, Array, Array]) -> Array:
        return (carry[0] < MAX_TRIALS) & ~carry[3]

    first = (jnp.array(0), key_start, start[1], jnp.array(False))
    _, _, w, possible = jax.lax.while_loop(keep_proposing, propose, first)
    return kernel.init(key_chain, w), possible
