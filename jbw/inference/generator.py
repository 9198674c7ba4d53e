"""Random numbers for use outside compiled programs, made by NumPy from JAX keys.

JAX compiles a program for every shape of random numbers, which takes longer than generating them.
"""

from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Key

MOST = 16  # number of keys into which one compiled program splits a key


def words_of(key: Key[Any, ""]) -> list[int]:
    """Return the whole numbers that form a random key."""
    return np.ravel(jax.random.key_data(key)).tolist()


def parts_of(key: Key[Array, ""], count: int) -> list[Key[Array, ""]]:
    """Return the keys of `jax.random.split` as a list; one program serves up to 16 keys.

    The first keys do not depend on `count`. Taking keys from an array of keys would compile a
    program for each.
    """
    split = jax.random.split(key, max(count, MOST))
    rows, kind = np.asarray(jax.random.key_data(split)), jax.random.key_impl(key)
    return [jax.random.wrap_key_data(jax.device_put(row), impl=kind) for row in rows[:count]]


def generator(key: Key[Any, ""]) -> np.random.Generator:
    """Return NumPy's random generator, seeded by a JAX key."""
    return np.random.default_rng(words_of(key))
