"""Offsets of runs that go with their motion, against SciPy's regression and against chance."""

from types import SimpleNamespace

import numpy as np
import pytest
from parts import part_of
from pasted import pasted
from scipy import stats

from jbw.identification.run_effects import Shifts, sizes_of, slope_of, trend_finding

LEVELS = np.arange(1.0, 13.0)
HZ = 2 * np.pi


def data_of(sizes, laws=("bouc_wen",)):
    """What is asked of a dataset: labels, runs and sizes of one part."""
    return SimpleNamespace(parts=(part_of(sizes),), laws=laws)


def shifts_of(hertz, noise=0.01, zeta=None):
    """Twelve runs with these offsets of the frequency [Hz], each known to 0.02 Hz."""
    rng = np.random.default_rng(2)
    omega = HZ * (np.asarray(hertz) + noise * rng.standard_normal(12))
    zeta = 1e-5 * rng.standard_normal(12) if zeta is None else zeta
    names = tuple(f"level {level:g}" for level in LEVELS)
    std = np.tile([0.02 * HZ, 1e-5], (12, 1))
    data = data_of(dict(zip(names, 0.3 * LEVELS, strict=True)))
    return trend_finding(Shifts(names, np.stack([omega, zeta], axis=1), std, 1e-9), data)


def test_of_equal_errors_the_slope_is_scipys():
    rng = np.random.default_rng(0)
    y = 0.1 * LEVELS + rng.standard_normal(12)
    (value, std, p), known = slope_of(LEVELS, y, np.full(12, 0.3)), stats.linregress(LEVELS, y)
    # Round-off of sums of twelve.
    assert value == pytest.approx(known.slope, rel=1e-10)
    assert std == pytest.approx(known.stderr, rel=1e-10)
    assert p == pytest.approx(known.pvalue, rel=1e-9)


def test_by_chance_a_slope_is_as_rare_as_it_says():
    """Twelve runs known unequally well that scatter besides: p is uniform, but for the weights."""
    rng = np.random.default_rng(1)
    std = np.linspace(0.2, 1.0, 12)
    p = [
        slope_of(LEVELS, rng.normal(0, 0.5, 12) + std * rng.standard_normal(12), std)[-1]
        for _ in range(2000)
    ]
    # Two thousand times: 0.5 % of them are 10 +- 3.2, 5 % are 100 +- 9.7.
    assert sum(each < 0.005 for each in p) < 10 + 4 * 3.2
    assert abs(sum(each < 0.05 for each in p) - 100) < 4 * 9.7
    assert stats.kstest(p, "uniform").pvalue > 1e-3


def test_a_frequency_that_rises_with_level_is_the_laws_failure():
    """Twelve levels, +0.05 to +0.39 Hz, which were called run to run."""
    found = shifts_of(np.linspace(0.05, 0.39, 12))
    assert found is not None
    assert (found.code, found.status) == ("level_trend", "failed")
    # 0.34 Hz; twelve of 0.01 Hz know the change from end to end to 0.01.
    assert (found.values["quantity"], found.values["count"]) == ("natural frequency", 12)
    assert found.values["change"] == pytest.approx(0.34, abs=0.03)
    assert pasted(found.action).laws == ("bouc_wen", "cubic")


def test_a_damping_that_goes_with_level_is_told_too():
    found = shifts_of(np.zeros(12), zeta=1e-3 * LEVELS)
    assert found is not None
    assert found.status == "failed"
    assert found.values["quantity"] == "damping ratio"
    assert round(found.values["change"], 1) == 1.1  # 1e-3 (12 - 1), in per cent


def test_days_that_scatter_are_no_trend():
    days = np.random.default_rng(3).permutation(np.linspace(0.05, 0.39, 12))
    found = shifts_of(days)
    assert found is not None
    assert (found.status, found.action) == ("ok", "")
    assert found.number > 0.005


def test_few_runs_and_equal_ones_tell_no_trend():
    names = tuple("abcde")
    std = np.ones((5, 2))
    shifts = Shifts(names, np.arange(10.0).reshape(5, 2), std, 1e-9)
    assert trend_finding(shifts, data_of(dict.fromkeys(names, 1.0))) is None
    few = Shifts(names[:4], shifts.offset[:4], std[:4], 1e-9)
    assert trend_finding(few, data_of(dict(zip(names, range(5), strict=True)))) is None
    assert sizes_of(data_of({})) == {}
