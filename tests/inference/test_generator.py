"""Keys taken apart, and numbers of a key."""

import jax
import numpy as np
import pytest

from jbw.inference.generator import MOST, generator, parts_of


@pytest.mark.parametrize("count", [2, 5, MOST, MOST + 3])
def test_parts_of_a_key_are_those_of_jax(count):
    """However many a program splits it into: the draws of a seed stay what they were."""
    key = jax.random.key(7)
    parts = parts_of(key, count)
    found = np.stack([jax.random.key_data(part) for part in parts])
    np.testing.assert_array_equal(found, jax.random.key_data(jax.random.split(key, count)))
    assert [generator(part).random() for part in parts[:2]] == [
        generator(part).random() for part in jax.random.split(key, count)[:2]
    ]
