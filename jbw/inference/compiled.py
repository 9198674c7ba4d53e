"""Compiled code that a long process keeps, and when it must let go of it."""

import gc
from pathlib import Path

import jax

MAPS = Path("/proc/self/maps")
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
    jax.clear_caches()
    gc.collect()
    return True
