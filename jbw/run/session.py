"""JAX and linear algebra as every run of jbw wants them, in a process of its own."""

import logging
import os
import platform
from pathlib import Path

import platformdirs

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
    import scipy.linalg  # noqa: F401  # NumPy and SciPy bring a library each, found once loaded
    from threadpoolctl import threadpool_limits

    jax.config.update("jax_enable_x64", True)
    keep_compiled(platform.node())
    logging.getLogger("jax").setLevel(logging.ERROR)
    if not any(name in os.environ for name in THREADS):
        threadpool_limits(1, user_api="blas")


def keep_compiled(name: str) -> Path | None:
    """Keep compiled code in a folder of the user's cache; None where one is named already."""
    import jax

    if jax.config.jax_compilation_cache_dir is not None:  # the environment's, or a program's
        return None
    kept = platformdirs.user_cache_path("jbw") / name
    jax.config.update("jax_compilation_cache_dir", str(kept))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    return kept
