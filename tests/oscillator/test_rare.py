"""A rare branch stays a branch in lanes, and its values are those of NumPy."""

import jax
import jax.numpy as jnp
import numpy as np

from jbw.oscillator.rare import where_rare


def clipped_root(x):
    """The root where x > 1, else x; as a dictionary of a scalar and of an array a lane."""
    usual = {"value": x, "pair": jnp.stack([x, -x])}

    def rare(at):
        root = jnp.sqrt(at)
        return {"value": root, "pair": jnp.stack([root, -root])}

    return where_rare(x > 1.0, rare, x, usual)


def values_of(x):
    return np.where(x > 1.0, np.sqrt(np.maximum(x, 0.0)), x)


def test_values_without_lanes_and_with_lanes_within_lanes():
    x = np.random.default_rng(0).uniform(0.0, 2.0, (3, 4, 5))
    whole = jax.vmap(jax.vmap(jax.vmap(clipped_root)))(x)
    np.testing.assert_array_equal(whole["value"], values_of(x))
    np.testing.assert_array_equal(whole["pair"], np.stack([values_of(x), -values_of(x)], -1))
    assert clipped_root(jnp.asarray(1.44))["value"] == 1.2


def test_operands_that_all_lanes_share():
    factor = jnp.asarray(3.0)

    def scaled(x):
        return where_rare(x > 1.0, lambda at: at[0] * at[1], (factor, x), x)

    x = np.array([0.5, 2.0])
    np.testing.assert_array_equal(jax.vmap(scaled)(x), [0.5, 6.0])


def test_lanes_keep_the_condition():
    """`lax.cond` alone would become a selection, which works out both sides in every step."""
    x = jnp.ones((2, 3))
    program = str(jax.make_jaxpr(jax.vmap(jax.vmap(clipped_root)))(x))
    assert "cond[" in program
    outside = program.split("cond[")[0]
    assert "sqrt" not in outside
    assert "select_n" not in outside


def test_a_lane_that_is_not_a_number_is_alone():
    x = jnp.array([jnp.nan, 4.0, 0.5])
    np.testing.assert_array_equal(jax.vmap(clipped_root)(x)["value"], [np.nan, 2.0, 0.5])
