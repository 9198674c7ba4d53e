"""Evaluation of functions at many parameter points, in batches on all processor cores."""

import logging
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from threading import Event, Lock
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, PyTree

from jbw.kept_programs import KeptProgram

evaluated = logging.getLogger("jbw.progress.points")
LANES = 32  # number of parameter points in one compiled batch
# number of points in a batch of a fit: enough for two-sided differences of seven parameters
FIT_LANES = 16
# This event stops background work whose result is no longer needed.
_GIVEN_UP: ContextVar[Event | None] = ContextVar("given_up", default=None)

OfTheta = Callable[[Mapping[str, Array], Any], PyTree]
# data without the precomputed part, and the precomputed part for each point
Solved = tuple[PyTree, PyTree]
Evaluate = Callable[[Float[np.ndarray, "point parameter"]], Float[np.ndarray, "point value"]]
Solver = Callable[[Mapping[str, np.ndarray], Any, int], Solved | None]


def solved_first(solver: Solver) -> Callable[[Any], Any]:
    """Return a decorator for functions of (theta, data); `solver` computes their costly part.

    At many points the `solver` is called first, with (theta, data, threads). It returns data that
    contain the costly part, as two trees that `equinox.combine` joins: the data without this part,
    and the part alone with the points along a first axis. It returns None if it does not apply. The
    remaining function is fast to compile, and the solver's own program can serve many functions.
    """

    def decorated(function: Any) -> Any:
        function.solver = solver
        return function

    return decorated


def seeing[Data](seen: Callable[[Data], Data]) -> Callable[[Any], Any]:
    """Return a decorator for functions of (theta, data) that use only the data that `seen` keeps.

    Programs depend on all data that are not arrays, such as names. `seen` removes names that do not
    matter to the function, so that data of equal shapes share a program.
    """

    def decorated(function: Any) -> Any:
        function.seen = seen
        return function

    return decorated


def seen_by(function: Any, data: PyTree) -> PyTree:
    """Return the data that a function uses, as marked by `seeing`."""
    seen = getattr(function, "seen", None)
    return data if seen is None else seen(data)


