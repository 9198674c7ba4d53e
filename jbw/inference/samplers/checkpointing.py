"""Where chains are kept while they grow, and how their state becomes plain arrays and back."""

import hashlib
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Protocol

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PyTree

from jbw.inference.samplers.chains import Draw
from jbw.inference.space.problem import Problem

Arrays = Mapping[str, np.ndarray]
Rows = tuple[Draw, np.ndarray, np.ndarray]


class SoFar(NamedTuple):
    """Chains under way, for those who wait.

    Attributes:
        done: Steps taken by every chain, warm-up included.
        total: Steps in all.
        draws: Draws kept so far by name, (chain, draw), in the sampler's coordinates; empty during
            the warm-up.
        divergences: Divergent trajectories of each chain after the warm-up; None where the sampler
            has none.
        left_s: Time left at the rate so far [s].
    """

    done: int
    total: int
    draws: dict[str, np.ndarray]
    divergences: np.ndarray | None
    left_s: float


class Kept(Protocol):
    """A place that outlives the process, for the chains of one posterior."""

    def grown(self, so_far: SoFar) -> None:
        """Told after every chunk of steps."""
        ...

    def load(self) -> Arrays | None:
        """What was saved last, or None."""
        ...

    def due(self) -> bool:
        """Whether to save now."""
        ...

    def save(self, arrays: Arrays, *, last: bool) -> None:
        """Save, in place of what was saved before; `last` when the chains are complete."""
        ...


Keep = Callable[[str], Kept | None]


def no_checkpoint(name: str) -> None:
    """The `Keep` that keeps nothing."""


class Chains(NamedTuple):
    """Chains as far as they have grown.

    Attributes:
        states: The kernel's states, as arrays in the order of their leaves.
        done: Steps taken, warm-up included.
        rows: Draws, terms and log prior kept so far, (chain, draw, ...); None before the first.
        wall_s: Time spent on them [s].
    """

    states: list[np.ndarray]
    done: int
    rows: Rows | None
    wall_s: float


def plain_states(states: PyTree) -> list[np.ndarray]:
    """Leaves of the states as arrays that a file can hold; keys by their data."""
    return [np.asarray(_data(leaf)) for leaf in jax.tree.leaves(states)]


def states_like(plain: list[np.ndarray], like: PyTree) -> PyTree:
    """States from their plain leaves: the kinds, and the devices, of other states."""
    leaves, tree = jax.tree.flatten(like)
    restored = [_restored(*pair) for pair in zip(plain, leaves, strict=True)]
    return jax.tree.unflatten(tree, restored)


def _data(leaf: Array) -> Array:
    return jax.random.key_data(leaf) if _is_key(leaf) else leaf


def _restored(plain: np.ndarray, leaf: Array) -> Array:
    value = jnp.asarray(plain)
    if _is_key(leaf):
        value = jax.random.wrap_key_data(value, impl=jax.random.key_impl(leaf))
    return jax.device_put(value, leaf.sharding)


def _is_key(leaf: Array) -> bool:
    return jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def fingerprint(starts: PyTree, problem: Problem, make: Callable, options: Any) -> str:
    """Hash of all that decides the draws: key, starts, data, coordinates, sampler and options."""
    functions = [
        getattr(f, "__qualname__", type(f).__name__)
        for f in (problem.log_likelihood, problem.log_prior, make)
    ]
    known = functions, make.__module__, problem.box.names, problem.located, options
    digest = hashlib.sha256(repr(known).encode())
    arrays = eqx.filter((starts, problem), eqx.is_array)
    for leaf in jax.tree.leaves(arrays):
        values = np.asarray(_data(leaf))
        digest.update(f"{values.dtype}{values.shape}".encode())
        digest.update(np.ascontiguousarray(values))
    return digest.hexdigest()


def as_arrays(chains: Chains, mark: str) -> dict[str, np.ndarray]:
    """Chains by name, for a `Kept`."""
    arrays = {
        "fingerprint": np.array(mark),
        "done": np.array(chains.done),
        "wall_s": np.array(chains.wall_s),
        **{f"state/{i}": leaf for i, leaf in enumerate(chains.states)},
    }
    if chains.rows is None:
        return arrays
    draw, terms, extra = chains.rows
    return {
        **arrays,
        **{f"theta/{name}": np.asarray(values) for name, values in draw.theta.items()},
        **{f"stats/{name}": np.asarray(values) for name, values in draw.stats.items()},
        "terms": terms,
        "log_prior": extra,
    }


def from_arrays(arrays: Arrays, mark: str) -> Chains | None:
    """Chains from what a `Kept` held; None when they are not of this posterior."""
    if str(arrays.get("fingerprint")) != mark:
        return None
    states = [arrays[f"state/{i}"] for i in range(sum(n.startswith("state/") for n in arrays))]
    rows = None
    if "terms" in arrays:
        draw = Draw(_under("theta/", arrays), _under("stats/", arrays))
        rows = draw, arrays["terms"], arrays["log_prior"]
    return Chains(states, int(arrays["done"]), rows, float(arrays["wall_s"]))


def _under(prefix: str, arrays: Arrays) -> dict[str, Any]:
    return {n.removeprefix(prefix): v for n, v in arrays.items() if n.startswith(prefix)}
