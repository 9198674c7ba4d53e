"""A process of jbw's own: threads of linear algebra, and where compiled code is kept."""

import os
import platform
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

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


KEPT = """
import platform
platform.node = lambda: {host!r}
from jbw.run.session import prepare_process
prepare_process()
import jax
if jax.config.jax_compilation_cache_dir:
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
jax.jit(lambda x: x + 1)(0.0)
print(jax.config.jax_compilation_cache_dir)
"""


def compiling(cache, host="node-1"):
    """A process whose user has the folder `cache`, on a host of that name."""
    free = {name: value for name, value in os.environ.items() if "JAX_" not in name}
    environment = free | {"XDG_CACHE_HOME": str(cache)}
    command = [sys.executable, "-c", KEPT.format(host=host)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=True)


@pytest.mark.skipif(sys.platform != "linux", reason="XDG_CACHE_HOME names the folder on Linux")
def test_a_host_of_another_name_uses_what_was_compiled(tmp_path):
    first = compiling(tmp_path)
    folder = Path(first.stdout.strip())
    kept = sorted(folder.iterdir())
    assert kept
    assert folder.is_relative_to(tmp_path)
    second = compiling(tmp_path, "node-2")
    assert second.stdout == first.stdout
    assert sorted(folder.iterdir()) == kept
    assert not first.stderr + second.stderr


def test_processors_with_other_instructions_and_other_versions_have_folders_of_their_own(
    monkeypatch,
):
    """Code of one processor ends a process on another, which lacks its instructions."""
    import jax

    monkeypatch.setattr(session, "_require_writable", lambda folder: None)
    folders = set()
    with jax_config_kept():
        for found in ("avx avx2", "avx avx2 avx512f"):
            for number in ("0.12.0", "0.12.1"):
                jax.config.update("jax_compilation_cache_dir", None)
                monkeypatch.setattr(session, "instructions", lambda found=found: found)
                monkeypatch.setattr(session, "version", lambda name, number=number: number)
                folders.add(session.keep_compiled())
    assert len(folders) == 4


@contextmanager
def jax_config_kept():
    """Give back what `keep_compiled` sets."""
    import jax

    names = "jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs"
    before = {name: getattr(jax.config, name) for name in names}
    try:
        yield
    finally:
        for name, value in before.items():
            jax.config.update(name, value)


@pytest.mark.skipif(sys.platform != "linux", reason="of /proc/cpuinfo")
def test_instructions_are_those_that_the_system_names():
    assert ("Features" if platform.machine() == "aarch64" else "flags") in Path(
        "/proc/cpuinfo"
    ).read_text()
    assert session.instructions().split() == sorted(session.instructions().split())


def test_where_the_system_lists_none_the_processor_is_named(monkeypatch, tmp_path):
    monkeypatch.setattr(session, "Path", lambda name: tmp_path / "none")
    assert session.instructions().startswith(platform.machine())
    assert platform.version() in session.instructions()


@pytest.mark.skipif(sys.platform != "linux", reason="XDG_CACHE_HOME names the folder on Linux")
def test_a_cache_folder_that_cannot_be_written_is_said_once_and_the_work_goes_on(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("no folder")
    told = compiling(blocked)
    assert told.stdout.strip() == "None"
    assert told.stderr.count("Compiled code cannot be kept") == 1
    assert "persistent compilation cache" not in told.stderr


def test_a_folder_that_may_only_be_read_is_read(tmp_path, monkeypatch):
    import jax

    def refuse(**_):
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(session.tempfile, "TemporaryFile", refuse)
    with jax_config_kept():
        jax.config.update("jax_compilation_cache_dir", str(tmp_path))
        with pytest.warns(UserWarning, match=r"cannot be kept in .*: Read-only file system\. "):
            session.keep_compiled()
        assert jax.config.jax_compilation_cache_dir == str(tmp_path)
        assert jax.config.jax_persistent_cache_min_compile_time_secs == float("inf")