def at_points(
    function: OfTheta,
    theta: Mapping[str, Float[np.ndarray, " point"]],
    data: PyTree = None,
    *,
    lanes: int = LANES,
) -> Any:
    """Evaluate a function of (theta, data) at many parameter points, in parallel batches.

    The result's leaves are arrays with the points along a first axis. Each core takes the next lot
    of `lanes` points. Lots are independent, so the number of cores does not change any digit. A
    function that is `solved_first` is solved first, in lots of `LANES` points.
    """
    data = seen_by(function, data)
    count = len(next(iter(theta.values())))
    solver, given_up = getattr(function, "solver", None), _GIVEN_UP.get()
    cores = num_cores()
    threads = max(cores // -(-count // LANES), 1)  # number of threads for one lot of points

    def directly(lot: Mapping[str, np.ndarray]) -> Any:
        return _values(function, _on_device(lot), data)

    def after_solver(lot: Mapping[str, np.ndarray]) -> Any:
        solved = solver(lot, data, threads)  # pyright: ignore[reportOptionalCall]
        return solved and _rest(function, _on_device(lot), *solved)

    def of_lots(evaluate: Callable[[Mapping[str, np.ndarray]], Any], size: int) -> list[Any]:
        filled = {
            name: np.pad(values, (0, -count % size), "edge") for name, values in theta.items()
        }

        def of_lot(first: int) -> Any:
            if given_up is not None and given_up.is_set():
                raise CancelledError
            lot = {name: values[first : first + size] for name, values in filled.items()}
            return jax.tree.map(np.asarray, evaluate(lot))

        with ThreadPoolExecutor(cores) as pool:  # The first batch compiles the program.
            return list(pool.map(of_lot, range(0, count, size)))

    rows = [None] if solver is None else of_lots(after_solver, LANES)
    if rows[0] is None:  # The solver does not apply.
        rows = of_lots(directly, lanes)
    evaluated.info("%d", count)
    return jax.tree.map(lambda *lots: np.concatenate(lots)[:count], *rows)


def _on_device(lot: Mapping[str, np.ndarray]) -> dict[str, Array]:
    return {name: jax.device_put(values) for name, values in lot.items()}


@KeptProgram
def _values(function: OfTheta, theta: Mapping[str, Float[Array, " point"]], data: PyTree) -> PyTree:
    return jax.vmap(lambda point: function(point, data))(dict(theta))


@KeptProgram
def _rest(
    function: OfTheta, theta: Mapping[str, Float[Array, " point"]], data: PyTree, solved: PyTree
) -> PyTree:
    return jax.vmap(lambda point, motions: function(point, eqx.combine(data, motions)))(
        dict(theta), solved
    )


@contextmanager
def in_background[Made](work: Callable[[], Made]) -> Iterator[Future[Made]]:
    """Run a function in a separate thread while the `with` block does other work.

    The future returns the result or raises the error. If the block ends by an error or an
    interruption, the work stops at its next lot of points.
    """
    given_up = Event()

    def run() -> Made:
        _GIVEN_UP.set(given_up)
        return work()

    with ThreadPoolExecutor(1) as thread:
        try:
            yield thread.submit(run)
        except BaseException:
            given_up.set()
            raise


def side_by_side[Start, End](
    search: Callable[[Start, Evaluate], End], starts: Sequence[Start], evaluate: Evaluate
) -> list[End]:
    """Run searches from several starts in parallel; evaluate their points in common batches.

    Each search runs in a separate thread. As soon as all running searches wait for values, one call
    evaluates the points of all, which fills the lanes that a single search leaves empty. Searches
    are independent, so each ends where it would alone. An error in one search ends all.
    """
    if len(starts) == 1:
        return [search(starts[0], evaluate)]
    meeting = _Meeting(evaluate, len(starts))

    def run(start: Start) -> End:
        try:
            return search(start, meeting.values_at)
        finally:
            meeting.leave()

    with ThreadPoolExecutor(len(starts)) as threads:
        searches = [threads.submit(run, start) for start in starts]
        try:
            return [one_search.result() for one_search in searches]
        except BaseException:  # an interruption must not wait for the other searches
            meeting.close()
            raise


class _Meeting:
    """The common evaluation of parallel searches, after each of them has sent its points."""

    def __init__(self, evaluate: Evaluate, num_running: int) -> None:
        self._evaluate, self._num_running = evaluate, num_running
        self._asked: list[tuple[np.ndarray, Future[np.ndarray]]] = []
        self._is_closed, self._lock = False, Lock()

    def values_at(self, points: np.ndarray) -> np.ndarray:
        """Return the values at one search's points, computed once all searches have sent theirs."""
        values: Future[np.ndarray] = Future()
        with self._lock:
            if self._is_closed:
                raise CancelledError
            self._asked.append((points, values))
            asked = self._complete()
        self._answer(asked)
        return values.result()

    def leave(self) -> None:
        """Remove a finished search, so that the others no longer wait for it."""
        with self._lock:
            self._num_running -= 1
            asked = self._complete()
        self._answer(asked)

    def close(self) -> None:
        """Stop all running searches at their next request for values."""
        with self._lock:
            self._is_closed = True
            asked, self._asked = self._asked, []
        for _, values in asked:
            values.cancel()

    def _complete(self) -> list[tuple[np.ndarray, Future[np.ndarray]]]:
        """Return the points of all running searches as soon as each of them has sent some."""
        if len(self._asked) < self._num_running:
            return []
        asked, self._asked = self._asked, []
        return asked

    def _answer(self, asked: list[tuple[np.ndarray, Future[np.ndarray]]]) -> None:
        if not asked:
            return
        try:
            rows = self._evaluate(np.concatenate([points for points, _ in asked]))
        except BaseException as cause:
            for _, values in asked:
                values.set_exception(cause)
            return
        ends = np.cumsum([len(points) for points, _ in asked])
        for (_, values), own in zip(asked, np.split(rows, ends[:-1]), strict=True):
            values.set_result(own)


def forget() -> None:
    """Release compiled functions for data shapes that are no longer used, some 50 MB each.

    Functions that are needed again are compiled again, or read from the user's cache.
    """
    _values.forget()
    _rest.forget()


def num_cores() -> int:
    """Return the number of cores that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)  # not available on every system
    return len(affinity(0)) if affinity else os.cpu_count() or 1
