"""What coloured residuals are worth, against the scatter of estimates that they really cause."""

import numpy as np
import pytest
from scipy.signal import lfilter

from jbw.observables.effective_values import correlated_fraction, effective_fraction, white_square

SIZE = 4096


def autoregressive(rng, *coefficients, size=SIZE):
    """Noise of unit variance, white noise through 1 / (1 - a_1 q - a_2 q^2)."""
    noise = lfilter([1.0], [1.0, *(-a for a in coefficients)], rng.standard_normal(size + 2000))
    return noise[2000:] / noise.std()


def narrowband(radius, turn):
    """Coefficients of a resonance of given pole radius and angle a sample."""
    return 2 * radius * np.cos(turn), -(radius**2)


def bump(turn):
    """A burst of a carrier: its two quadratures, under one smooth envelope."""
    t = np.arange(SIZE)
    envelope = np.exp(-(((t - SIZE / 2) / 600) ** 2))
    return envelope * np.stack([np.cos(turn * t), np.sin(turn * t)])


@pytest.mark.parametrize(
    ("coefficients", "turn"),
    [((0.9,), 0.0015), (narrowband(0.99, 0.12), 0.12), (narrowband(0.99, 0.12), 0.4)],
    ids=["low-pass", "at the carrier", "away from the carrier"],
)
def test_the_covariance_is_that_of_least_squares_under_such_noise(coefficients, turn):
    rng = np.random.default_rng(11)
    slopes = bump(turn)
    normal = np.linalg.inv(slopes @ slopes.T)
    rows = np.stack([autoregressive(rng, *coefficients) for _ in range(400)])
    estimates = rows @ slopes.T @ normal
    factor = np.trace(np.cov(estimates.T) @ np.linalg.inv(normal)) / 2  # over white noise's
    worth = [effective_fraction(row, slopes, normal) for row in rows[:100]]
    # One row tells its spectrum over a few dozen lines; away from it noise is worth all and more.
    assert np.median(worth) == pytest.approx(min(1 / factor, 1.0), rel=0.3)


def test_noise_that_is_loud_where_the_prediction_moves_is_worth_less():
    rng = np.random.default_rng(4)
    slopes = bump(0.3)
    normal = np.linalg.inv(slopes @ slopes.T)
    loud = np.exp(-(((np.arange(SIZE) - SIZE / 2) / 400) ** 2)) + 0.02
    rows = loud * rng.standard_normal((400, SIZE)) / np.sqrt(np.mean(loud**2))
    estimates = rows @ slopes.T @ normal
    factor = np.trace(np.cov(estimates.T) @ np.linalg.inv(normal)) / 2
    worth = [effective_fraction(row, slopes, normal) for row in rows[:100]]
    assert np.median(worth) == pytest.approx(1 / factor, rel=0.15)


def test_constant_directions_see_the_whole_correlation():
    rng = np.random.default_rng(5)
    # AR(1): 1 + 2 sum rho^k = (1 + rho) / (1 - rho) = 19; cut where the estimate first dips.
    row = autoregressive(rng, 0.9, size=20000)
    assert correlated_fraction([row]) == pytest.approx(1 / 19, rel=0.25)
    assert correlated_fraction([rng.normal(size=20000)]) > 0.9


def test_units_do_not_matter():
    rng = np.random.default_rng(2)
    row, slopes = autoregressive(rng, 0.9), bump(0.01)
    scale = np.diag([1e6, 1e-9])
    one = effective_fraction(row, slopes, np.linalg.inv(slopes @ slopes.T))
    other = effective_fraction(
        row, scale @ slopes, np.linalg.inv(scale @ slopes @ slopes.T @ scale)
    )
    assert other == pytest.approx(one, rel=1e-9)


@pytest.mark.parametrize("is_complex", [False, True])
@pytest.mark.parametrize("missed", ["nothing", "a line", "a decay", "a resonance"])
def test_what_a_law_misses_is_no_white_noise(missed, is_complex):
    rng, n = np.random.default_rng(5), 4096
    noise = rng.standard_normal((2, n)) / np.sqrt(2)
    row = noise[0] + 1j * noise[1] if is_complex else np.sqrt(2) * noise[0]
    x = np.arange(n) / n
    row = (
        row
        + {
            "nothing": 0.0,
            "a line": 5.0 * np.cos(2 * np.pi * 100.3 * x),
            "a decay": 30.0 * np.exp(-20 * x) * np.cos(2 * np.pi * 3.3 * x),
            "a resonance": 50.0 / (1 + ((x - 0.4) / 3e-3) ** 2) * np.cos(2 * np.pi * 800 * x),
        }[missed]
    )
    # A median of 4,096 exponential values scatters by 1 / sqrt(n) / ln 2 = 2.3 %; the skirts of a
    # resonance, which reach over many lines, add 8 %.
    assert white_square(row) == pytest.approx(1.0, rel=0.12)


def test_few_values_tell_no_white_noise():
    assert white_square(np.ones(15)) == 0.0
