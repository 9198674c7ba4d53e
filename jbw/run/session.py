"""JAX and linear algebra as every run of jbw wants them, in a process of its own."""

import ctypes
import gc
import hashlib
import logging
import math
import os
import platform
import sys
import tempfile
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import platformdirs

from jbw.report.messages import stages

COMPILED = "/jax/core/compile/backend_compile_duration"
# Of address space, less than which compilers and linear algebra may end the process, 0.7 to 1.5
# GiB of it where two cores compile.
RESERVED = 3.0 * 2**30
LONG_S = 0.3  # of a compile: below, less is freed than looking for it is worth
THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")


def prepare_process() -> None:
    """Configure two host devices for parallel chains, float64, and a cache of compiled code.

    Before JAX starts. What was compiled stays in the user's cache folder (`keep_compiled`);
    JAX_ENABLE_COMPILATION_CACHE=0 turns that off.
    Linear algebra has one thread unless the environment names a number: OpenBLAS's turn while they
    wait, which gains a fit nothing, and takes it seconds for 8 ms beside another busy process.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    if "host_platform_device_count" not in flags and (os.cpu_count() or 1) > 1:
        os.environ["XLA_FLAGS"] = f"{flags} --xla_force_host_platform_device_count=2".strip()
    import jax

    # What JAX traces lives long, and looking through it for garbage takes a fiftieth of a run.
    gc.set_threshold(100_000, 20, 20)
    jax.config.update("jax_enable_x64", True)
    keep_compiled()
    give_back_after_compiling()
    logging.getLogger("jax").setLevel(logging.ERROR)
    limit_threads()


def limit_threads() -> None:
    """Limit linear algebra to one thread unless the environment gives a number."""
    import scipy.linalg  # noqa: F401  # NumPy and SciPy bring a library each, found once loaded
    from threadpoolctl import threadpool_limits

    if not any(name in os.environ for name in THREADS):
        threadpool_limits(1, user_api="blas")


@cache
def give_back_after_compiling() -> None:
    """Register a listener that returns freed memory to the system after long compilations.

    Once a process, however many commands it runs: each listener would search the heap anew. A
    compiler frees tens of megabytes in small pieces, which glibc keeps for more of them: after a
    dozen programs a gigabyte that nobody uses. Where the library is another, nothing is done.
    """
    from jax import monitoring

    if sys.platform != "linux":
        return
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        monitoring.register_event_duration_secs_listener(trimming(trim))


def trimming(trim: Callable[[int], Any]) -> Callable[..., None]:
    """Return a listener that calls `trim` with no margin after each long compilation."""

    def after_compile(event: str, duration: float, **facts: str | int) -> None:
        if event == COMPILED and duration >= LONG_S:
            trim(0)

    return after_compile


def keep_compiled(purpose: str = "compiled") -> Path | None:
    """Keep compiled code in a folder of the user's cache; return it, None where one is named.

    The folder is named by `purpose`, the instructions of the processor and the versions of JAX, so
    that containers and nodes of one cluster find what any of them compiled, and no processor runs
    instructions that it lacks. A folder without write permission is only read, with a warning.
    """
    import jax

    named = jax.config.jax_compilation_cache_dir  # by the environment, or by a program
    digest = hashlib.sha256(instructions().encode()).hexdigest()[:12]
    versions = f"jax-{version('jax')}-{version('jaxlib')}"
    own = platformdirs.user_cache_path("jbw") / f"{purpose}-{digest}-{versions}"
    folder = own if named is None else Path(named)
    if named is None:
        jax.config.update("jax_compilation_cache_dir", str(own))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    if "://" not in str(named):  # a folder that JAX reaches by itself
        _require_writable(folder)
    return own if named is None else None


def instructions() -> str:
    """Return the processor's features in one line, or what else tells its instructions."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            name, _, features = line.partition(":")
            if name.strip() in ("flags", "Features"):  # of x86, of Arm
                return " ".join(sorted(features.split()))
    # Apple names the chip in the version of its kernel alone.
    return f"{platform.machine()} {platform.processor()} {platform.version()}"


def _require_writable(folder: Path) -> None:
    """Warn once where compiled code cannot be kept in a folder, and have JAX write none there."""
    import jax

    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        warnings.warn(stages.unkept_code(str(folder), error.strerror or str(error)), stacklevel=3)
        # JAX would warn of every program: a folder is read at most.
        jax.config.update("jax_persistent_cache_min_compile_time_secs", math.inf)
        if not folder.is_dir():
            jax.config.update("jax_compilation_cache_dir", None)
