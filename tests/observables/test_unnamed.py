"""What is compiled for a campaign serves another of the same shapes, whatever its names."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from compiling import Compiled
from decays import decay_test

from jbw.inference.lanes import at_points
from jbw.inference.samplers import amis
from jbw.inference.space.box import box
from jbw.inference.space.problem import problem_of
from jbw.inference.space.reparametrisation import in_box
from jbw.measurement.records import Record, Test
from jbw.observables.dataset import Dataset, best_offsets, log_likelihood, stacked, unnamed
from jbw.observables.decay import Decays, matched
from jbw.observables.line_fit import LineReading
from jbw.observables.loops import Loops
from jbw.observables.observable import assemblies_of, numbers_of
from jbw.oscillator.laws.bouc_wen import BoucWenLaw

THETA = {"omega_n": 118.0, "zeta": 0.01, "alpha": 3000.0, "delta": 400.0, "gamma": 150.0}
GAIN = {"gain": 15.0}


def dataset_of(specimen, seed):
    """Two force loops of two runs and a line fit, of a specimen with a name."""
    rng, y = np.random.default_rng(seed), 1e-3 * np.sin(2 * np.pi * np.arange(120) / 60)
    tests = []
    for day in (1, 2):
        force = 3e3 * y + 0.1 * rng.standard_normal(y.size)
        units = {"displacement": "m", "restoring_force": "N"}
        record = Record(256.0, {"displacement": y, "restoring_force": force}, units)
        test = Test("loop", (record,), f"{specimen} loop {day}", 1e-3, run=f"day {day}")
        tests.append(replace(test, assembly=specimen))
    mean = np.array([118.0, 0.01, 15.0])
    reading = LineReading.of(mean, np.diag((1e-3 * mean) ** 2), 2e-5, f"{specimen} / day 1")
    return Dataset.of([*Loops.reduce(tests), reading], GAIN)


def points(seed):
    factors = 1 + 0.01 * np.random.default_rng(seed).standard_normal(5)
    return {name: value * factors for name, value in THETA.items()}


@pytest.mark.slow
def test_another_specimen_compiles_nothing():
    first, second = dataset_of("alder", 1), dataset_of("birch", 2)
    assert set(first.labels).isdisjoint(second.labels)
    bounds = box({name: (0.5 * value, 2 * value) for name, value in THETA.items()})
    place = in_box(bounds, None, None, 1)
    for data in (first, second):
        with Compiled() as programs:
            terms = at_points(log_likelihood, points(3), data)
            rows = at_points(stacked, points(3), data)
            problem = problem_of(log_likelihood, bounds, data, place)
            amis.look(jax.random.key(0), problem, 64)
        assert bool(programs) is (data is first)
    # By the program of the first; the second's own, of its names, says the same.
    own = [jax.vmap(lambda t, f=f: f(t, second))(points(3)) for f in (log_likelihood, stacked)]
    np.testing.assert_allclose(terms, own[0], rtol=1e-12)
    np.testing.assert_allclose(rows, own[1], rtol=1e-9, atol=1e-12 * np.abs(own[1]).max())


@pytest.mark.slow
def test_offsets_of_runs_have_their_names():
    found = []
    for specimen in ("alder", "birch"):
        data = dataset_of(specimen, 4)
        data = replace(data, scatters=np.full((1, 2), 0.1), scatter=np.array([0.1, 1e-4]))
        parts = [part.linearised(THETA | GAIN, {}) for part in data.parts]
        found.append(best_offsets(THETA, replace(data, parts=tuple(parts))))
    assert list(found[1]) == ["birch / day 1", "birch / day 2"]
    for day in (1, 2):
        first, second = found[0][f"alder / day {day}"], found[1][f"birch / day {day}"]
        np.testing.assert_array_equal(first, second)
    assert found[1]["birch / day 1"].any()


@pytest.mark.slow
def test_decays_of_other_names_and_bands_share_a_program():
    (part,) = Decays.reduce([decay_test()])
    (other,) = Decays.reduce([replace(decay_test(), name="second specimen")])
    other = replace(other, centre_hz=other.centre_hz + 0.1)
    theta = {name: np.asarray(value) for name, value in THETA.items()}
    first = matched(theta, part)
    with Compiled() as programs:
        second = matched(theta, other)
    assert not programs
    np.testing.assert_array_equal(first.misfit, second.misfit)


@pytest.mark.parametrize(
    "runs",
    [
        ("a / 1", "a / 2", "b / 1"), ("a", "b", "a"), ("a", "a / 1", "b"), ("1", "2", "3"),
        ("b / x", "a / x", "b / y", "a / x"),
    ],
)  # fmt: skip
def test_numbers_tell_runs_and_assemblies_apart_as_names_do(runs):
    labels, by_run = numbers_of(("x", "y", "x"), runs)
    assert labels == {"x": "#0", "y": "#1"}
    numbered = tuple(by_run[run] for run in runs)
    assert assemblies_of(numbered) == assemblies_of(runs)
    assert [numbered.index(run) for run in numbered] == [runs.index(run) for run in runs]


def test_all_that_is_told_by_name_is_numbered():
    data = dataset_of("cedar", 5)
    assert "cedar" not in str(jax.tree.structure(unnamed(data)))
    assert unnamed(data).levels == data.levels
    assert BoucWenLaw.name in str(jax.tree.structure(unnamed(data)))
