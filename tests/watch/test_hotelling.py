"""Hotelling's test: golden thresholds, exact rates by simulation, power by non-central F."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import f as fisher

import jbw
from jbw.watch.detection import (
    distance,
    excess_noise,
    power,
    reference_of,
    tail,
    threshold,
)

GOLDEN = json.loads((Path(__file__).parents[1] / "golden_watch.json").read_text())["monitoring"]
NUM = 100_000  # sequences simulated
# Of the bolted double beam at 0.3 m/s, nine impacts with nothing changed: frequency [Hz] and
# logarithm of the damping.
SCATTER = np.array([4.6e-3, 0.007])


def simulated(num_reference, p, seed):
    """References and one further reading of many joints, correlated and not of mean zero."""
    rng = np.random.default_rng(seed)
    mix = np.eye(p) + 0.6 * np.tri(p, k=-1)
    readings = rng.standard_normal((NUM, num_reference + 1, p)) @ mix.T + 3.0
    return readings[:, :-1], readings[:, -1]


@pytest.mark.parametrize("num", GOLDEN["hotelling"]["thresholds"])
def test_thresholds_are_golden(num):
    golden = GOLDEN["hotelling"]
    limit = threshold(golden["alpha"], golden["p"], int(num))
    assert limit == pytest.approx(golden["thresholds"][num], rel=1e-10)


@pytest.mark.parametrize(("num", "p"), [(6, 2), (8, 4), (20, 2), (20, 4)])
def test_an_unchanged_joint_alarms_as_often_as_stated(num, p):
    references, watched = simulated(num, p, seed=num + p)
    squared = distance(watched, reference_of(references))
    rate = np.mean(squared > threshold(0.01, p, num))
    # 1,000 alarms expected: their Monte Carlo sd is 3 %.
    assert rate == pytest.approx(0.01, rel=0.2)


def test_an_unchanged_joint_has_evenly_spread_tails():
    references, watched = simulated(12, 3, seed=1)
    tails = np.sort(tail(distance(watched, reference_of(references)), 3, 12))
    # Kolmogorov's bound at 1e-4: sqrt(log(2e4) / 2 / 1e5) is 0.007.
    assert np.max(np.abs(tails - (np.arange(NUM) + 0.5) / NUM)) < 0.007


@pytest.mark.parametrize("num", [8, 20])
def test_power_is_that_of_simulated_changes(num):
    references, watched = simulated(num, 2, seed=num)
    mix = np.array([[1.0, 0.0], [0.6, 1.0]])
    squared = distance(watched + mix @ [2.0, 1.0], reference_of(references))
    alarm_rate = np.mean(squared > threshold(0.01, 2, num))
    # A share of 1e5 has an sd of 0.0016 at most.
    assert alarm_rate == pytest.approx(power(0.01, 2, num, np.sqrt(5.0)), abs=0.006)


def test_five_per_cent_more_damping_is_found_from_twenty_references():
    rng = np.random.default_rng(3)
    base = np.array([122.0, np.log(0.012)])
    references = base + SCATTER * rng.standard_normal((NUM, 20, 2))
    loose = base + [0.0, np.log(1.05)] + SCATTER * rng.standard_normal((NUM, 2))
    squared = distance(loose, reference_of(references))
    alarm_rate = np.mean(squared > threshold(1e-3, 2, 20))
    assert alarm_rate > 0.95
    assert alarm_rate == pytest.approx(power(1e-3, 2, 20, np.log(1.05) / SCATTER[1]), abs=0.005)


# 5 % more damping and 50 mHz less frequency, in standard deviations of whole-record readings of the
# bolted double beam at two amplitudes; at a = 1e-3 all else follows.
MORE_DAMPING, LESS_FREQUENCY = 8.41, 13.69


@pytest.mark.parametrize(
    ("change", "of_eight", "of_twenty"),
    [
        (MORE_DAMPING, 0.13, 0.98),
        (MORE_DAMPING * np.log(1.10) / np.log(1.05), 0.66, 1.0),
        (LESS_FREQUENCY, 0.47, 1.0),
    ],
)
def test_power_is_that_of_the_specifications_table(change, of_eight, of_twenty):
    # Two digits, as they stand there.
    assert power(1e-3, 4, 8, change) == pytest.approx(of_eight, abs=0.005)
    assert power(1e-3, 4, 20, change) == pytest.approx(of_twenty, abs=0.005)


def test_a_reading_at_the_references_mean_has_no_distance():
    references = np.random.default_rng(4).standard_normal((9, 2))
    reference = reference_of(references)
    assert distance(references.mean(axis=0), reference) == pytest.approx(0.0, abs=1e-12)
    # The mean squared distance of the references themselves is p (n - 1) / n, whatever they are.
    distances = distance(references, reference)
    assert distances.mean() == pytest.approx(2 * 8 / 9, rel=1e-12)
    assert tail(np.array(0.0), 2, 9) == 1.0
    assert tail(np.array(threshold(0.3, 2, 9)), 2, 9) == pytest.approx(0.3, rel=1e-12)


def test_noise_beyond_the_references_alone_widens():
    usual = np.diag([1.0, 4.0])
    assert np.allclose(excess_noise(0.5 * usual, usual), 0.0, atol=1e-15)
    assert np.allclose(excess_noise(np.diag([3.0, 1.0]), usual), np.diag([2.0, 0.0]))
    reference = reference_of(np.random.default_rng(5).standard_normal((9, 2)))
    x = np.array([4.0, 4.0])
    assert distance(x, reference, np.eye(2)) < distance(x, reference)


def test_as_many_references_as_values_are_refused():
    with pytest.raises(jbw.ConfigError, match="at least 5 records, but has 4"):
        reference_of(np.zeros((4, 4)))


def test_many_references_leave_the_chi_square():
    # 1e6 references: F's quantile is the chi-square's over p to 1e-5.
    assert threshold(1e-3, 4, 10**6) == pytest.approx(4 * fisher.isf(1e-3, 4, 1e9), rel=1e-4)
