"""Random numbers outside of compiled programs: NumPy's, of a key of JAX.

JAX compiles a program for every shape of numbers that is asked for, which takes longer than all of
these numbers do.
"""

from typing import Any

import jax
import numpy as np
from jaxtyping import Key


def words_of(key: Key[Any, ""]) -> list[int]:
    """The whole numbers that a key stands for."""
    return np.ravel(jax.random.key_data(key)).tolist()


def generator(key: Key[Any, ""]) -> np.random.Generator:
    """NumPy's generator of a key."""
    return np.random.default_rng(words_of(key))
