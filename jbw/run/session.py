"""The settings of JAX and of linear algebra for every run of jbw in a separate process."""

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

from jbw.cache import Programs
from jbw.report.messages import stages

COMPILED = "/jax/core/compile/backend_compile_duration"
# Limit of the address space [bytes] below which compilers and linear algebra may crash the process;
# compilation on two cores uses 0.7 to 1.5 GiB of it.
RESERVED = 3.0 * 2**30
# Compilations shorter than this [s] leave too little unused memory to be worth its return to the
# system.
LONG_S = 0.3
THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")


def prepare_process() -> None:
    """Configure JAX for a run: two host devices, float64, and a cache of compiled code.

    It must run before JAX starts. Compiled code (`keep_compiled`) and the programs that it comes
    from (`KeptProgram`) are kept in the user's cache folder; JAX_ENABLE_COMPILATION_CACHE=0 turns
    that off. Linear algebra has one thread unless the environment states a number: OpenBLAS's
    threads spin while they wait, which does not speed up a fit, and next to another busy process
    costs it seconds for 8 ms of work.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    if "host_platform_device_count" not in flags and (os.cpu_count() or 1) > 1:
        os.environ["XLA_FLAGS"] = f"{flags} --xla_force_host_platform_device_count=2".strip()
    import jax

    # Objects from JAX tracing live long; collecting garbage among them takes 2 % of a run.
    gc.set_threshold(100_000, 20, 20)
    jax.config.update("jax_enable_x64", True)
    if keep_compiled() is not None and jax.config.jax_enable_compilation_cache:
        Programs.are_kept = True
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
    """Register a JAX listener that returns unused memory to the system after long compilations.

    It is called once per process, however many commands run in it: each listener would search the
    heap again. A compiler frees tens of megabytes in small pieces, which glibc keeps for later
    requests: after a dozen programs it is a gigabyte of unused memory. With another C library
    nothing is done.
    """
    from jax import monitoring

    if sys.platform != "linux":
        return
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        monitoring.register_event_duration_secs_listener(trimming(trim))


def trimming(trim: Callable[[int], Any]) -> Callable[..., None]:
    """Return a listener that returns unused memory to the system after long compilations.

    It calls `trim` without a margin after each compilation of `LONG_S` or more.
    """

    def after_compile(event: str, duration: float, **facts: str | int) -> None:
        if event == COMPILED and duration >= LONG_S:
            trim(0)

    return after_compile


def keep_compiled(purpose: str = "compiled") -> Path | None:
    """Keep compiled code in the user's cache; return its folder, or None if another cache is set.

    The name of the folder contains `purpose`, the instructions of the processor and the versions of
    JAX. Containers and nodes of one cluster thus share compiled code, and no processor runs
    instructions that it lacks. A folder without write permission is only read, with a warning.
    """
    import jax

    # The environment or the calling program may have set this.
    named = jax.config.jax_compilation_cache_dir
    digest = hashlib.sha256(instructions().encode()).hexdigest()[:12]
    versions = f"jax-{version('jax')}-{version('jaxlib')}"
    own = platformdirs.user_cache_path("jbw") / f"{purpose}-{digest}-{versions}"
    folder = own if named is None else Path(named)
    if named is None:
        jax.config.update("jax_compilation_cache_dir", str(own))
        # All programs are kept, because compiling a small one takes 30 ms or more and loading it
        # only a few, and a run has dozens.
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    if "://" not in str(named):  # JAX opens a remote folder itself.
        _require_writable(folder)
    return own if named is None else None


def instructions() -> str:
    """Return the processor's features in one line, or another text that identifies it."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            name, _, features = line.partition(":")
            # names of the line that lists the processor's features, on x86 and on Arm
            if name.strip() in ("flags", "Features"):
                return " ".join(sorted(features.split()))
    # On Apple's processors only the kernel's version identifies the processor.
    return f"{platform.machine()} {platform.processor()} {platform.version()}"


def _require_writable(folder: Path) -> None:
    """Warn once if compiled code cannot be saved in a folder; JAX then does not write there."""
    import jax

    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        warnings.warn(stages.unkept_code(str(folder), error.strerror or str(error)), stacklevel=3)
        # Warnings are suppressed, because JAX would warn for every program, although it can still
        # read from the folder.
        jax.config.update("jax_persistent_cache_min_compile_time_secs", math.inf)
        if not folder.is_dir():
            jax.config.update("jax_compilation_cache_dir", None)
