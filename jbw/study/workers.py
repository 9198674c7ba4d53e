"""Execution of functions by workers: local processes, or any executor with a method `submit`."""

import multiprocessing
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Hashable, Iterator, Sequence
from concurrent import futures
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.connection import wait
from typing import Any, Protocol

from jbw.errors import ConfigError

ANSWER_S = 10  # time in which a scheduler must answer [s]
POLL_S = 1.0  # time between two checks of tasks whose futures are not those of Python [s]


class Executor(Protocol):
    """Any object that runs functions elsewhere: an executor of Python, Dask or submitit."""

    def submit(self, fn: Callable[..., Any], /, *args: Any) -> Any:
        """Run a function with some arguments on a worker; return its future."""
        ...


@contextmanager
def dask_executor(address: str) -> Iterator[Executor]:
    """Yield an executor of the workers of a running Dask scheduler.

    Raises:
        ConfigError: Dask is not installed, no scheduler answers, or it has no workers.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise ConfigError(
            "Option --scheduler needs the package `distributed` of Dask, which is missing.",
            remedy='Install it: pip install "jbw[dask]".',
        ) from error
    try:
        # As the default client, it would also be used by xarray's writing in this process.
        client = Client(address, timeout=ANSWER_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise ConfigError(
            f"No Dask scheduler answers at {address}: {error or type(error).__name__}.",
            remedy="Start one with `dask scheduler --port 8786`, and give its address, for example "
            "--scheduler tcp://localhost:8786.",
        ) from error
    with client:
        if not client.nthreads():
            raise ConfigError(
                f"The Dask scheduler at {address} has no workers.",
                remedy=f"Start some, here two: dask worker {address} --nworkers 2 --nthreads 1",
            )
        yield client.get_executor(pure=False)


def submitted[Task: Hashable](
    executor: Executor, function: Callable[[Task], Any], tasks: Sequence[Task]
) -> Iterator[tuple[Task, Any]]:
    """Yield each task with its future, in the order in which the tasks end.

    A future needs `done` and `result`. Waiting jobs are cancelled when the caller leaves early.
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
    """Run tasks in separate processes; if a process is killed, all other tasks continue.

    The task of a killed process, which may have needed too much memory, runs again alone after all
    other tasks have ended.
    """
    killed = yield from _side_by_side(function, deque(tasks), workers)
    for task, _ in killed:
        yield from (yield from _side_by_side(function, deque([task]), 1))


def _side_by_side[Task: Hashable](
    function: Callable[[Task], Any], waiting: deque[Task], workers: int
) -> Generator[tuple[Task, Any], None, list[tuple[Task, Any]]]:
    """Run tasks in parallel and yield each with its future; return the tasks whose process died.

    Every process has a separate pool: its death breaks no other one and shows which task it had.
    """
    free = [_pool() for _ in range(min(workers, len(waiting)))]
    under_way: dict[futures.Future[Any], tuple[Task, futures.ProcessPoolExecutor]] = {}
    killed: list[tuple[Task, Any]] = []
    try:
        while waiting or under_way:
            while waiting and free:
                future, pool = _begun(free.pop(), function, waiting[0])
                under_way[future] = waiting.popleft(), pool
            ended, _ = futures.wait(under_way, return_when=futures.FIRST_COMPLETED)
            for future in ended:
                task, pool = under_way.pop(future)
                free.append(pool)
                if isinstance(future.exception(), BrokenProcessPool):
                    killed.append((task, future))
                else:
                    yield task, future
    finally:
        for pool in (*free, *(pool for _, pool in under_way.values())):
            pool.shutdown()
    return killed


def _begun[Task](
    pool: futures.ProcessPoolExecutor, function: Callable[[Task], Any], task: Task
) -> tuple[futures.Future[Any], futures.ProcessPoolExecutor]:
    """Start a task; return its future and the process pool, a new pool if the old one has ended."""
    try:
        return pool.submit(function, task), pool
    except BrokenProcessPool:
        pool.shutdown()
        pool = _pool()
        return pool.submit(function, task), pool


def _pool() -> futures.ProcessPoolExecutor:
    """Return a pool of one spawned process, because JAX's threads do not survive a fork.

    The process starts with its first task.
    """
    context = multiprocessing.get_context("spawn")
    return futures.ProcessPoolExecutor(1, context, _leave_with_parent)


def _leave_with_parent() -> None:
    """End this worker process as soon as its parent process ends, for whatever reason.

    Otherwise it would finish its run, hold the run's lock until then, and wait for ever after.
    """
    parent = multiprocessing.parent_process()
    if parent is None:
        return
    sentinel = parent.sentinel

    def watch() -> None:
        wait([sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
