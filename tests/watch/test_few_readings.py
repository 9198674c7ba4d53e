"""Few references and few readings, where their number decides: closed forms and enumeration."""

import itertools

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import f as fisher
from scipy.stats import t as student

from jbw.watch.detection import Belief, ReferenceReadings, run_length
from jbw.watch.statement import Trend, change_of, torque_after

NUM_REFERENCES, NUM = 6, 3


def test_six_references_and_three_readings_leave_their_own_students_t():
    r"""$x = d \pm t_5\, s\sqrt{1/3 + 1/6}$ for a slope of one.

    To 2 %: places lie 1e-3 apart, of 0.086; what is expected, N(0, 1), narrows it by 0.2 %.
    """
    s, away = 0.03, 0.0
    reference = ReferenceReadings(NUM_REFERENCES, np.zeros(1), np.array([[s**2]]))
    trend = Trend(8.0, np.ones((4, 1)), 4.0, 12.0)
    torque = torque_after(np.array([away]), reference, NUM, trend)
    half = student.ppf(0.995, NUM_REFERENCES - 1) * s * np.sqrt(1 / NUM + 1 / NUM_REFERENCES)
    assert np.log(torque.high / 8.0) == pytest.approx(half, rel=0.02)
    assert np.log(torque.low / 8.0) == pytest.approx(-half, rel=0.02)


def test_intervals_hold_the_torque_as_often_as_they_say():
    """Brute force: of 4000 changes a 99 % interval misses 1 %, within 0.16 % by chance."""
    rng, s, slope = np.random.default_rng(20), 0.03, 1.0
    trend = Trend(8.0, np.full((1, 1), slope), 4.0, 12.0)
    missed = 0
    for _ in range(4000):
        x = 0.3 * rng.standard_normal()
        before = s * rng.standard_normal(NUM_REFERENCES)
        after = slope * x + s * rng.standard_normal(NUM)
        reference = ReferenceReadings(
            NUM_REFERENCES, np.array([before.mean()]), np.array([[before.var(ddof=1)]])
        )
        torque = torque_after(np.array([after.mean() - before.mean()]), reference, NUM, trend)
        missed += not torque.low <= 8.0 * np.exp(x) <= torque.high
    assert abs(missed / 4000 - 0.01) < 4 * np.sqrt(0.01 * 0.99 / 4000)


@pytest.mark.parametrize(("part", "explained"), [(0.93, True), (1.07, False)])
def test_what_no_torque_explains_is_hotelling_of_the_mean_of_the_readings(part, explained):
    """T^2 = p (n0 - 1) / (n0 - p) F, at 99 % of F: seven per cent to either side of it."""
    p = 2
    limit = (
        fisher.isf(0.01, p, NUM_REFERENCES - p) * p * (NUM_REFERENCES - 1) / (NUM_REFERENCES - p)
    )
    away = np.array([0.0, np.sqrt(part * limit * (1 / NUM + 1 / NUM_REFERENCES))])
    trend = Trend(8.0, np.array([[1.0, 0.0]]), 4.0, 12.0)  # which leaves the second value alone
    reference = ReferenceReadings(NUM_REFERENCES, np.zeros(p), np.eye(p))
    assert torque_after(away, reference, NUM, trend).explained is explained


def enumerated(x, prior, start, hazard):
    """Evidence and probability of no change, over every place where a change may have come."""
    terms, unchanged = [], -np.inf
    for changes in itertools.product((False, True), repeat=len(x) + 1):
        log_p, run = 0.0, start
        for i, change in enumerate(changes):
            log_p += np.log(hazard if change else 1 - hazard)
            run = prior if change else run
            if i < len(x):
                mean, kappa, nu, psi = run
                scale = np.sqrt(psi * (kappa + 1) / (kappa * nu))
                log_p += student.logpdf(x[i], nu, mean, scale)
                away = x[i] - mean
                psi = psi + kappa / (kappa + 1) * away**2
                run = mean + away / (kappa + 1), kappa + 1, nu + 1, psi
        terms.append(log_p)
        if not any(changes):
            unchanged = log_p
    return logsumexp(terms), np.exp(unchanged - logsumexp(terms))


def test_a_change_has_the_interval_of_students_t_of_the_references():
    reference = ReferenceReadings(6, np.array([30.0, np.log(0.01)]), np.diag([0.02, 0.03]) ** 2)
    behind = reference.mean + np.array([[-0.1, 0.2], [-0.3, 0.4]])
    found = change_of(reference, behind, 1)
    reach = student.ppf(0.995, 5) * 0.02 * np.sqrt(1 / 2 + 1 / 6)
    assert found.frequency == pytest.approx((-0.2, -0.2 - reach, -0.2 + reach), rel=1e-12)


def test_two_readings_behind_references_by_hand():
    prior, start = (0.0, 0.25, 5.0, 2.0), (0.1, 6.0, 5.0, 1.5)

    def belief(mean, kappa, nu, psi):
        return Belief(np.array([mean]), np.array(kappa), np.array(nu), np.array([[psi]]))

    x, hazard = [0.7, 1.9], 0.2
    run_lengths = run_length(np.array(x)[:, None], belief(*prior), hazard, belief(*start))
    evidence, unchanged = enumerated(x, prior, start, hazard)
    assert float(run_lengths.log_evidence) == pytest.approx(evidence, rel=1e-12)
    assert float(run_lengths.unchanged[-1]) == pytest.approx(unchanged, rel=1e-12)
