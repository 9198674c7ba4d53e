"""A process of jbw's own: threads of linear algebra, which only a fresh process shows."""

import os
import subprocess
import sys

import pytest

from jbw.run import session
from jbw.run.session import COMPILED, THREADS, trimming

SHOWN = """
from jbw.run.session import prepare_process
prepare_process()
from threadpoolctl import threadpool_info
print({one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"})
"""


@pytest.mark.parametrize(("named", "found"), [({}, "{1}"), ({"OPENBLAS_NUM_THREADS": "2"}, "{2}")])
def test_linear_algebra_has_one_thread_unless_the_environment_names_more(named, found):
    """A thread that waits for another turns idly, which beside a busy process takes seconds."""
    if (os.cpu_count() or 1) < 2:
        pytest.skip("one core has one thread")
    without = {name: value for name, value in os.environ.items() if name not in THREADS}
    shown = subprocess.run(
        [sys.executable, "-c", SHOWN], env=without | named, capture_output=True, text=True
    )
    assert shown.stdout.strip() == found, shown.stderr


def test_the_heap_is_given_back_after_longer_compiles_alone():
    trims = []
    after_compile = trimming(trims.append)
    for event, seconds in ((COMPILED, 0.01), ("/jax/other", 9.0), (COMPILED, 2.0)):
        after_compile(event, seconds, fun_name="any")
    assert trims == [0]


@pytest.mark.skipif(sys.platform != "linux", reason="of glibc")
def test_a_process_of_several_commands_gives_back_once_a_compile(monkeypatch):
    import jax

    listeners = []
    add = "register_event_duration_secs_listener"
    monkeypatch.setattr(jax.monitoring, add, listeners.append)
    session.give_back_after_compiling.cache_clear()
    for _ in range(3):
        session.give_back_after_compiling()
    session.give_back_after_compiling.cache_clear()  # what was added is of this test alone
    assert len(listeners) <= 1


@pytest.mark.skipif(sys.platform != "linux", reason="of glibc")
def test_a_process_asks_after_its_own_compiles(monkeypatch):
    """JAX tells of a compile by the name that is listened for."""
    import jax

    trims = []
    monkeypatch.setattr(session, "LONG_S", 0.0)
    listener = trimming(trims.append)
    jax.monitoring.register_event_duration_secs_listener(listener)
    try:
        jax.jit(lambda x: x + 1.2345)(1.0)
    finally:
        jax.monitoring.unregister_event_duration_listener(listener)
    assert set(trims) == {0}


LIMITED = """
import resource
from jbw.cli.progress import computing
resource.setrlimit(resource.RLIMIT_AS, ({limit}, resource.RLIM_INFINITY))
with computing():
    pass
"""


@pytest.mark.skipif(sys.platform != "linux", reason="limits on the address space are Linux's")
@pytest.mark.parametrize(
    ("limit", "is_said"), [("int(2.5 * 2**30)", True), ("resource.RLIM_INFINITY", False)]
)
def test_a_limit_on_the_address_space_that_may_end_the_process_is_said(limit, is_said):
    command = [sys.executable, "-c", LIMITED.format(limit=limit)]
    told = subprocess.run(command, capture_output=True, text=True, check=True).stderr
    assert ("limited to 2.5 GiB" in told and "ulimit -v unlimited" in told) is is_said
