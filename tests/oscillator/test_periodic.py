"""Steady state of a periodic record: how many periods are solved, and what need not come back."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jbw.oscillator import periodic
from jbw.oscillator.laws.iwan import Iwan4
from jbw.oscillator.oscillator import Oscillator
from jbw.oscillator.periodic import steady_period
from jbw.oscillator.response import simulate

SIZE = 12


def settled(kept, solved, *, one_by_one=False):
    """Steady state of x <- kept x + 1, whose other numbers follow at once; `solved` counts."""

    def period(state):
        jax.debug.callback(lambda _: solved.append(1), state[0])
        after = (kept * state[0] + 1.0, *(0.5 * state[0] for _ in state[1:]))
        return jax.tree.map(lambda a, b: jnp.stack([jnp.asarray(a), b]), state, after)

    start = tuple(jnp.zeros(()) for _ in range(SIZE))
    trajectory, residual = steady_period(period, start, (1.0,) * SIZE, one_by_one=one_by_one)
    return trajectory[0][0], residual


def count_of(function, *args):
    solved = []
    found = jax.block_until_ready(jax.jit(lambda *args: function(*args, solved))(*args))
    jax.effects_barrier()
    return found, len(solved)


def test_a_period_that_forgets_its_start_is_marched():
    # 1e-12 is left of the start after 12 periods; a Newton step of 12 numbers alone takes 13.
    (x, residual), count = count_of(settled, 0.1)
    np.testing.assert_allclose(x, 1 / 0.9, rtol=1e-12)
    assert residual < 1e-11
    assert count < 20


def test_a_period_that_keeps_its_start_is_not_marched():
    # Marched, 1e-12 is left after 2,750 periods.
    (x, _), count = count_of(settled, 0.99)
    np.testing.assert_allclose(x, 100.0, rtol=1e-9)
    assert count < 100


def test_round_off_in_a_place_that_is_not_used_is_no_change():
    # 1e-20 beside a state of 1 all vanishes; a hundred-thousandth beside it that does is a change.
    def residual(beside):
        def period(state):
            after = (0.5 * state[0] + 0.5, 0.0 * state[1])
            return jax.tree.map(lambda a, b: jnp.stack([jnp.asarray(a), b]), state, after)

        def settle(gap, x):
            return jnp.array([1.0, beside])

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(periodic, "_settle", settle)
            return steady_period(period, (jnp.ones(()), jnp.zeros(())), (1.0, 1.0))[1]

    assert residual(1e-20) == 0.0
    assert residual(1e-5) == 1.0


def test_a_period_that_is_not_a_number_is_given_up():
    (_, residual), count = count_of(settled, np.nan)
    assert np.isnan(residual)
    assert count < 5


def test_a_motion_without_a_period_is_given_up():
    # x <- x + 1 comes back nowhere; twenty rounds of a slope, at 13 periods each, show it.
    (_, residual), count = count_of(settled, 1.0)
    assert residual > 0.01
    assert count < 23 * 13


@pytest.mark.parametrize("one_by_one", [True, False])
def test_lanes_agree_and_wait_for_none_where_they_settle_alone(one_by_one):
    kept = np.append(np.zeros(7), 0.5)

    def lanes(kept, solved):
        return jax.vmap(lambda one: settled(one, solved, one_by_one=one_by_one))(kept)

    (x, _), count = count_of(lanes, kept)
    np.testing.assert_allclose(x, 1 / (1 - kept), rtol=1e-11)
    each = sum(count_of(settled, one)[1] for one in kept)
    assert count <= each if one_by_one else count > 2 * each


def test_reversals_that_a_law_gives_up_do_not_keep_a_record_from_its_period():
    # Two tones, whose loops within loops are deeper than four reversals; the guesses count on.
    n = np.arange(1024)
    u = 30.0 * np.sin(2 * np.pi * 13 * n / 1024) + 30.0 * np.sin(2 * np.pi * 117 * n / 1024)
    joint = Oscillator(118.0, 0.05, (Iwan4(4000.0, 1500.0, -0.3, 0.5, depth=4),))

    @jax.jit
    def run(u):
        whole = {"hold": "zero", "substeps": 2}
        steady = simulate(joint, u, 512.0, periodic=True, **whole)
        # From rest, with no search at all: of the start exp(-100) is left in the tenth period.
        return steady, simulate(joint, jnp.tile(u, 10), 512.0, **whole)

    steady, marched = run(u)
    assert steady.guesses > 0
    assert steady.residual < 1e-10
    last = marched.y[9 * 1024 :]
    assert np.linalg.norm(steady.y - last) < 1e-9 * np.linalg.norm(last)  # rounding of ten periods
