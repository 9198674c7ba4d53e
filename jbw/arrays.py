"""Functions that take arrays of NumPy and of JAX alike."""

from typing import Any

import numpy as np


def namespace(values: Any) -> Any:
    """Return NumPy for NumPy arrays, which compiles nothing, otherwise JAX's NumPy."""
    if isinstance(values, np.ndarray):
        return np
    import jax.numpy as jnp  # This import is slow, and arrays of JAX exist only after it.

    return jnp
