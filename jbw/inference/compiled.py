"""Release of JAX's compiled code in long processes."""

import gc
from pathlib import Path

import jax

MAPS = Path("/proc/self/maps")
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
    jax.clear_caches()
    gc.collect()
    return True
