"""Chains that are stopped and gone on with reach the very draws of chains that were not."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from shelf import Shelf, Stopped

from jbw.inference.samplers import chunked_run as growing
from jbw.inference.samplers.sampling import sample
from jbw.inference.space.box import box

BOX = box({"a": (-4.0, 6.0), "b": (0.0, 9.0)})
COVARIANCE = np.array([[0.3, 0.1], [0.1, 0.4]])


def banana(theta, data):
    return -0.5 * jnp.stack([(theta["a"] - data[0]) ** 2, (theta["b"] - theta["a"] ** 2) ** 2])


def draws(sampler, chain_method="sequential", kept=None, data=(1.0, 2.0), **options):
    tree = sample(
        jax.random.key(3), banana, BOX, jnp.asarray(data), sampler=sampler, num_chains=2,
        num_warmup=40, num_samples=60, chain_method=chain_method, start={"a": 1.0, "b": 2.0},
        covariance=COVARIANCE, kept=kept, **options,
    )  # fmt: skip
    groups = [g for g in tree.children if g != "timing"]
    return {f"{g}/{n}": v.values for g in groups for n, v in tree[g].data_vars.items()}


@pytest.mark.fault(40)
@pytest.mark.parametrize(
    ("sampler", "method"),
    [
        pytest.param("nuts", "vectorized", marks=pytest.mark.release),
        ("elliptical_slice", "sequential"),
        ("random_walk", "vectorized"),
    ],
)
def test_stopped_chains_go_on_bit_for_bit(sampler, method, monkeypatch):
    whole = draws(sampler, method)
    monkeypatch.setattr(growing, "CHUNK_S", 1e9)  # chunks of 1, 4, 16 and 64 steps
    shelf = Shelf()
    for stops in (1, 3, 3):  # after 1 and 22 steps of warm-up, and after 3 draws
        shelf.stops = stops
        with pytest.raises(Stopped):
            draws(sampler, method, shelf)
        shelf.saved = 0
    assert not shelf.last
    shelf.stops = 0
    resumed = draws(sampler, method, shelf)
    assert shelf.last
    assert set(resumed) == set(whole)
    for name, values in whole.items():
        np.testing.assert_array_equal(resumed[name], values, err_msg=name)
    # Complete chains are not drawn again: the model is not even looked at.
    shelf.saved = 0
    again = draws(sampler, method, shelf)
    np.testing.assert_array_equal(again["posterior/a"], whole["posterior/a"])
    assert shelf.saved == 0


def test_keeping_chains_compiles_nothing_more():
    count = 0

    def counted(theta, data):
        nonlocal count
        count += 1
        return banana(theta, data)

    def run(kept):
        sample(
            jax.random.key(3), counted, BOX, jnp.asarray((1.0, 2.0)), sampler="random_walk",
            num_chains=2, num_warmup=300, num_samples=300, chain_method="vectorized", kept=kept,
        )  # fmt: skip

    run(None)
    traced = count
    run(Shelf())
    assert traced > 0
    assert count == traced


def test_chains_of_another_posterior_start_again_and_say_so():
    shelf = Shelf()
    draws("random_walk", "vectorized", shelf)
    with pytest.warns(UserWarning, match="another posterior"):
        other = draws("random_walk", "vectorized", shelf, data=(1.5, 2.0))
    np.testing.assert_array_equal(
        other["posterior/a"], draws("random_walk", "vectorized", data=(1.5, 2.0))["posterior/a"]
    )


def test_a_chunk_lasts_as_long_as_it_may_and_grows_step_by_step():
    assert growing._next_count(1, 30.0, 30.0) == 1  # compiling counts too
    assert growing._next_count(1, 0.01, 0.01) == growing.GROWTH
    assert growing._next_count(64, 1e-3, 1.0) == growing.CHUNK
    assert growing._next_count(100, 20.0, 100.0) == 50
    assert growing._next_count(10, 20.0, 400.0) == 10  # a twentieth of the time spent
    assert growing._next_count(10, 20.0, 1e5) == 30  # at most a minute


def until(count, budget_s=1e9):
    """Enough from so many draws a chain on."""
    return growing.Until(lambda theta: theta["a"].shape[1] >= count, budget_s)


@pytest.mark.fault(40)
def test_chains_double_until_they_are_enough_and_go_on_bit_for_bit(monkeypatch):
    first = draws("elliptical_slice")
    whole = draws("elliptical_slice", until=until(200))
    assert whole["posterior/a"].shape == (2, 240)  # 60, twice that, and twice that
    for name, values in first.items():
        if name.startswith("posterior/"):
            np.testing.assert_array_equal(whole[name][:, :60], values)
    monkeypatch.setattr(growing, "CHUNK_S", 1e9)
    shelf = Shelf()
    for stops in (5, 2):  # in the first doubling, and in the second
        shelf.stops = stops
        with pytest.raises(Stopped):
            draws("elliptical_slice", kept=shelf, until=until(200))
        shelf.saved = 0
    shelf.stops = 0
    resumed = draws("elliptical_slice", kept=shelf, until=until(200))
    for name, values in whole.items():
        np.testing.assert_array_equal(resumed[name], values, err_msg=name)
    shelf.saved = 0
    draws("elliptical_slice", kept=shelf, until=until(200))
    assert shelf.saved == 0


def test_a_spent_budget_ends_chains_that_are_not_enough():
    shelf = Shelf()
    spent = until(10_000, budget_s=0.0)
    found = draws("elliptical_slice", kept=shelf, until=spent)
    assert 1 <= found["posterior/a"].shape[1] <= 60
    shelf.saved = 0
    again = draws("elliptical_slice", kept=shelf, until=spent)
    assert shelf.saved == 0
    np.testing.assert_array_equal(again["posterior/a"], found["posterior/a"])
