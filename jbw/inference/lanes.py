"""A function of the parameters at many points: side by side in lanes, on all processor cores."""

import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, PyTree

LANES = 32  # points that one compiled call evaluates side by side

OfTheta = Callable[[Mapping[str, Array], Any], PyTree]
Solved = tuple[PyTree, PyTree]  # data without what was solved, and this, with the points first
Solver = Callable[[Mapping[str, np.ndarray], Any, int], Solved | None]


def solved_first(solver: Solver) -> Callable[[Any], Any]:
    """Decorate a function of (theta, data) whose costly part is worked out before, by itself.

    At many points the `solver` is asked first, of (theta, data, threads): for data that hold the
    costly part already, in two trees that `equinox.combine` joins, that without it and the part
    alone, with the points along a first axis; or None where it can do nothing. What is left to
    compile of the function is small, and the solver's own program can serve many functions.
    """

    def decorated(function: Any) -> Any:
        function.solver = solver
        return function

    return decorated


def seeing[Data](seen: Callable[[Data], Data]) -> Callable[[Any], Any]:
    """Decorate a function of (theta, data) to which data with equal `seen` are the same.

    A program is compiled for what is no array, names among it. Of names that the function does not
    tell apart, `seen` leaves none: data of equal shapes then share a program, whatever their names.
    """

    def decorated(function: Any) -> Any:
        function.seen = seen
        return function

    return decorated


def seen_by(function: Any, data: PyTree) -> PyTree:
    """What a function sees of data, by `seeing`; all where it says nothing."""
    seen = getattr(function, "seen", None)
    return data if seen is None else seen(data)


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
    digit. A function that is `solved_first` is solved first.
    """
    data = seen_by(function, data)
    count = len(next(iter(theta.values())))
    padded = {name: np.pad(values, (0, -count % lanes), "edge") for name, values in theta.items()}
    lots = [
        {name: values[first : first + lanes] for name, values in padded.items()}
        for first in range(0, count, lanes)
    ]

    solver = getattr(function, "solver", None)
    cores = num_cores()

    def values_of(lot: Mapping[str, np.ndarray]) -> Any:
        solved = None if solver is None else solver(lot, data, max(cores // len(lots), 1))
        theta = {name: jax.device_put(values) for name, values in lot.items()}
        if solved is None:
            return jax.tree.map(np.asarray, _values(function, theta, data))
        return jax.tree.map(np.asarray, _rest(function, theta, *solved))

    with ThreadPoolExecutor(cores) as threads:  # of which JAX lets the first compile
        lot_values = list(threads.map(values_of, lots))
    return jax.tree.map(lambda *rows: np.concatenate(rows)[:count], *lot_values)


@eqx.filter_jit
def _values(function: OfTheta, theta: Mapping[str, Float[Array, " point"]], data: PyTree) -> PyTree:
    return jax.vmap(lambda point: function(point, data))(dict(theta))


@eqx.filter_jit
def _rest(
    function: OfTheta, theta: Mapping[str, Float[Array, " point"]], data: PyTree, solved: PyTree
) -> PyTree:
    """Values of the function where the costly part was solved before."""
    return jax.vmap(lambda point, motions: function(point, eqx.combine(data, motions)))(
        dict(theta), solved
    )


def forget() -> None:
    """Free the programs of functions at points, some 50 MB each, once data have other shapes.

    What is asked for again is compiled again, or read from the user's cache.
    """
    compiled = getattr(_values, "_cached", None)  # where Equinox keeps what JAX compiled
    clear = getattr(compiled, "clear_cache", None)
    if clear is not None:
        clear()


def num_cores() -> int:
    """Cores that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)  # not on every system
    return len(affinity(0)) if affinity else os.cpu_count() or 1
