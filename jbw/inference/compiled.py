"""Compiled code that a long process keeps, and when it must let go of it."""

import ctypes
import gc
import os
from contextlib import suppress
from pathlib import Path

import jax

MAPS = Path("/proc/self/maps")
PAGES = Path("/proc/self/statm")
LIMIT = Path("/proc/sys/vm/max_map_count")
PART = 0.6  # of the pieces of memory that Linux lets a process map; a compiled function holds some


def forget_when_many() -> bool:
    """Forget what is compiled where a process nears its limit of mappings; whether it did.

    A process that runs out of them dies in the compiler, with no word of why.
    """
    if not (MAPS.exists() and LIMIT.exists()):
        return False
    if MAPS.read_bytes().count(b"\n") < PART * int(LIMIT.read_text()):
        return False
    _forget()
    return True


def forget_when_large(most: float) -> bool:
    """Forget what is compiled where a process holds more than so many bytes; whether it did."""
    if not PAGES.exists():
        return False
    if int(PAGES.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") <= most:
        return False
    _forget()
    with suppress(AttributeError, OSError):  # other C libraries have no such function
        ctypes.CDLL(None).malloc_trim(0)  # what is free goes back to the system
    return True


def _forget() -> None:
    jax.clear_caches()
    gc.collect()
