"""A function of the parameters at many points: side by side in lanes, on all processor cores."""

import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

LANES = 32  # points that one compiled call evaluates side by side

OfTheta = Callable[[Mapping[str, Array], Any], PyTree]


def at_points(
    function: OfTheta,
    theta: Mapping[str, Float[np.ndarray, " point"]],
    data: PyTree = None,
    *,
    lanes: int = LANES,
) -> Any:
    """Values of a function of (theta, data) at points by name, compiled once for it and shapes.

    Its leaves are arrays here, with the points along a first axis. Each core takes the next lot of
    so many lanes. What a lot comes to depends on no other, so that the number of cores changes no
    digit.
    """
    count = len(next(iter(theta.values())))
    padded = {name: np.pad(values, (0, -count % lanes), "edge") for name, values in theta.items()}
    lots = [
        {name: jnp.asarray(values[first : first + lanes]) for name, values in padded.items()}
        for first in range(0, count, lanes)
    ]

    def one(lot: Mapping[str, Array]) -> Any:
        return jax.tree.map(np.asarray, _values(function, lot, data))

    with ThreadPoolExecutor(_num_cores()) as threads:  # of which JAX lets the first compile
        found = list(threads.map(one, lots))
    return jax.tree.map(lambda *rows: np.concatenate(rows)[:count], *found)


@eqx.filter_jit
def _values(function: OfTheta, theta: Mapping[str, Float[Array, " point"]], data: PyTree) -> PyTree:
    return jax.vmap(lambda one: function(one, data))(dict(theta))


def _num_cores() -> int:
    """Cores that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)  # not on every system
    return len(affinity(0)) if affinity else os.cpu_count() or 1
