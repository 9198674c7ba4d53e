"""Compiled chains: start, advance by a chunk, evaluate; the same for every kernel and method.

Bounds, data and whitening are arguments of the compiled functions, not constants in them: other
data of the same shapes, or another box with the same names, run without compiling again.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec
from jaxtyping import Array, Bool, Float, Int, Key, PyTree

from jbw.inference.kernels import (
    Draw,
    Problem,
    Settings,
    bind_kernel,
    kernel_position,
    make_kernel,
    read_draw,
)
from jbw.inference.laplace import from_logit

MAX_TRIALS = 100  # starts tried before a chain is left where the likelihood is impossible


@eqx.filter_jit
def start_chains(
    keys: Key[Array, " chain"],
    z: Float[Array, "chain parameter"],
    spread: Float[Array, ""],
    problem: Problem,
    settings: Settings,
) -> tuple[PyTree, Bool[Array, " chain"]]:
    r"""First states of the chains.

    A chain starts at z + spread L eta with eta standard normal (logistic when not whitened), drawn
    again while the posterior is impossible there.

    Args:
        keys: One key a chain.
        z: Logit of the centre of each chain's start.
        spread: Standard deviations of the whitening to disperse the starts by; 0 for none.
        problem: The posterior.
        settings: What is compiled in.

    Returns:
        States with a leading chain axis, and whether each start is possible.
    """

    def start(argument: tuple[Key[Array, ""], Array], shared: tuple[Problem, Array]) -> PyTree:
        (key, centre), (problem, spread) = argument, shared
        key_start, key_chain = jax.random.split(key)
        found, possible = _possible_start(key_start, centre, spread, problem, settings.whitened)
        kernel, model_args = make_kernel(problem, settings)
        position = kernel_position(found, problem, settings)
        state = kernel.init(key_chain, settings.num_warmup, position, model_args, {})
        return state, possible

    return over_chains(start, settings.chain_method)((keys, z), (problem, spread))


@eqx.filter_jit
def advance_chains(
    states: PyTree, count: Int[Array, ""], capacity: int, problem: Problem, settings: Settings
) -> tuple[PyTree, Draw]:
    """Take `count` steps with every chain; compiled once for any count up to `capacity`.

    Args:
        states: States with a leading chain axis.
        count: Steps to take.
        capacity: Length of the draws' axis; rows from `count` on are zero.
        problem: The posterior.
        settings: What is compiled in.

    Returns:
        The states after the steps, and the draws with axes (chain, draw).
    """

    def advance(state: PyTree, shared: tuple[Problem, Array]) -> tuple[PyTree, Draw]:
        problem, count = shared
        kernel, model_args = make_kernel(problem, settings)
        bind_kernel(kernel, problem, settings, model_args)

        def step(i: Array, carry: tuple[PyTree, Draw]) -> tuple[PyTree, Draw]:
            state, rows = carry
            state = kernel.sample(state, model_args, {})
            return state, _set_row(rows, i, read_draw(state, problem, settings))

        rows = _empty_rows(lambda: read_draw(state, problem, settings), capacity)
        return jax.lax.fori_loop(0, count, step, (state, rows))

    return over_chains(advance, settings.chain_method)(states, (problem, count))


@eqx.filter_jit
def evaluate_chains(
    theta: dict[str, Float[Array, "chain draw"]],
    first: Int[Array, ""],
    last: Int[Array, ""],
    problem: Problem,
    settings: Settings,
) -> tuple[Float[Array, "chain draw term"], Float[Array, "chain draw"]]:
    """Terms of the log likelihood, and the further log prior, at the draws of a chunk.

    Args:
        theta: Draws by name.
        first: First draw to evaluate.
        last: One past the last; the other rows of the result are zero.
        problem: The posterior.
        settings: What is compiled in; only the chain method matters.

    Returns:
        Independent terms [nats], and the log prior [nats] without the box's constant.
    """

    def evaluate(theta: dict[str, Array], shared: tuple[Problem, Array, Array]) -> PyTree:
        problem, first, last = shared

        def one(i: Array) -> tuple[Array, Array]:
            point = {name: values[i] for name, values in theta.items()}
            terms = jnp.ravel(problem.log_likelihood(point, problem.data))
            prior = 0.0 if problem.log_prior is None else problem.log_prior(point)
            return terms, jnp.asarray(prior)

        capacity = len(next(iter(theta.values())))
        return _filled(one, first, last, capacity)

    return over_chains(evaluate, settings.chain_method)(theta, (problem, first, last))


def num_devices_for(num_chains: int) -> int:
    """Most devices that share the chains evenly."""
    return max(n for n in range(1, jax.device_count() + 1) if num_chains % n == 0)


def over_chains(f: Callable[..., PyTree], method: str) -> Callable[..., PyTree]:
    """Map f(of one chain, shared) over the leading axis of its first argument.

    Args:
        f: Function of one chain and of what all chains share.
        method: "sequential", "vectorized" or "parallel".
    """

    def mapped(chains: PyTree, shared: PyTree) -> PyTree:
        arrays, static = eqx.partition(shared, eqx.is_array)

        def in_turn(chains: PyTree, arrays: PyTree) -> PyTree:
            return jax.lax.map(lambda one: f(one, eqx.combine(arrays, static)), chains)

        if method == "vectorized":
            return jax.vmap(lambda one: f(one, shared))(chains)
        if method == "sequential":
            return in_turn(chains, arrays)
        devices = num_devices_for(len(jax.tree.leaves(chains)[0]))
        mesh = Mesh(np.array(jax.devices()[:devices]), ("chain",))
        each = PartitionSpec("chain")
        specs = {"in_specs": (each, PartitionSpec()), "out_specs": each}
        return jax.shard_map(in_turn, mesh=mesh, check_vma=False, **specs)(chains, arrays)

    return mapped


def _empty_rows(f: Callable[[], PyTree], capacity: int) -> PyTree:
    shapes = jax.eval_shape(f)
    return jax.tree.map(lambda s: jnp.zeros((capacity, *s.shape), s.dtype), shapes)


def _set_row(rows: PyTree, i: Array, values: PyTree) -> PyTree:
    return jax.tree.map(lambda row, value: row.at[i].set(value), rows, values)


def _filled(f: Callable[[Array], PyTree], first: Array, last: Array, capacity: int) -> PyTree:
    """Rows first to last - 1 of f(i), zero elsewhere, for bounds known only when run."""
    rows = _empty_rows(lambda: f(jnp.asarray(0)), capacity)
    return jax.lax.fori_loop(first, last, lambda i, rows: _set_row(rows, i, f(i)), rows)


def _possible_start(
    key: Key[Array, ""],
    centre: Float[Array, " parameter"],
    spread: Array,
    problem: Problem,
    whitened: bool,
) -> tuple[Float[Array, " parameter"], Bool[Array, ""]]:
    def propose(carry: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        trial, key, _, _ = carry
        key, key_move = jax.random.split(key)
        # A logistic logit is a uniform x: without a whitening the spread 1 fills the box.
        disperse = jax.random.normal if whitened else jax.random.logistic
        eta = disperse(key_move, centre.shape, centre.dtype)
        z = centre + spread * (problem.whitening.factor @ eta)
        theta = from_logit(z, problem.box)
        density = jnp.sum(problem.log_likelihood(theta, problem.data))
        if problem.log_prior is not None:  # which may forbid a point as well
            density += problem.log_prior(theta)
        return trial + 1, key, z, jnp.isfinite(density)

    def again(carry: tuple[Array, Array, Array, Array]) -> Array:
        return (carry[0] < MAX_TRIALS) & ~carry[3]

    first = (jnp.array(0), key, centre, jnp.array(False))
    _, _, z, possible = jax.lax.while_loop(again, propose, first)
    return z, possible
