"""Records solved before, by the program that all share, against their own loop."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from compiling import Compiled
from tiers import represented_by

from jbw.inference.lanes import at_points
from jbw.measurement.records import Record, Test
from jbw.observables import records
from jbw.observables.dataset import (
    Dataset,
    as_arrays,
    best_offsets,
    halved,
    log_likelihood,
    solved,
    stacked,
    with_directions,
)
from jbw.observables.groups import changed
from jbw.observables.records import Records, compile_beside
from jbw.observables.residual_terms import UPPER
from jbw.observables.samples import band_limited, response_to

FS = 256.0
TRUTH = {
    "omega_n": 118.0, "zeta": 0.01, "alpha": 500.0, "delta": 300.0, "gamma": 30.0, "gain": 15.0,
}  # fmt: skip
OWN = {"one": np.array([0.2, 1e-4]), "two": np.array([-0.1, -2e-4])}


def sweep(name, level, **options):
    rng, t = np.random.default_rng(len(name)), np.arange(512) / FS
    u = level * np.sin(2 * np.pi * 18 * t) * np.sin(np.pi * t / 2) ** 2
    theta = {key: jnp.asarray(value) for key, value in TRUTH.items()}
    clean = np.asarray(response_to(theta, band_limited(u), FS))
    noisy = ({"input": u, "velocity": clean + 1e-3 * rng.normal(size=512)} for _ in range(3))
    repeats = tuple(Record(FS, one, {"input": "V", "velocity": "m/s"}) for one in noisy)
    return Test("sweep", repeats, name, level, **options)


def dataset_of(**options):
    return Dataset.of(Records.reduce([sweep("one", 0.1, **options), sweep("two", 0.3, **options)]))


def with_offsets(data):
    data = with_directions(TRUTH, data, OWN)
    scatters = jnp.asarray([[1e-2, 1e-4], [2e-1, 2e-3]])
    return replace(data, scatters=scatters, scatter=jnp.asarray([1e-1, 1e-3]))


def points(count=5):
    rng = np.random.default_rng(count)
    return {name: x * (1 + 1e-3 * rng.standard_normal(count)) for name, x in TRUTH.items()}


def both_by_their_own_loop(theta, data):
    """Both functions by one program, of whose loops one is left."""
    return log_likelihood(theta, data), stacked(theta, data)


@pytest.mark.parametrize("options", represented_by({"band_hz": (10.0, 30.0), "settle": 0.25}, {}))
def test_points_come_out_as_by_their_own_loop(options):
    for data in (dataset_of(**options), with_offsets(dataset_of(**options))):
        both = at_points(both_by_their_own_loop, points(), data)
        for function, expected in zip((log_likelihood, stacked), both, strict=True):
            found = at_points(function, points(), data)
            # Residuals are differences of a thousandth of what they are made of, by other programs.
            size = np.abs(expected).max()
            np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-11 * size)


def alone_at(i, solved_part):
    """The part with its solution at one of several points."""
    solution = jax.tree.map(lambda leaf: leaf[i], solved_part.solution)
    return replace(solved_part, solution=solution)


@pytest.mark.parametrize("places", [dataset_of, lambda **of: with_offsets(dataset_of(**of))])
def test_rows_are_summed_by_products_as_over_the_responses(places):
    """What single records are asked for: rows of their own, at offsets of their runs."""
    (part,), theta, rng = places(settle=0.25).parts, points(3), np.random.default_rng(0)
    rows = rng.standard_normal((2, 4, part.groups.width))
    offset = jnp.asarray([[0.02, 1e-5], [-0.05, -2e-5]])
    written = part.solved(theta, 1, writes=True)
    summed = part.solved(theta, 1, writes=False, rows=rows)
    assert summed.solution.response is None
    for i in range(3):
        point = {name: jnp.asarray(values[i]) for name, values in theta.items()}
        expected, found = (
            alone_at(i, solved_part).residual_sums(point, rows, offset)
            for solved_part in (written, summed)
        )
        # Sums of 448 products of each row with responses, ten times the residual.
        size = np.linalg.norm(rows) * np.linalg.norm(part.mean)
        np.testing.assert_allclose(found[0], expected[0], rtol=1e-10)
        np.testing.assert_allclose(found[1], expected[1], rtol=0, atol=1e-13 * size)


def test_half_the_step_and_other_levels_need_no_other_program():
    data = dataset_of()
    at_points(log_likelihood, points(), data)
    finer = halved(data)
    with Compiled() as compiled:
        found = at_points(log_likelihood, points(), finer)
        at_points(stacked, points(), Dataset.of(Records.reduce([sweep("three", 0.2)])))
    assert "jit(_marched)" not in compiled
    expected = at_points(lambda *of: log_likelihood(*of), points(), finer)  # by its own loop
    np.testing.assert_allclose(found, expected, rtol=1e-10)
    assert not np.array_equal(found, at_points(log_likelihood, points(), data))


def test_slopes_by_differences_are_the_derivatives():
    (part,) = dataset_of().parts
    theta = as_arrays(TRUTH, dataset_of())
    origin = np.array([[118.2, 0.0101], [117.9, 0.0098]])
    placed = replace(part, groups=changed(part.groups, origin=origin))
    found = np.asarray(placed.slope_by_differences(theta))
    exact = np.asarray(records._slope_at_origin(theta, placed))
    # What the docstring says, with a margin of ten.
    error = np.linalg.norm(found - exact, axis=1) / np.linalg.norm(exact, axis=1)
    assert error.max() < 1e-7


def test_best_offsets_are_read_at_the_point():
    data = with_offsets(dataset_of())
    found = best_offsets(TRUTH, data)
    point = {name: np.array([value]) for name, value in TRUTH.items()}
    _, again = at_points(both_by_their_own_loop, point, data)
    scaled = again[0, -4:].reshape(2, 2)  # the rows of the offsets stand last
    for run, row in zip(("one", "two"), scaled, strict=True):
        np.testing.assert_allclose(found[run], row * np.asarray(data.scatter), rtol=1e-8)


MODE = {"omega_2": 300.0, "zeta_2": 0.02, "gain_ratio_2": -0.7}
AT_JOINT = {"shape_2": 1.4, "sign_2": -1.0, "coupling_2": 1.7}
OWN_LAW = {"alpha_mode_2": 900.0, "delta_mode_2": 500.0, "gamma_mode_2": 30.0}


@pytest.mark.parametrize("further", [{UPPER: 1e-6}, MODE, MODE | AT_JOINT, MODE | OWN_LAW])
def test_residual_terms_and_further_modes_come_out_as_by_their_own_loop(further):
    data = dataset_of(residuals="upper")
    theta = points() | {name: np.full(5, value) for name, value in further.items()}
    assert solved(theta, data, 1, writes=False) is not None
    expected, _ = at_points(both_by_their_own_loop, theta, data)
    np.testing.assert_allclose(at_points(log_likelihood, theta, data), expected, rtol=1e-9)


def test_steady_motion_is_left_to_its_own_loop():
    steady = replace(dataset_of().parts[0].held, periodic=True)
    part = replace(dataset_of().parts[0], held=steady)
    assert part.solved(points(), 1, writes=True) is None


def test_a_program_is_compiled_beside_what_comes_first():
    laws, tests = ("bouc_wen", "quintic"), [sweep("one", 0.1)]
    thread = compile_beside(tests, laws)
    thread.join()
    (part,) = Records.reduce(tests, laws=laws)
    with Compiled() as compiled:
        assert part.solved({**points(), "quintic": np.full(5, 1e8)}, 1, writes=False) is not None
    assert "jit(_marched)" not in compiled
    assert compile_beside([], laws) is None
