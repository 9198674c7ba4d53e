"""Functions on workers: processes of this machine, or whatever else has a `submit`."""

import multiprocessing
import os
import threading
import time
from collections.abc import Callable, Hashable, Iterator, Sequence
from concurrent import futures
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait
from typing import Any, Protocol

POLL_S = 1.0  # between two looks at jobs that are no futures of Python's


class Executor(Protocol):
    """What runs functions: `concurrent.futures`, `client.get_executor()` of Dask, submitit."""

    def submit(self, fn: Callable[..., Any], /, *args: Any) -> Any:
        """Run a function of some arguments somewhere, and return its future."""
        ...


def submitted[Task: Hashable](
    executor: Executor, function: Callable[[Task], Any], tasks: Sequence[Task]
) -> Iterator[tuple[Task, Any]]:
    """Tasks with their futures, in the order in which these end.

    A future needs `done` and `result`. What waits is cancelled when the caller leaves early.
    """
    jobs = [(executor.submit(function, task), task) for task in tasks]
    waiting = [future for future, _ in jobs]
    task_of = {id(future): task for future, task in jobs}
    try:
        if all(isinstance(future, futures.Future) for future in waiting):
            for future in futures.as_completed(waiting):
                yield task_of[id(future)], future
            return
        while waiting:
            ended = [future for future in waiting if future.done()]
            for future in ended:
                waiting.remove(future)
                yield task_of[id(future)], future
            if not ended:
                time.sleep(POLL_S)
    except BaseException:
        for future in waiting:
            if hasattr(future, "cancel"):
                future.cancel()
        raise


def in_processes[Task: Hashable](
    function: Callable[[Task], Any], tasks: Sequence[Task], workers: int
) -> Iterator[tuple[Task, Any]]:
    """The same in spawned processes; where one of them is killed from outside, the others go on.

    A process that dies breaks its whole pool, and nobody knows which task was its: what then has no
    result runs again, each task in a pool of its own.
    """
    left: list[Task] = []
    with _pool(min(workers, len(tasks))) as pool:
        for task, future in submitted(pool, function, tasks):
            if isinstance(future.exception(), BrokenProcessPool):
                left.append(task)
            else:
                yield task, future
    for task in left:
        with _pool(1) as pool:
            yield from submitted(pool, function, [task])


def _pool(workers: int) -> futures.ProcessPoolExecutor:
    """Spawned processes, for JAX's threads do not outlive a fork."""
    context = multiprocessing.get_context("spawn")
    return futures.ProcessPoolExecutor(max(1, workers), context, _leave_with_parent)


def _leave_with_parent() -> None:
    """End this worker as soon as the process that asked for it is gone, however that came.

    It would otherwise finish its run, hold the run's lock until then, and wait for ever after.
    """
    parent = multiprocessing.parent_process()
    if parent is None:
        return
    sentinel = parent.sentinel

    def watch() -> None:
        wait([sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
