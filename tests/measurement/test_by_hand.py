"""What readings and hypotheses of faults say of known numbers, by hand and by definition."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from jbw.measurement.faults.begins_late import _onset
from jbw.measurement.faults.hypothesis import Facts
from jbw.measurement.faults.lag import ClocksApart, Delay
from jbw.measurement.faults.second_mode import SecondMode
from jbw.measurement.faults.steady_line import UndecayingLine
from jbw.measurement.faults.window import window_constant
from jbw.measurement.readings import table
from jbw.measurement.readings.decay import _log_response, _moments
from jbw.measurement.readings.statement import _between_records, _RowsOfRecords
from jbw.measurement.readings.statement import _onset as _onset_of_change

FACTS = Facts(SimpleNamespace(response="velocity"), 0.0, 0.02, (15.0, 25.0))
TIME = np.linspace(0.0, 10.0, 101)


def sweep(theta=(0.5, 0.0), **signal):
    """Fits of a sweep about 20 Hz, whose mean period is 50 ms, in units of 2 pi rad/s."""
    values = {"mean_period_s": 0.05, "time": TIME, "centre_hz": 20.0, **signal}
    fits = {"linear": SimpleNamespace(theta=np.array(theta))}
    return SimpleNamespace(signal=SimpleNamespace(**values), fits=fits, scale=2 * np.pi)


@pytest.mark.parametrize(("periods", "delay"), [(0.1, 0.025), (-0.2, 0.01)])
def test_a_delay_is_that_of_the_campaign_and_what_the_record_adds(periods, delay):
    fault = Delay().fault(np.array([periods]), sweep(), FACTS)
    assert f"`delay = {delay:.3g}`" in fault.remedy


@pytest.mark.parametrize(("periods", "ppm", "word"), [(0.2, 1000, "fast"), (-0.02, -100, "slow")])
def test_a_clock_is_fast_where_its_lag_grows(periods, ppm, word):
    """0.2 periods of 50 ms in 10 s are a thousandth."""
    fault = ClocksApart().fault(np.array([0.0, periods]), sweep(), FACTS)
    assert f"`clock_ppm = {ppm:.3g}`" in fault.remedy
    assert f"ppm {word} compared with" in fault.what


def test_a_second_mode_lies_on_its_own_side_of_the_first():
    """The first at 19 Hz with a rate of 2 pi 0.5, the second six rates above it."""
    fault = SecondMode().fault(np.array([1.0, 6.0]), sweep((0.5, -1.0)), FACTS)
    assert "19 and 22 Hz" in fault.what
    assert "`band = [15, 20.5]`" in fault.remedy


def test_a_line_has_its_size_before_the_filter_of_the_band():
    """A filter that passes 0.8 of the mode and 0.4 of the line shows half of the line's share."""
    passed = {"passed": lambda turn: 0.4 if turn else 0.8}
    inside, outside = (sweep((0.5, 0, 0, 0), half_width_hz=hz, **passed) for hz in (1.0, 0.01))
    values = np.array([0.3, 0.4])  # 0.3 turns in 10 s: 0.03 Hz above the centre
    assert UndecayingLine().share(values, inside) == pytest.approx(1.0, rel=1e-14)
    # A line outside the band counts with what the filter leaves of it.
    assert UndecayingLine().share(values, outside) == pytest.approx(0.5, rel=1e-14)


@pytest.mark.parametrize("tau", [3.0, 8.0])
def test_noise_under_a_window_falls_with_its_time_constant(tau):
    fs, rng = 1000.0, np.random.default_rng(4)
    t = np.arange(16384) / fs
    x = np.exp(-t / tau) * rng.standard_normal(len(t))
    found = window_constant(x, fs, (90.0, 110.0), 1.0, 0.0)
    assert found is not None
    assert found[0] == pytest.approx(tau, abs=4 * found[1])
    assert found[1] < 0.05 * tau


def test_records_differ_by_chance_as_the_likelihood_ratio_at_a_bound_has_it():
    """One reading a record: the restricted likelihood has its optimum where the variances agree."""
    rng, variance, count = np.random.default_rng(2), 1e-6, 12
    y = 1.0 + 1.6e-3 * rng.standard_normal(count)
    one = np.ones((count, 1))
    rows = _RowsOfRecords(one[:, 0], y, (np.full((1, 1), variance**-0.5),) * count)
    ratio = np.sum((y - y.mean()) ** 2) / variance / (count - 1)
    gain = (count - 1) * (ratio - 1 - np.log(ratio))
    tau, chance = _between_records(rows, one)
    # Scatters that are tried lie 12 % apart.
    assert tau == pytest.approx(np.sqrt((ratio - 1) * variance), rel=0.07)
    assert chance == pytest.approx(0.5 * chi2.sf(gain, 1), rel=0.05)


