"""Functions on workers: spawned processes, some of which die, and executors of other makes."""

import operator
import os
import subprocess
import sys
import time
from functools import partial

import pytest

from jbw.study import workers
from jbw.study.workers import in_processes, submitted


def results(jobs):
    """Task to its result, or the name of its error."""
    return {
        task: future.result() if future.exception() is None else type(future.exception()).__name__
        for task, future in jobs
    }


def noted(path, act):
    """Note in a file that a task begins and in which process, then do something."""
    with path.open("a") as stream:
        stream.write(f"{os.getpid()}\n")
    return act()


def test_a_process_that_dies_takes_no_other_with_it(tmp_path):
    """A long task beside it begins once, what waits goes on, and its own comes again at the end."""
    dying, failing = partial(noted, tmp_path / "dying", partial(os._exit, 9)), partial(int, "x")
    seconds = {"long": 0.4, "first": 0.0, "second": 0.0}
    fine = {n: partial(noted, tmp_path / n, partial(time.sleep, s)) for n, s in seconds.items()}
    tasks = [fine["long"], dying, fine["first"], failing, fine["second"]]
    found = list(in_processes(operator.call, tasks, 2))
    assert found[-1][0] is dying
    assert results(found) == {
        dying: "BrokenProcessPool", failing: "ValueError", **dict.fromkeys(fine.values())
    }  # fmt: skip
    began = {name: (tmp_path / name).read_text().splitlines() for name in ("dying", *fine)}
    assert {name: len(each) for name, each in began.items()} == {
        "dying": 2,
        **dict.fromkeys(fine, 1),
    }
    # That of the long one, and one new one in place of the dead for all the others.
    assert len({began[name][0] for name in fine}) <= 2


def test_no_task_needs_no_process():
    assert list(in_processes(abs, [], 2)) == []


class Job:
    """A job as submitit has it: no future of Python's, without `cancel`."""

    def __init__(self, number, after):
        self.number, self.at = number, time.monotonic() + after

    def done(self):
        return time.monotonic() >= self.at

    def result(self):
        return self.number**2


class Cluster:
    def submit(self, function, task):
        return Job(task, 0.02 * task)


def test_jobs_that_are_no_futures_are_waited_for(monkeypatch):
    monkeypatch.setattr(workers, "POLL_S", 0.005)
    found = [(task, job.result()) for task, job in submitted(Cluster(), abs, [3, 1, 2])]
    assert found == [(1, 1), (2, 4), (3, 9)]


PARENT = """
import operator, os, sys, time
from functools import partial
from jbw.study.workers import in_processes
if __name__ == "__main__":
    task = partial(exec, "import os, time; print(os.getpid(), flush=True); time.sleep(600)")
    list(in_processes(operator.call, [task], 1))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_a_worker_leaves_with_a_parent_that_is_killed(tmp_path):
    """It would hold the lock of its run, which could not be gone on with."""
    (tmp_path / "parent.py").write_text(PARENT)
    command = [sys.executable, tmp_path / "parent.py"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        worker = int(parent.stdout.readline())
        parent.kill()
        parent.stdout.read()  # ends when the worker's end of the pipe is closed as well
    for _ in range(200):
        try:
            os.kill(worker, 0)
        except ProcessLookupError:
            return
        time.sleep(0.05)
    pytest.fail("the worker outlived its parent")
