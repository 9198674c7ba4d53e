"""The recording of compilations within a block of a test, and the release of compiled code."""

import ctypes
import gc
import os
from contextlib import suppress
from pathlib import Path

import jax

PAGES = Path("/proc/self/statm")


def kept_code():
    """Return the environment in which a process keeps compiled code where the tests keep theirs."""
    folder = jax.config.jax_compilation_cache_dir
    if not folder:
        return {}
    return {
        "JAX_COMPILATION_CACHE_DIR": folder, "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }  # fmt: skip


class Compiled(list):
    """The names of the programs that are compiled within a `with` block."""

    def __enter__(self):
        jax.monitoring.register_event_duration_secs_listener(self.listen)
        return self

    def __exit__(self, *_):
        jax.monitoring.unregister_event_duration_listener(self.listen)

    def listen(self, event, seconds, **about):
        if event.endswith("backend_compile_duration"):
            self.append(about.get("fun_name"))


def forget_when_large(most):
    """Release compiled code if this process uses more than `most` bytes; return whether it did."""
    if not PAGES.exists():
        return False
    if int(PAGES.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") <= most:
        return False
    jax.clear_caches()
    gc.collect()
    with suppress(AttributeError, OSError):  # only the GNU C library has malloc_trim
        ctypes.CDLL(None).malloc_trim(0)  # returns free memory to the system
    return True
