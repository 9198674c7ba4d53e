"""A function at many points, in lanes on all cores, against the same one point at a time."""

from concurrent.futures import CancelledError
from threading import Event, Timer

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jbw.inference import lanes
from jbw.inference.lanes import LANES, at_points, in_background, side_by_side


def wavy(theta, data):
    return jnp.stack([jnp.sin(theta["a"]) * data, theta["b"] ** 2, theta["a"] / theta["b"]])


def product(theta, data):
    return theta["a"] * theta["b"]


def points(count):
    rng = np.random.default_rng(count)
    return {"b": rng.uniform(1, 2, count), "a": rng.normal(size=count)}


@pytest.mark.parametrize("count", [1, 31, 32, 33, 100])
def test_any_number_of_points_comes_out_as_one_by_one(count):
    theta = points(count)
    found = at_points(wavy, theta, jnp.asarray(3.0))
    assert found.shape == (count, 3)
    a, b = theta["a"], theta["b"]
    # In NumPy; another library's sine differs by its last digit.
    np.testing.assert_allclose(found, np.stack([3 * np.sin(a), b**2, a / b], 1), rtol=1e-14)
    each = [wavy({n: jnp.asarray(v[i]) for n, v in theta.items()}, 3.0) for i in range(count)]
    np.testing.assert_allclose(found, np.stack(each), rtol=1e-14)


def test_scalar_values_make_one_axis_and_lanes_may_be_few():
    theta = points(11)
    for width in (1, 4, 11, 64):
        found = at_points(product, theta, lanes=width)
        assert found.shape == (11,)
        # One product of two numbers: no rounding is left to differ.
        np.testing.assert_array_equal(found, theta["a"] * theta["b"])


def test_the_number_of_cores_changes_no_digit(monkeypatch):
    theta, found = points(7 * LANES + 3), []
    for cores in (1, 2, 5):
        monkeypatch.setattr(lanes, "num_cores", lambda cores=cores: cores)
        found.append(at_points(wavy, theta, jnp.asarray(0.3)))
    np.testing.assert_array_equal(found[1], found[0])
    np.testing.assert_array_equal(found[2], found[0])


def test_it_is_compiled_once_whatever_the_data_and_the_number_of_points():
    traced = 0

    def counted(theta, data):
        nonlocal traced
        traced += 1
        return data * theta["a"]

    for count in (5, 40, 200):
        at_points(counted, points(count), jnp.asarray(float(count)))
    assert traced == 1


def test_what_is_forgotten_is_compiled_again_to_the_same_digits():
    """The programs that were compiled are gone: one that is asked for again is compiled anew."""
    asked, theta = [], points(5)

    def listener(event, seconds, **_):
        asked.append(event) if event.endswith("backend_compile_duration") else None

    first = at_points(wavy, theta, jnp.asarray(0.3))
    jax.monitoring.register_event_duration_secs_listener(listener)
    try:
        at_points(wavy, theta, jnp.asarray(0.3))
        assert not asked
        lanes.forget()
        np.testing.assert_array_equal(at_points(wavy, theta, jnp.asarray(0.3)), first)
        assert asked
    finally:
        jax.monitoring.unregister_event_duration_listener(listener)


def test_one_point_that_cannot_be_solved_spoils_no_other():
    theta = points(40)
    theta["b"][17] = np.nan
    found = at_points(wavy, theta, jnp.asarray(1.0))
    assert np.array_equal(np.isnan(found).any(axis=1), np.arange(40) == 17)


def test_an_error_in_the_function_is_raised():
    def wrong(theta, data):
        return jax.numpy.ones(3) @ jax.numpy.ones(4) * theta["a"]

    with pytest.raises(TypeError):
        at_points(wrong, points(40))


def halvings(start, evaluate):
    """Bisection of the square root of a start: so many evaluations, each of its own points."""
    low, high = 0.0, max(start, 1.0)
    while high - low > 1e-12 * high:
        middle = (low + high) / 2
        (value,) = evaluate(np.array([[middle]]))[0]
        low, high = (middle, high) if value < start else (low, middle)
    return middle


def test_searches_side_by_side_end_where_each_does_alone():
    asked, starts = [], [2.0, 9.0, 1e-6, 3.0]

    def squares(points):
        asked.append(len(points))
        return points**2

    alone = [halvings(start, squares) for start in starts]
    calls = len(asked)
    asked.clear()
    together = side_by_side(halvings, starts, squares)
    assert together == alone
    np.testing.assert_allclose(together, np.sqrt(starts), rtol=1e-11)
    # The longest search tells how many calls there are; those that have ended ask for nothing.
    assert sum(asked) == calls
    assert max(asked) == len(starts)
    assert asked[-1] == 1


def failing(start, evaluate):
    if start < 0:
        raise ValueError("no root")
    return halvings(start, evaluate)


@pytest.mark.parametrize("starts", [[4.0, -1.0, 9.0], [-1.0, 4.0, 9.0]])
def test_an_error_of_one_search_ends_all(starts):
    with pytest.raises(ValueError, match="no root"):
        side_by_side(failing, starts, np.square)


def test_an_error_of_the_evaluation_is_that_of_the_search():
    def broken(points):
        raise FloatingPointError("not a number")

    with pytest.raises(FloatingPointError, match="not a number"):
        side_by_side(halvings, [4.0, 9.0], broken)


def test_work_beside_gives_what_it_made_or_its_error():
    theta = points(40)
    with in_background(lambda: at_points(product, theta)) as work:
        here = at_points(product, theta)
    np.testing.assert_array_equal(work.result(), here)
    with in_background(lambda: 1 // 0) as failed:
        pass
    with pytest.raises(ZeroDivisionError):
        failed.result()


def test_work_beside_a_block_that_is_interrupted_is_given_up_at_its_next_lot(monkeypatch):
    evaluated, goes_on, started = [], Event(), Event()

    def values(function, theta, data):
        evaluated.append(len(theta["a"]))
        started.set()
        assert goes_on.wait(60)
        return theta["a"]

    monkeypatch.setattr(lanes, "_values", values)
    monkeypatch.setattr(lanes, "num_cores", lambda: 1)

    def interrupted():
        with in_background(lambda: at_points(product, points(1000))) as work:
            works.append(work)
            assert started.wait(60)
            Timer(0.2, goes_on.set).start()  # once the block has ended
            raise KeyboardInterrupt

    works = []
    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert evaluated == [LANES]
    with pytest.raises(CancelledError):
        works[0].result()