def test_a_filter_answers_a_decaying_line_by_its_taps():
    """By its definition, sum h exp(s t), of which the logarithm and its slope are taken."""
    taps, fs = np.kaiser(41, 7.0) / np.kaiser(41, 7.0).sum(), 100.0
    t = (np.arange(41) - 20) / fs
    poles = np.array([-3.0 + 8.0j, 1.0 - 5.0j])
    terms = taps * np.exp(np.outer(poles, t))
    log, slope = _log_response(SimpleNamespace(moments=_moments(taps, fs)), poles)
    assert log == pytest.approx(np.log(terms.sum(axis=1)), rel=1e-12)
    assert slope == pytest.approx(terms @ t / terms.sum(axis=1), rel=1e-12)


def test_a_change_is_sure_from_where_its_difference_from_the_smallest_is():
    """Of b r^2 with an uncertain slope s: b (r + low) = 2.576 s."""
    covariance = np.diag([0.1**2, 0.0])
    found = _onset_of_change(np.array([0.0, 0.5]), covariance, 0.1, 1.0)
    # Amplitudes that are tried lie 4 % apart.
    assert found == pytest.approx(2.576 * 0.1 / 0.5 - 0.1, rel=0.04)


def test_heavy_damping_is_a_ratio_to_the_natural_frequency(monkeypatch):
    """A pole of -3 + 10j times 2 pi rad/s: of the frequency sqrt(109) Hz it damps 3 / sqrt(109)."""
    monkeypatch.setattr(table, "covariance", lambda *_: np.eye(2))
    fit = SimpleNamespace(theta=np.array([0.3, 0.0]))
    signal = SimpleNamespace(a0=1.0, centre_hz=10.0)
    fits = SimpleNamespace(
        fits={"linear": fit}, scale=20 * np.pi, FIRST=0, signal=signal, weight=None
    )
    rows = table._rows(fits, "linear", np.ones(1))
    assert rows.zeta == pytest.approx([3 / np.sqrt(109)], rel=1e-12)
    assert rows.hz == pytest.approx([np.sqrt(109)], rel=1e-12)


@pytest.mark.parametrize("order", [0, 1, 2])
def test_a_decaying_velocity_falls_with_its_frequency_too(monkeypatch, order):
    """Of V = omega(r)^p Y the displacement falls by sigma (1 - p d ln omega / d ln r)."""
    monkeypatch.setattr(table, "DecayFits", SimpleNamespace)
    monkeypatch.setattr(table, "covariance", lambda *_: np.eye(6))
    fit = SimpleNamespace(theta=np.array([0.01, 0.0, 0.0, 0.0, 0.2, 0.0]))  # omega = 1 + r / 5
    signal = SimpleNamespace(a0=1.0, centre_hz=10.0, order=order)
    fits = SimpleNamespace(
        fits={"quadratic": fit}, scale=20 * np.pi, FIRST=0, signal=signal, weight=None
    )
    r = np.geomspace(1.0, 0.5, 401)
    rows = table._rows(fits, "quadratic", r)
    sigma = 0.01 * (1 - order * 0.2 * r / (1 + 0.2 * r))
    # Differences along 401 amplitudes.
    assert rows.zeta[1:-1] == pytest.approx((sigma / np.hypot(sigma, 1 + 0.2 * r))[1:-1], rel=1e-5)


def test_values_that_err_together_have_a_sure_change():
    errors = np.array([[4.0, 3.5], [3.5, 4.0]])
    found = table._change(np.array([2.0, 1.5]), errors, 0.0)
    assert (found.value, found.sd) == (0.5, pytest.approx(1.0, rel=1e-14))


@pytest.mark.parametrize(("order", "y"), [(0, 2.0), (1, 0.02), (2, 2e-4)])
def test_an_amplitude_of_displacement_is_that_of_its_derivative_over_the_frequency(order, y):
    reading = SimpleNamespace(amplitude=np.array([2.0]), hz=np.array([50 / np.pi]), order=order)
    assert table.ModeReading.y.fget(reading) == pytest.approx([y], rel=1e-14)


def test_a_late_blow_is_found_beside_an_offset_of_the_sensor():
    fs, blow = 1000.0, 1.2
    t = np.arange(4000) / fs
    ring = np.where(t < blow, 0.0, np.exp(-(t - blow)) * np.cos(2 * np.pi * 20 * (t - blow)))
    assert _onset(5.0 + ring, fs, 0.0, 20.0) == pytest.approx(blow, abs=1 / fs)
