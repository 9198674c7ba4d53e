"""JAX and linear algebra as every run of jbw wants them, in a process of its own."""

import ctypes
import gc
import logging
import os
import platform
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import platformdirs

COMPILED = "/jax/core/compile/backend_compile_duration"
# Of address space, less than which compilers and linear algebra may end the process, 0.7 to 1.5
# GiB of it where two cores compile.
RESERVED = 3.0 * 2**30
LONG_S = 0.3  # of a compile: below, less is freed than looking for it is worth
THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")


def prepare_process() -> None:
    """Two host devices, so that chains run side by side, float64, and compiled code kept.

    Before JAX starts. What was compiled stays in the user's cache folder, one a machine, for the
    code holds instructions of its processor; JAX_ENABLE_COMPILATION_CACHE=0 turns that off.
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
    keep_compiled(platform.node())
    give_back_after_compiling()
    logging.getLogger("jax").setLevel(logging.ERROR)
    limit_threads()


def limit_threads() -> None:
    """Linear algebra in one thread unless the environment names a number."""
    import scipy.linalg  # noqa: F401  # NumPy and SciPy bring a library each, found once loaded
    from threadpoolctl import threadpool_limits

    if not any(name in os.environ for name in THREADS):
        threadpool_limits(1, user_api="blas")


def address_space() -> float:
    """Most address space that this process may have [bytes]; infinite where nothing limits it."""
    try:
        import resource
    except ImportError:  # no such limits on this system
        return float("inf")
    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    return float("inf") if soft == resource.RLIM_INFINITY else float(soft)


@cache
def give_back_after_compiling() -> None:
    """Let the C library give back to the system what every longer compile has freed.

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
    """What is told of durations and asks to `trim` the heap, keeping no margin, after compiles."""

    def after_compile(event: str, duration: float, **facts: str | int) -> None:
        if event == COMPILED and duration >= LONG_S:
            trim(0)

    return after_compile


def keep_compiled(name: str) -> Path | None:
    """Keep compiled code in a folder of the user's cache; None where one is named already."""
    import jax

    if jax.config.jax_compilation_cache_dir is not None:  # the environment's, or a program's
        return None
    cache = platformdirs.user_cache_path("jbw") / name
    jax.config.update("jax_compilation_cache_dir", str(cache))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    return cache
