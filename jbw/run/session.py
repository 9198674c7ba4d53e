"""JAX and linear algebra as every run of jbw wants them, in a process of its own."""

import logging
import os
import platform
from pathlib import Path

import platformdirs

THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")


def prepare_process() -> None:
    """Two host devices, so that chains run side by side, float64, and compiled code kept.

    Of linear algebra one thread, unless the environment names a number: see `_one_thread`.
    Before JAX starts. What was compiled stays in the user's cache folder, one a machine, for the
    code holds instructions of its processor; JAX_ENABLE_COMPILATION_CACHE=0 turns that off.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    if "host_platform_device_count" not in flags and (os.cpu_count() or 1) > 1:
        os.environ["XLA_FLAGS"] = f"{flags} --xla_force_host_platform_device_count=2".strip()
    import jax

    jax.config.update("jax_enable_x64", True)
    keep_compiled(platform.node())
    logging.getLogger("jax").setLevel(logging.ERROR)
    if not any(name in os.environ for name in THREADS):
        _one_thread()


def keep_compiled(name: str) -> Path | None:
    """Keep compiled code in a folder of the user's cache; None where one is named already."""
    import jax

    if jax.config.jax_compilation_cache_dir is not None:  # the environment's, or a program's
        return None
    kept = platformdirs.user_cache_path("jbw") / name
    jax.config.update("jax_compilation_cache_dir", str(kept))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    return kept


def _one_thread() -> None:
    """One thread for NumPy's and SciPy's linear algebra; the cores are shared by lanes.

    Threads of OpenBLAS wait for each other turning. On the tall matrices of a fit they gain
    nothing, and beside one other process that is busy a product of 8 ms takes seconds.
    """
    import scipy.linalg  # noqa: F401  # each of the two brings a library of its own, found if loaded
    from threadpoolctl import threadpool_limits

    threadpool_limits(1, user_api="blas")
