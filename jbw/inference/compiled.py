"""Release of JAX's compiled code in long processes."""

import ctypes
import gc
import os
from contextlib import suppress
from pathlib import Path

import jax

MAPS = Path("/proc/self/maps")
PAGES = Path("/proc/self/statm")
LIMIT = Path("/proc/sys/vm/max_map_count")
# fraction of the memory mappings allowed by Linux above which compiled code is released
PART = 0.6


def forget_when_many() -> bool:
    """Release compiled code near the limit of memory mappings; return whether it was released.

    Otherwise the process would die in the compiler without a message.
    """
    if not (MAPS.exists() and LIMIT.exists()):
        return False
    if MAPS.read_bytes().count(b"\n") < PART * int(LIMIT.read_text()):
        return False
    _forget()
    return True


def forget_when_large(most: float) -> bool:
    """Release compiled code if a process uses more than `most` bytes; return whether it did."""
    if not PAGES.exists():
        return False
    if int(PAGES.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") <= most:
        return False
    _forget()
    with suppress(AttributeError, OSError):  # only the GNU C library has malloc_trim
        ctypes.CDLL(None).malloc_trim(0)  # returns free memory to the system
    return True


def _forget() -> None:
    jax.clear_caches()
    gc.collect()
