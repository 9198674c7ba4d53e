"""Softening and damping against amplitude: closed forms of textbook joints."""

from types import SimpleNamespace

import numpy as np
import pytest

from jbw.identification.diagnosis import (
    diagnose,
    diagnosis_sentences,
    masing_ratio,
    turning_point,
)
from jbw.observables.drives import readings_of
from jbw.observables.observable import AmplitudeCurve, Shown

Y = np.linspace(2e-5, 1e-3, 60)


def readings(q, ratio, softening=0.01, noise=0.0, seed=0):
    """Of a joint whose loss of frequency and added damping grow by the power q."""
    rng = np.random.default_rng(seed)
    part = softening * (Y / Y[-1]) ** q
    sd = noise * softening / (Y / Y[-1])
    scatter = sd * rng.normal(size=(2, Y.size))
    frequency, damping = 500.0 * (1 - part + scatter[0]), 0.003 + ratio * part + scatter[1]
    return AmplitudeCurve(Y, frequency, damping, np.diag((500.0 * sd) ** 2), np.diag(sd**2))


# Closed forms of Segalman's and Iwan's arrays, worked out by hand for these exponents.
@pytest.mark.parametrize(
    ("q", "ratio"), [(0.3, 0.163), (0.5, 0.250), (0.7, 0.326), (1.0, 0.424), (1.5, 0.563)]
)
def test_masings_ratio_is_that_of_the_table(q, ratio):
    assert masing_ratio(q) == pytest.approx(ratio, abs=6e-4)


@pytest.mark.parametrize("q", [0.6, 1.0, 1.4])
def test_clean_readings_give_exponents_and_ratio(q):
    found = diagnose(readings(q, 0.3))
    for band, value in (
        (found.softening, 0.01),
        (found.softening_exponent, q),
        (found.damping, 0.003),
        (found.damping_exponent, q),
        (found.ratio, 0.3),
        (found.elastic, 1 - 0.3 / masing_ratio(q)),
    ):
        np.testing.assert_allclose(band, value, rtol=2e-3, atol=1e-6)
    # Of Bouc-Wen with nu = 1, r is gamma over delta itself.
    if q == 1.0:
        np.testing.assert_allclose(found.opening, 0.3, rtol=2e-3)


def test_bands_hold_the_truth_in_noise_and_the_words_follow_them():
    inside = 0
    for seed in range(20):
        found = diagnose(readings(1.0, 0.245, noise=0.02, seed=seed))
        inside += found.elastic[0] < 1 - 0.245 / masing_ratio(1.0) < found.elastic[2]
    assert inside >= 18  # of twenty 99 % bands; two misses have a chance of 0.02
    said = diagnosis_sentences(found)
    assert "of the softening is elastic" in said[1]
    masing = diagnosis_sentences(diagnose(readings(0.7, masing_ratio(0.7), noise=0.02)))
    assert "agree with a joint of sliders" in masing[1]
    near = diagnosis_sentences(diagnose(readings(0.7, 1.05 * masing_ratio(0.7), noise=1e-4)))
    assert "agree with a joint of sliders" in near[1]  # closed forms are of first order
    viscous = diagnosis_sentences(diagnose(readings(0.7, 1.0, noise=0.02)))
    assert "damping comes without softening" in viscous[1]
    hard = diagnosis_sentences(diagnose(readings(1.0, 0.2, softening=-0.01, noise=0.02)))
    assert "hardens" in hard[1]


def test_a_smooth_pair_is_told_where_straight_lines_are_seen():
    """Equivalent stiffness 8 c Y / 3 pi of c y|y| and damping of c v|v|, of the textbooks."""
    spring, damper, omega = -5e5, 0.9, 500.0
    kappa = 8 * spring * Y / (3 * np.pi)
    frequency = np.sqrt(omega**2 + kappa)
    found = diagnose(exactly(Y, frequency, 0.003 + 8 / (3 * np.pi) * damper * Y / 2))
    # First order in a softening of 0.1 %.
    np.testing.assert_allclose(found.spring, spring, rtol=2e-3)
    np.testing.assert_allclose(found.damper, damper, rtol=1e-3)
    noisy = diagnosis_sentences(diagnose(readings(1.0, 0.245, noise=0.02)))
    assert noisy[2].endswith("frequency and damping alone do not prove hysteresis.")
    assert len(diagnosis_sentences(diagnose(readings(0.5, 0.245, noise=1e-3)))) == 2


