"""Zeta scatters between levels of one assembly as repeats of a level do, else not at all."""

from types import SimpleNamespace

import numpy as np
import pytest
from parts import part_of

from jbw.identification.run_effects import (
    NO_SCATTER,
    Shifts,
    are_levels,
    damping_scatter,
    scatter_of_repeats,
    sentence_of,
)

ERROR = 1e-5  # of every run's zeta


def shifts_of(zeta):
    """Runs with these offsets of zeta, all known alike."""
    names = tuple(f"run {i}" for i in range(len(zeta)))
    offset = np.stack([np.zeros(len(zeta)), zeta], axis=1)
    return Shifts(names, offset, np.tile([0.01, ERROR], (len(zeta), 1)), 1e-9)


def data_of(sizes, runs=None):
    """What is asked of a dataset: labels, runs and sizes of one part."""
    return SimpleNamespace(parts=(part_of(sizes, runs),), laws=("bouc_wen",))


def sizes_of_runs(sizes):
    return {f"run {i}": size for i, size in enumerate(sizes)}


def test_scatter_of_repeats_of_equal_errors_is_that_of_pairs():
    """Of pairs that differ by d, tau^2 = mean(d^2) / 2 - sigma^2, however far levels are apart."""
    apart = np.array([3e-4, -2e-4, 1e-4])
    zeta = np.concatenate(
        [[base, base + d] for base, d in zip((0.0, 9e-3, -4e-3), apart, strict=True)]
    )
    sizes = sizes_of_runs([1.0, 1.05, 2.0, 2.1, 4.0, 4.2])
    expected = np.sqrt(np.mean(apart**2) / 2 - ERROR**2)
    assert scatter_of_repeats(shifts_of(zeta), sizes) == pytest.approx(expected, rel=1e-12)


def test_repeats_that_agree_leave_one_damping_ratio():
    """By chance pairs differ by 1.4 errors, whatever the levels ask for."""
    zeta = np.array([0.0, 1.4, 900.0, 901.4]) * ERROR
    assert scatter_of_repeats(shifts_of(zeta), sizes_of_runs([1.0, 1.0, 2.0, 2.0])) == 0.0


def test_levels_without_repeats_are_no_repeats_of_each_other():
    shifts = shifts_of(np.array([0.0, 1e-3, 2e-3]))
    assert scatter_of_repeats(shifts, sizes_of_runs([1.0, 1.2, 1.5])) is None
    fit = SimpleNamespace(theta={"omega_n": 500.0, "zeta": 2e-3})
    scatter = damping_scatter(fit, shifts, data_of(sizes_of_runs([1.0, 1.2, 1.5])))
    assert scatter == NO_SCATTER
    assert "all levels share zeta" in sentence_of(shifts, scatter)


def test_repeats_that_scatter_tell_by_how_much_levels_may():
    shifts = shifts_of(np.array([0.0, 3e-4, 1e-3, 1.3e-3]))
    fit = SimpleNamespace(theta={"omega_n": 500.0, "zeta": 2e-3})
    scatter = damping_scatter(fit, shifts, data_of(sizes_of_runs([1.0, 1.0, 2.0, 2.0])))
    assert scatter == pytest.approx(np.sqrt(4.5e-8 - ERROR**2) / 2e-3, rel=1e-12)
    assert "by 10.6 % of its value" in sentence_of(shifts, scatter)


def test_stated_runs_and_assemblies_scatter_as_they_do():
    """Their damping ratios differ by what was done between them, and not by the level alone."""
    sizes = sizes_of_runs([1.0, 1.2, 1.5])
    data = data_of(sizes, runs=("monday", "monday", "friday"))
    assert not are_levels(data)
    fit = SimpleNamespace(theta={"omega_n": 500.0, "zeta": 2e-3})
    assert damping_scatter(fit, shifts_of(np.zeros(3)), data) is None


def test_a_label_may_say_more_than_its_run():
    data = data_of(sizes_of_runs([1.0, 2.0]), runs=("run 0", "run"))
    assert are_levels(data)
