"""Functions that take arrays of NumPy and of JAX alike."""

from typing import Any

import jax.numpy as jnp
import numpy as np


def namespace(values: Any) -> Any:
    """Return NumPy for NumPy arrays, which compiles nothing, otherwise JAX's NumPy."""
    return np if isinstance(values, np.ndarray) else jnp