def test_damping_without_softening_is_told():
    rng = np.random.default_rng(0)
    still = 500.0 * (1 + 1e-6 * rng.normal(size=Y.size) / Y * Y[-1])
    sd = np.diag((5e-4 / Y * Y[-1]) ** 2)
    none = np.zeros_like(sd)
    growing = AmplitudeCurve(Y, still, 0.003 + 1e-3 * Y / Y[-1], sd, none)
    grows = diagnosis_sentences(diagnose(growing))
    assert grows[1].endswith("as with Dahl's law or a damper.")
    noise = 1e-5 * rng.normal(size=Y.size)
    constant = AmplitudeCurve(Y, still, 0.003 + noise, sd, none + 1e-10 * np.eye(len(Y)))
    stuck = diagnosis_sentences(diagnose(constant))
    assert stuck[1].endswith("whose sliders are fully stuck.")


def exactly(*columns):
    none = np.zeros((len(columns[0]), len(columns[0])))
    return AmplitudeCurve(*columns, none, none)


def test_few_readings_say_nothing():
    assert diagnose(readings(1.0, 0.3).at(np.arange(len(Y)) < 4)) is None


def turned(y, noise, seed):
    """Readings whose frequency falls to 98.75 % of 100 Hz where 3 y^2 = 0.01 y^0.5, then rises."""
    rng = np.random.default_rng(seed)
    hz = 100 * (1 - 0.02 * y**0.5 + 0.03 * y**2) + noise * rng.standard_normal(len(y))
    spread = np.eye(len(y)) * (2 * np.pi * noise) ** 2
    return AmplitudeCurve(1e-3 * y, 2 * np.pi * hz, 0.01 + 0.002 * y, spread, 0.0 * spread)


@pytest.mark.parametrize("count", [8, 12, 60])
def test_a_frequency_that_turns_is_said_to_turn(count):
    y = np.linspace(0.02, 1.0, count)
    found = diagnose(turned(y, 0.01, 3))
    at, hz, last = found.turn
    # d/dy (-0.02 y^0.5 + 0.03 y^2) = 0 at y = (1/6)^(2/3) = 0.303; the bottom is flat: it is found
    # to a few readings, or a group.
    assert at == pytest.approx(0.303e-3, abs=0.16e-3)
    assert hz == pytest.approx(100 * (1 - 0.02 * 0.303**0.5 + 0.03 * 0.303**2), abs=0.05)
    assert last == pytest.approx(101.0, abs=0.3 if count > 12 else 0.03)  # of a group, or itself
    (said,) = diagnosis_sentences(found)
    assert f"the frequency falls to {hz:.4g} Hz at {1e6 * at:.3g} um, then rises" in said


def test_one_way_is_no_turn():
    y = np.linspace(0.02, 1.0, 40)
    wrong = 0
    for seed in range(50):
        noise = 0.02 * np.random.default_rng(seed).standard_normal(len(y))
        for power, change in ((0.5, -1.0), (1.0, 1.0), (2.0, -1.0), (1.0, 0.0)):
            hz = 100 + change * y**power + noise
            spread = np.eye(len(y)) * (2 * np.pi * 0.02) ** 2
            curve = AmplitudeCurve(y, 2 * np.pi * hz, y, spread, spread)
            wrong += turning_point(curve) is not None
    assert wrong <= 4  # 2 % of 200


def test_a_damping_that_is_not_positive_is_no_reading():
    curve = exactly(np.ones(3), np.ones(3), np.array([0.01, -0.02, 0.03]))
    part = SimpleNamespace(drive="", shown=lambda: Shown(amplitude_readings=lambda: curve))
    np.testing.assert_array_equal(readings_of((part, part)).zeta, [0.01, 0.03, 0.01, 0.03])
