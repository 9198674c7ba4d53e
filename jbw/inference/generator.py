"""Random numbers outside of compiled programs, of a key of JAX: its parts, and NumPy's numbers.

JAX compiles a program for every shape of numbers that is asked for, which takes longer than all of
these numbers do.
"""

from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Key

MOST = 16  # keys that one program splits a key into


def words_of(key: Key[Any, ""]) -> list[int]:
    """Return the whole numbers that a key stands for."""
    return np.ravel(jax.random.key_data(key)).tolist()


def parts_of(key: Key[Array, ""], count: int) -> list[Key[Array, ""]]:
    """Return the keys of `jax.random.split` in a list, with one program for up to 16 keys.

    The first keys are the same however many are asked for. Taken from an array of keys, each would
    be a program of its own.
    """
    split = jax.random.split(key, max(count, MOST))
    rows, kind = np.asarray(jax.random.key_data(split)), jax.random.key_impl(key)
    return [jax.random.wrap_key_data(jax.device_put(row), impl=kind) for row in rows[:count]]


def generator(key: Key[Any, ""]) -> np.random.Generator:
    """Return NumPy's generator seeded by a key."""
    return np.random.default_rng(words_of(key))
