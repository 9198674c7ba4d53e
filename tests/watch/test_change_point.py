"""Change points: the golden run lengths, and what is stated of false alarms, by simulation."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import multivariate_t

from jbw.watch.detection import (
    Belief,
    after_change,
    distance,
    known_from,
    log_predictive,
    reference_of,
    run_length,
    tail,
    updated,
)

GOLDEN = json.loads((Path(__file__).parents[1] / "golden_watch.json").read_text())["monitoring"]
BOCPD = GOLDEN["bocpd"]


@pytest.fixture(scope="module")
def golden():
    mean, kappa, a, b = BOCPD["prior_nig"]
    prior = Belief(np.array([mean]), np.array(kappa), np.array(2 * a), np.array([[2 * b]]))
    return run_length(np.array(BOCPD["x"])[:, None], prior, BOCPD["hazard"])


def test_run_lengths_are_golden(golden):
    probability = golden.probability
    assert np.allclose(probability, BOCPD["run_length_posterior_last"], rtol=1e-10, atol=1e-16)
    assert probability[:9].sum() == pytest.approx(BOCPD["prob_run_shorter_than_9"], rel=1e-10)


def test_evidence_is_golden(golden):
    assert golden.log_evidence == pytest.approx(BOCPD["log_evidence"], rel=1e-10)


def test_the_history_ends_with_the_last_run_length(golden):
    assert golden.unchanged[-1] == golden.probability[-1]
    assert len(golden.unchanged) == len(BOCPD["x"])


def references(num=12, p=2, seed=0, batch=()):
    return np.random.default_rng(seed).standard_normal((*batch, num, p))


def test_predictions_from_the_reference_are_hotellings():
    """Student's t of n0 - p degrees of freedom, as SciPy has it."""
    readings = references()
    reference_belief = known_from(reference_of(readings))
    x = np.array([0.7, -1.9])
    scale = np.cov(readings, rowvar=False) * 11 / 10 * 13 / 12
    expected = multivariate_t(readings.mean(axis=0), scale, df=10).logpdf(x)
    batch_of_one = Belief(*(part[None] for part in reference_belief))
    assert log_predictive(x, batch_of_one)[0] == pytest.approx(expected, rel=1e-12)


def test_one_more_reading_is_one_more_reference():
    readings = references(num=7)
    early = known_from(reference_of(readings[:6]))
    batch_of_one = Belief(*(part[None] for part in early))
    posterior, expected = updated(readings[6], batch_of_one), known_from(reference_of(readings))
    assert np.allclose(posterior.mean[0], expected.mean, rtol=1e-12)
    assert np.allclose(posterior.psi[0], expected.psi, rtol=1e-12)
    assert (posterior.kappa[0], posterior.nu[0]) == (expected.kappa, expected.nu)


def test_an_unchanged_joint_alarms_no_oftener_than_stated():
    """Ville: among n readings with probability a / (1 - h)^(n + 1) at most."""
    num, length, false_alarms, hazard = 4000, 30, 0.05, 0.01
    readings = references(20 + length, seed=1, batch=(num,))
    reference = reference_of(readings[:, :20])
    run_lengths = run_length(
        readings[:, 20:], after_change(reference), hazard, start=known_from(reference)
    )
    rate = np.mean(np.min(run_lengths.unchanged, axis=-1) < false_alarms)
    # Four standard errors of a share of 4000 above the bound.
    bound = false_alarms / (1 - hazard) ** (length + 1)
    assert 0.0 < rate < bound + 4 * np.sqrt(bound / num)


@pytest.mark.parametrize(("num", "length"), [(100_000, 1), (2000, 30)])
def test_the_whole_alarm_comes_as_often_as_stated(num, length):
    """A reading by itself or the drift, with twenty references: the rate is that of a record."""
    rate = 0.01
    readings = references(20 + length, seed=length, batch=(num,))
    reference = reference_of(readings[:, :20])
    of_each_series = reference._replace(
        mean=reference.mean[:, None], covariance=reference.covariance[:, None]
    )
    by_reading = tail(distance(readings[:, 20:], of_each_series), 2, 20) < rate
    drift = run_length(
        readings[:, 20:], after_change(reference), rate, start=known_from(reference)
    ).unchanged
    alarms = by_reading | (drift < rate)
    # 1,000 alarms expected of 1e5 first records, 600 of 6e4: a Monte Carlo sd of 3 and 5 %.
    assert np.mean(alarms) == pytest.approx(rate, rel=0.2)
    # And over a whole sequence no oftener than of independent records, to four standard errors.
    ever = 1 - (1 - rate) ** length
    assert np.mean(alarms.any(axis=-1)) < ever + 4 * np.sqrt(ever / num)


def test_a_slow_change_is_found_where_readings_alone_often_miss_it():
    """A drift of 2.5 sd over 50 readings, from 50 references."""
    num, false_alarms = 400, 1e-3
    readings = references(100, seed=2, batch=(num,))
    readings[:, 50:, 1] += np.linspace(0, 2.5, 50)
    reference = reference_of(readings[:, :50])
    run_lengths = run_length(
        readings[:, 50:], after_change(reference), false_alarms, start=known_from(reference)
    )
    slow = np.mean(np.min(run_lengths.unchanged, axis=-1) < false_alarms)
    of_each_series = reference._replace(
        mean=reference.mean[:, None], covariance=reference.covariance[:, None]
    )
    by_reading = np.mean(
        np.min(tail(distance(readings[:, 50:], of_each_series), 2, 50), axis=-1) < false_alarms
    )
    # Shares of 400 have an sd of 0.025: four of them apart at the least.
    assert slow > 0.8
    assert slow - by_reading > 0.1


def test_a_change_is_dated():
    """A step of 3 sd behind the tenth reading: the most probable run began there."""
    readings = references(60, seed=3, batch=(200,))
    readings[:, 40:] += 3.0
    reference = reference_of(readings[:, :30])
    run_lengths = run_length(
        readings[:, 30:], after_change(reference), 1e-3, start=known_from(reference)
    )
    length = np.argmax(run_lengths.probability[:, 1:-1], axis=-1) + 1
    # 4 sd between the means, of which one reading's own sd makes it 1 in 40 to miss by one.
    assert np.mean(np.abs(length - 20) <= 1) > 0.95
