"""Model discrepancy: nothing where the law is right, and bands that hold where it is not."""

from dataclasses import replace

import jax
import numpy as np
import pytest
import xarray as xr
from parts import part_of
from scipy import stats

from jbw.errors import Attempts
from jbw.identification import model_discrepancy as learning
from jbw.identification.discrepancy import (
    NO_SCATTER,
    AtAmplitude,
    Discrepancy,
    Missed,
    Scatter,
    discrepancy_finding,
    discrepancy_in,
    discrepancy_sentences,
    growth,
    growth_shown,
)
from jbw.identification.leaving_out import fits_without_each_run
from jbw.identification.model_discrepancy import (
    FitOfAll,
    LeftOutRun,
    NoiseSquares,
    Rest,
    _over,
    _rest,
    _share_of,
    amplitudes_of_runs,
    coefficients_of,
    correlation_of,
    model_discrepancy,
    root_of,
    scatter_about_zero,
    scatter_by_amplitude,
    shift_of,
    widened,
)
from jbw.identification.selection import DecaySplit
from jbw.inference.fit.costly_fit import costly_fit
from jbw.inference.space.box import box
from jbw.measurement.records import Record, Test
from jbw.observables.dataset import Dataset, residual_by_label, stacked
from jbw.observables.decay import Decays
from jbw.observables.decay_drift import drift_of, left_out_decay
from jbw.observables.noise import with_fitted_noise
from jbw.report.messages import discrepancy as messages
from jbw.results.attributes import DecayConstants
from jbw.verification.decays import _with_discrepancy, drifted
from jbw.verification.predict import Request, predict
from jbw.verification.predictive_basis import Basis
from jbw.verification.verify import _verify_free

FS, OMEGA_N, ZETA, NOISE = 512.0, 2 * np.pi * 20.0, 4e-3, 1e-3
WITHHELD = messages.withheld(messages.ERROR_UNKNOWN)
BAND = (14.0, 26.0)
RUNS = (1.0, 0.8, 0.65, 0.5, 0.4, 0.3)  # first velocity of the records that are fitted [m/s]


def test_the_discrepancy_grows_with_the_logarithm_of_the_amplitude():
    assert growth(2.0, 1.0, 4.0) == 1.0
    # Half of the range of the logarithm beyond either end: twice as much.
    assert growth(8.0, 1.0, 4.0) == pytest.approx(2.0, rel=1e-12)
    assert growth(0.5, 1.0, 4.0) == pytest.approx(2.0, rel=1e-12)
    # A narrow range counts as one octave.
    assert growth(4.0, 2.0, 2.0) == pytest.approx(1 + 2 * 1.0, rel=1e-12)
    # Below three times as much at most, above more.
    assert growth(1e-9, 1.0, 4.0) == 3.0
    assert growth(64.0, 1.0, 4.0) == pytest.approx(5.0, rel=1e-12)
    assert growth(None, 1.0, 4.0) == growth(5.0, 0.0, 0.0) == 1.0


def test_a_run_that_is_left_out_below_counts_by_its_amplitude():
    # Over half of the range: 1 + 0.75 / 1.5, and of a narrow one 1 + 1 / 1.
    assert growth_shown(0.25, 1.0, 4.0) == pytest.approx(1.5, rel=1e-12)
    assert growth_shown(1.0, 2.0, 2.0) == pytest.approx(2.0, rel=1e-12)
    # It is no more than a test there is predicted with, and above and within it is the same.
    amplitudes = np.geomspace(1e-3, 1e3, 61)
    shown, predicted = ([f(y, 1.0, 3.0) for y in amplitudes] for f in (growth_shown, growth))
    assert np.all(np.array(shown) <= np.array(predicted) + 1e-12)
    np.testing.assert_array_equal(shown[30:], predicted[30:])
    assert growth_shown(None, 1.0, 4.0) == growth_shown(5.0, 0.0, 0.0) == 1.0


def test_every_run_has_an_amplitude_whatever_part_it_is_in():
    # Records of another length are a part of their own, and a part may not know its motion.
    parts = (
        part_of({"low": 1.0, "high": 4.0}, y_peak=0.4),
        part_of({"longer": 7.0}, y_peak=0.3),
        part_of({"unknown": 1.0}),
    )
    found = amplitudes_of_runs(type("Data", (), {"parts": parts})(), 100.0)
    assert found == pytest.approx({"low": 0.1, "high": 0.4, "longer": 0.3})


def test_the_scatter_of_equal_errors_is_the_mean_square_beyond_them():
    shift, std = np.array([3.0, -4.0, 5.0]), np.full(3, 0.5)
    found = scatter_about_zero(shift, std, np.ones(3), 3, np.eye(3))
    assert found**2 == pytest.approx(widened(3) * (np.mean(shift**2) - 0.5**2), rel=1e-9)
    # What lies where the discrepancy is twice as large counts a half.
    grown = scatter_about_zero(2 * shift, np.full(3, 1e-6), np.full(3, 2.0), 3, np.eye(3))
    assert grown**2 == pytest.approx(widened(3) * np.mean(shift**2), rel=1e-6)


def test_shifts_that_chance_makes_are_no_discrepancy():
    rng = np.random.default_rng(5)
    found = [
        scatter_about_zero(rng.standard_normal(6), np.ones(6), np.ones(6), 6, np.eye(6))
        for _ in range(2000)
    ]
    # One in a hundred each: at most so many of 2000 in all but one of 4000 such sets.
    assert np.count_nonzero(found) <= stats.binom.isf(2.5e-4, 2000, 0.01)
    assert scatter_about_zero(np.array([9.0]), np.array([np.inf]), np.ones(1), 3, np.eye(1)) == 0.0


def test_noise_of_two_runs_that_each_sees_counts_once():
    # Chi-square 14.8: chance makes as much of four independent shifts in 0.5 % of cases, and in
    # 1.5 % where two of them are of one noise (mean 4, variance 2 tr R^2 = 12).
    shift, std, ones = np.array([2.7, -2.7, 0.3, 0.3]), np.ones(4), np.ones(4)
    shared = np.eye(4)
    shared[0, 1] = shared[1, 0] = -1.0
    assert scatter_about_zero(shift, std, ones, 4, np.eye(4)) > 0
    assert scatter_about_zero(shift, std, ones, 4, shared) == 0.0


def test_shifts_of_runs_are_correlated_as_refits_of_a_linear_model_are():
    # Four runs of 30 values, three parameters, of which one moves all by omega_n and one by zeta.
    rng, num_runs, size = np.random.default_rng(3), 4, 30
    jacobians = rng.standard_normal((num_runs, size, 3)) * np.array([1.0, 2.0, 0.5])
    slopes = [np.stack([x @ [1.0, 0.3, 0.0], x @ [0.0, 1.0, 1.0]], axis=1) for x in jacobians]

    def shifts(noise):  # what each run shows at the least-squares fit of the others
        found = []
        for r in range(num_runs):
            others = [q for q in range(num_runs) if q != r]
            stacked_rows, values = np.concatenate(jacobians[others]), np.concatenate(noise[others])
            fitted = np.linalg.lstsq(stacked_rows, values)[0]
            found.append(np.linalg.lstsq(slopes[r], noise[r] - jacobians[r] @ fitted)[0])
        return np.array(found)

    # The shifts are linear in the noise: their covariance is that of the map, column by column.
    units = np.eye(num_runs * size).reshape(-1, num_runs, size)
    by_noise = np.stack([shifts(unit) for unit in units])
    precision = np.einsum("rvi,rvj->ij", jacobians, jacobians)
    runs = []
    for r in range(num_runs):
        without_it = np.linalg.inv(precision - jacobians[r].T @ jacobians[r])
        b, std = shift_of(np.zeros(size), slopes[r], jacobians[r], without_it)
        carried = coefficients_of(slopes[r]) @ jacobians[r] @ without_it
        runs.append(LeftOutRun(b, std, {}, by_parameters=carried))
    for quantity in range(2):
        covariance = by_noise[:, :, quantity].T @ by_noise[:, :, quantity]
        std = np.sqrt(np.diag(covariance))
        exact = covariance / np.outer(std, std)
        found = correlation_of(runs, np.linalg.inv(precision), quantity)
        np.testing.assert_allclose(found, exact, atol=1e-10)  # rounding of inverses


def test_a_scatter_beside_another_that_is_missed_is_not_judged_by_chance():
    # Chi-square 6 of 3 runs: chance makes as much in 11 % of cases.
    shift, std, ones = np.sqrt([2.0, 1.0, 3.0]), np.ones(3), np.ones(3)
    assert scatter_about_zero(shift, std, ones, 3, np.eye(3)) == 0.0
    found = scatter_about_zero(shift, std, ones, 3, np.eye(3), judged=False)
    assert found**2 == pytest.approx(widened(3) * (6 / 3 - 1), rel=1e-9)
    # As much as noise makes on average is nothing.
    assert scatter_about_zero(ones, std, ones, 3, np.eye(3), judged=False) == 0.0


def test_a_scatter_runs_with_the_amplitude_as_the_shifts_do():
    y = np.array([0.2, 0.4, 0.6, 0.8, 1.0])
    sign, std, ones = np.array([1, -1, 1, 1, -1]), np.full(5, 1e-6), np.ones(5)
    for power in (0, 1, 2):
        found = scatter_by_amplitude(3.0 * sign * y**power, std, y, ones, 5, np.eye(5))
        assert found.power == power
        assert found.std == pytest.approx(3.0 * np.sqrt(widened(5)), rel=1e-6)
    missed = Missed(Scatter(0.01, 1, 0.01), Scatter(0.002, 2, 0.002))
    law = Discrepancy(missed, missed, {}, 1.0, 4.0)
    assert law.at(2.0)[:2] == pytest.approx((0.005, 0.0005), rel=1e-12)
    # Beyond, by the square of the amplitude and by the logarithm: 2 * 2^2 times.
    assert law.at(8.0)[:2] == pytest.approx((8 * 0.01, 8 * 0.002), rel=1e-12)
    # At the largest amplitude, what grows outward is not there yet.
    more = Discrepancy(Missed(Scatter(0.0, 0, 0.01), NO_SCATTER), missed, {}, 1.0, 4.0)
    assert more.at(4.0)[:2] == (0.0, 0.0)
    assert more.at(8.0).frequency == pytest.approx(0.01 * np.sqrt(8**2 - 1), rel=1e-12)
    assert not more.is_nothing


def test_a_rest_is_judged_beside_noise_and_the_errors_of_parameters():
    # Rows of unit noise, moved by two parameters, by numpy's own draws.
    rng = np.random.default_rng(7)
    moved = 0.2 * rng.standard_normal((200, 2))
    drawn = rng.standard_normal((4000, 200)) + rng.standard_normal((4000, 2)) @ moved.T
    known = rng.chisquare(150, 4000) / 150  # the noise's square as 150 values tell it
    rests = [
        _rest(row, NoiseSquares(200 * square, 150.0), 1.0, moved)
        for row, square in zip(drawn, known, strict=True)
    ]
    gaps = np.array([rest.square - rest.mean for rest in rests])
    error = np.std(gaps) / np.sqrt(4000)
    assert abs(np.mean(gaps)) < 4 * error
    # A variance of 4000 draws strays by 1 / sqrt(2000) or so, the formula's noise by 1 / sqrt(75).
    assert np.mean([rest.variance for rest in rests]) == pytest.approx(np.var(gaps), rel=0.1)
    # The gamma distribution stands for a quotient, whose tail is a little longer.
    by_chance = np.mean([not rest.is_by_chance for rest in rests])
    assert 0.005 < by_chance < 0.02
    assert not Rest(1.0, 0.0, 0.0).is_by_chance
    assert Rest(0.0, 0.0, 0.0).is_by_chance


def test_values_that_repeat_each_other_tell_less_of_their_noise():
    """Every number stands twice: of 200 values a half is independent, by numpy's own draws."""
    drawn = np.repeat(np.random.default_rng(1).standard_normal((4000, 100)), 2, axis=1)
    squares = np.sum(drawn**2, axis=1)
    rest = _rest(drawn[0], NoiseSquares(200.0, np.inf), 0.5)
    # A variance of 4000 draws strays by a fiftieth.
    assert rest.variance == pytest.approx(np.var(squares), rel=0.1)


def test_a_share_is_that_at_the_reference_amplitude_and_over_the_response():
    # Twice the reference's error, by what grows with the amplitude alone: squares are four times.
    assert _share_of([Rest(4.0, 0.0, 1e-9)], [2.0], judged=False) == 1.0
    assert _over(Rest(8.0, 4.0, 16.0, 2.0), 2.0) == Rest(4.0, 2.0, 4.0, 1.0)


def test_few_runs_widen_a_99_percent_band_as_student_has_it():
    # Tables of t: 3.707 with 6 degrees of freedom and 5.841 with 3, of the normal 2.576.
    assert widened(6) == pytest.approx((3.707 / 2.576) ** 2, rel=1e-3)
    assert widened(3) == widened(2) == pytest.approx((5.841 / 2.576) ** 2, rel=1e-3)
    # Of six normal errors, a seventh lies inside the band in 99 of 100 cases.
    rng = np.random.default_rng(3)
    drawn = rng.standard_normal((40000, 7))
    band = 2.576 * np.sqrt(widened(6) * np.mean(drawn[:, :6] ** 2, axis=1))
    inside = np.mean(np.abs(drawn[:, 6]) < band)
    assert inside == pytest.approx(0.99, abs=4 * np.sqrt(0.99 * 0.01 / 40000))


def test_the_shift_of_a_linear_residual_is_exact():
    rng = np.random.default_rng(1)
    jacobian = rng.standard_normal((50, 3))
    slopes, covariance = jacobian[:, :2], np.diag([0.0, 0.0, 0.04])
    shift, std = shift_of(slopes @ [0.3, -2.0], slopes, jacobian, covariance)
    np.testing.assert_allclose(shift, [0.3, -2.0], rtol=1e-12)
    along = np.linalg.pinv(slopes)
    expected = np.linalg.inv(slopes.T @ slopes) + 0.04 * np.outer(
        along @ jacobian[:, 2], along @ jacobian[:, 2]
    )
    np.testing.assert_allclose(std, np.sqrt(np.diag(expected)), rtol=1e-12)
    shift, std = shift_of(slopes[:, 0], slopes * [1.0, 0.0], jacobian, covariance)
    assert shift[0] == pytest.approx(1.0)
    assert shift[1] == 0.0
    assert np.isinf(std[1])


def test_a_covariance_is_its_root_squared():
    std = np.array([1e-6, 1.0, 1e6])
    correlation = np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.3], [0.0, 0.3, 1.0]])  # indefinite
    positive = np.array([[1.0, 0.5, 0.0], [0.5, 1.0, 0.3], [0.0, 0.3, 1.0]])
    root = root_of(positive * np.outer(std, std)) / std[:, None]
    np.testing.assert_allclose(root @ root.T, positive, atol=1e-14)
    assert np.all(np.isfinite(root_of(correlation * np.outer(std, std))))


def test_a_drift_is_read_off_the_ratio_of_two_envelopes():
    time = np.linspace(0.5, 4.0, 80)
    predicted = np.exp((-0.7 + 3j) * time)
    measured = predicted * np.exp((-0.05 + 0.9j) * time)  # 3.6 rad at the end: turns are unwound
    drift = drift_of(measured, predicted, time)
    assert drift.rate == pytest.approx(0.05, rel=1e-12)
    assert drift.frequency == pytest.approx(0.9, rel=1e-12)
    assert np.abs(drift.rest).max() < 1e-12


@pytest.mark.parametrize("seed", range(5))
def test_noise_after_the_motion_is_no_drift(seed):
    rng, time = np.random.default_rng(seed), np.linspace(0.5, 40.0, 800)
    predicted = np.exp((-0.7 + 3j) * time)
    noise = 0.003 * (rng.standard_normal(800) + 1j * rng.standard_normal(800))
    found = left_out_decay(predicted + noise, predicted, time, (0.0, 0.0), 0.003, 1.0)
    # Five standard deviations, which chance exceeds once in 2e6.
    assert abs(found.drift.frequency) < 5 * found.frequency_std
    assert abs(found.drift.rate) < 5 * found.rate_std
    # The values within noise, which are left out, would add little.
    assert found.rate_std < 2 * 0.003 / np.sqrt(np.sum(np.abs(predicted * time) ** 2))


def test_a_record_within_noise_has_no_drift():
    time, silence = np.linspace(0.5, 4.0, 80), np.full(80, 1e-3 + 0j)
    found = left_out_decay(silence, silence, time, (0.1, 0.1), 1e-3, 1.0)
    assert found.drift.frequency == found.drift.rate == 0.0
    assert np.isinf(found.frequency_std)
    assert np.isinf(found.rate_std)


def test_envelopes_drift_apart_in_proportion_to_time():
    time, rates = np.array([0.0, 1.0, 3.0]), np.array([0.1, 0.2])
    found = np.log(drifted(jax.random.key(0), np.ones((20000, 3), complex), time, rates))
    np.testing.assert_allclose(found.real.std(axis=0), 0.1 * time, rtol=0.03)  # 6 sd of 20000
    np.testing.assert_allclose(found.imag.std(axis=0), 0.2 * time, rtol=0.03)


def test_the_size_of_a_motion_is_no_smaller_where_phases_scatter():
    """Of an envelope of constant size the rms, of which the discrepancy is a share, is constant."""
    time, turn = np.linspace(0.0, 3.0, 4), np.exp(0.4j)
    envelope = np.full((20000, 4), 2.0 * turn)
    motion, size = _with_discrepancy(
        jax.random.key(0), envelope, time, 50.0, AtAmplitude(0.1, 0.0, 0.0), np.ones(4, complex)
    )
    np.testing.assert_allclose(size, 2.0 / np.sqrt(2), rtol=1e-12)
    # The draws lie about what the law predicts, 2 cos(0.4), whatever their phases.
    np.testing.assert_allclose(np.median(motion, axis=0), 2.0 * turn.real, rtol=1e-12)
    # An error of the damping alone, 0.1 of omega_n = 5 1/s, makes the size log-normal instead.
    motion, _ = _with_discrepancy(
        jax.random.key(0),
        envelope.real + 0j,
        time,
        5.0,
        AtAmplitude(0.0, 0.1, 0.0),
        np.ones(4, complex),
    )
    spread = np.quantile(motion, 0.8413, axis=0) / np.median(motion, axis=0)
    np.testing.assert_allclose(np.log(spread), 0.5 * time, atol=0.03)


def decays(velocities, hardening=0.0, name="decay", noisy=None):
    r"""Decays whose frequency runs with the amplitude, in closed form.

    $$v = V \cos\varphi, \quad V = V_0 e^{-\zeta\omega_n t}, \quad
      \varphi = \omega_n t + \kappa V_0^2 (1 - e^{-2\zeta\omega_n t}) / (2 \zeta)$$
    """
    rng, t = np.random.default_rng(len(velocities)), np.arange(int(8 * FS)) / FS
    records = []
    for v0 in velocities:
        gone = -np.expm1(-2 * ZETA * OMEGA_N * t)
        phase = OMEGA_N * t + hardening * v0**2 * gone / (2 * ZETA) + rng.uniform(0, 6)
        v = v0 * np.exp(-ZETA * OMEGA_N * t) * np.cos(phase)
        v += NOISE * (10 if v0 == noisy else 1) * rng.standard_normal(len(t))
        records.append(Record(FS, {"velocity": v}, {"velocity": "m/s"}))
    return Test("decay", tuple(records), name, band_hz=BAND)


def learned(hardening, noisy=None):
    """Discrepancy of a linear structure from six decays, and what predicts with it."""
    data = Dataset.of([Decays.of(decays(RUNS, hardening, noisy=noisy), laws=())])
    prior = box({"omega_n": (0.9 * OMEGA_N, 1.1 * OMEGA_N), "zeta": (1e-4, 2e-2)})
    best = costly_fit(stacked, prior, data, starts={"omega_n": OMEGA_N, "zeta": ZETA})
    data = with_fitted_noise(best.theta, residual_by_label(best.residual, data), data)
    best = costly_fit(stacked, prior, data, starts=best.theta)
    y_peak = max(RUNS) / OMEGA_N
    found = model_discrepancy(best, prior, data, fits_without_each_run(best, prior, data))
    rng = np.random.default_rng(0)
    drawn = rng.multivariate_normal(list(best.theta.values()), best.covariance, (1, 100))
    dims = ("chain", "draw")
    posterior = xr.Dataset(
        {name: (dims, drawn[..., i]) for i, name in enumerate(best.theta)}
        | {
            "noise_std": (
                (*dims, "record"),
                np.broadcast_to(data.parts[0].groups.noise_std, (1, 100, len(RUNS))),
                {"units": "m/s"},
            )
        },
        {"record": list(data.labels)},
    )
    facts = DecayConstants(shift_std=float(data.parts[0].shift_std), worth=1.0)
    bare = Basis(posterior, {}, {}, y_peak, (), 1, posterior, facts, ())
    return found, bare, replace(bare, discrepancy=discrepancy_in(found))


def test_the_right_law_leaves_no_discrepancy():
    found, bare, basis = learned(0.0)
    assert discrepancy_in(found).is_nothing
    assert discrepancy_sentences(found) == []
    finding = discrepancy_finding(found, ())
    assert (finding.status, finding.entry) == ("ok", "discrepancy.no_repeats")
    unseen = decays((1.2, 0.7), name="unseen")
    before, after = (predict(one, unseen, Request(num_draws=50)) for one in (bare, basis))
    np.testing.assert_array_equal(before["predictive_band"], after["predictive_band"])


@pytest.mark.parametrize("noisy", [RUNS[0], RUNS[3], RUNS[5]])
def test_one_noisy_record_decides_nothing(noisy):
    """Of ten times the noise: it shows no discrepancy of a right law, and hides none of another."""
    found, _, _ = learned(0.0, noisy)
    assert discrepancy_in(found).is_nothing
    of_wrong, of_noisy = (
        discrepancy_in(learned(2e-4, one)[0]).decays.frequency.std for one in (None, noisy)
    )
    assert of_wrong / 2 < of_noisy < 2 * of_wrong


def test_bands_of_stronger_decays_hold_what_a_wrong_law_misses():
    hardening = 2e-4  # of the frequency at 1 m/s
    found, bare, basis = learned(hardening)
    discrepancy = discrepancy_in(found)
    # Off by up to the change of frequency of the strongest record, widened for three fits.
    assert 0.05 * hardening < discrepancy.decays.frequency.std < 3 * hardening
    assert discrepancy_sentences(found) == [messages.IN_BANDS]
    finding = discrepancy_finding(found, ())
    assert (finding.code, finding.status) == ("discrepancy", "usable")
    assert finding.values["frequency"] == discrepancy.decays.frequency.whole
    assert "of the natural frequency" in finding.reason
    # A thousandth of it is in the bands, and no fault of the law.
    shrunk = found.assign(rest=1e-3 * found["rest"], rest_beyond=1e-3 * found["rest_beyond"])
    factors = np.tile([1e-3, 1.0, 1e-3], 2)  # of each standard deviation; powers stay
    shrunk.attrs |= {kind: factors * found.attrs[kind] for kind in ("forced", "decays")}
    small = discrepancy_finding(shrunk, ())
    assert (small.status, small.entry) == ("ok", "discrepancy.small")
    largest = max(discrepancy.decays.frequency.whole, discrepancy.decays.damping.whole)
    # zeta is the fitted one, which hardening moves by some per cent.
    assert small.values["error"] == pytest.approx(1e-3 * largest / ZETA, rel=0.05)
    unseen = decays((1.2, 0.9, 0.35), hardening, name="unseen")
    before, after = (predict(one, unseen, Request(num_draws=100)).attrs for one in (bare, basis))
    assert before["coverage"] < 0.8
    assert after["coverage"] >= 0.95
    # Without the discrepancy the error of the law at the beginning is taken for the own frequency
    # of the record, and goes on after it.
    assert after["nrmse"] < before["nrmse"]
    # Not wider than three times what is missed.
    assert after["half_width"] / 2.576 <= 3 * after["nrmse"]


@pytest.mark.parametrize("noisy", [None, 0.55])
def test_bands_of_a_held_out_decay_hold_its_own_noise(noisy):
    """Ten times the noise of the fitted records: the law is right, so that 99 % lie inside."""
    _, basis, _ = learned(0.0)
    unseen = decays((0.55,), name="unseen", noisy=noisy)
    attrs = predict(basis, unseen, Request(num_draws=100)).attrs
    # About 700 independent values of a filtered record: 99 % within two standard deviations.
    assert attrs["coverage"] == pytest.approx(0.99, abs=0.008)
    assert 0.9 < attrs["half_width"] / (2.576 * attrs["nrmse"]) < 1.15


def test_a_band_far_beyond_what_was_fitted_is_withheld_in_words():
    _, bare, basis = learned(2e-4)
    far = decays((1e2,), name="far")  # the fitted records lie within a factor of 3.3
    found, before = (predict(one, far, Request(num_draws=20)) for one in (basis, bare))
    assert found.attrs["noise"] == WITHHELD
    assert "predictive_band" not in found
    assert not {"coverage", "half_width", "noise_std"} & set(found.attrs)
    assert found.attrs["nrmse"] > 0
    # A law that misses nothing beyond noise has its band anywhere.
    assert "predictive_band" in before
    nothing = Missed(NO_SCATTER, NO_SCATTER)
    assert Discrepancy(nothing, nothing, {}, 1.0, 2.0).is_stated(1e3)
    missed = Discrepancy(nothing, nothing, {"sweep": Scatter(0.1)}, 1.0, 4.0)
    # Below, where joints stick, a law misses no more than three times as much.
    assert [missed.is_stated(y) for y in (1e-3, 0.24, 15.9, 16.1)] == [True, True, True, False]


def test_no_band_is_stated_beyond_what_was_fitted_where_noise_hides_what_the_law_misses():
    nothing = Missed(NO_SCATTER, NO_SCATTER)
    hidden = Discrepancy(nothing, nothing, {}, 1.0, 4.0, in_noise=True)
    # Within a level's own scatter of amplitudes a test is one of that level.
    assert [hidden.is_stated(y) for y in (0.1, 3.9, 4.3, 4.5)] == [True, True, True, False]
    assert replace(hidden, y_low=0.0, y_high=0.0).is_stated(4.5)  # no amplitude is known
    # White residuals are noise; a linear law that hardening decays are fitted by leaves others.
    assert learned(0.0)[0].attrs["hidden_in_noise"] == 0
    found = learned(2e-4)[0]
    assert found.attrs["hidden_in_noise"] == 1
    assert discrepancy_in(found).in_noise


def test_what_is_missed_is_taken_as_it_is_where_a_coloured_residual_counts_as_noise(monkeypatch):
    # So weak a hardening leaves white residuals, and chance makes what it misses.
    assert discrepancy_in(learned(2e-5)[0]).is_nothing
    monkeypatch.setattr(learning, "_hides_in_noise", lambda *_: True)
    assert discrepancy_in(learned(2e-5)[0]).decays.frequency.std > 0


def test_scatter_of_runs_is_not_counted_twice():
    # Frequencies of four runs scatter as the fit knows of runs; their damping is beyond chance.
    shifts = np.array([[1.2, 30.0], [-1.3, -40.0], [0.9, 35.0], [-1.1, 50.0]])
    std = np.array([1.0, 0.1])
    runs = [LeftOutRun(shift, std, {}, amplitude=1.0, noise_std=std) for shift in shifts]
    of_runs = FitOfAll(4, 100.0, np.eye(1), np.array([0.95, 0.0]))
    of_noise = of_runs._replace(scatter=np.zeros(2))
    frequency, damping = learning._missed(runs, of_runs, judged=False)
    assert frequency == NO_SCATTER
    assert damping.std == pytest.approx(np.sqrt(widened(4) * np.mean(shifts[:, 1] ** 2)), rel=1e-4)
    # As errors of noise, what is more than expected is added: chi-square 5.15 of 4.
    alone = learning._missed(runs, of_noise, judged=False).frequency
    assert (100 * alone.std) ** 2 == pytest.approx(widened(4) * (5.15 / 4 - 1), rel=1e-6)


def test_a_band_is_withheld_inside_a_campaign_as_of_a_test_brought_later():
    _, _, basis = learned(2e-4)
    fitted, unseen = decays(RUNS, 2e-4), decays((4.0, 0.7), 2e-4)
    together = replace(fitted, records=(*fitted.records, *unseen.records))
    names = tuple(f"decay {i + 1}" for i in range(len(together.records)))
    split, reduced = DecaySplit(fitted, together, names), Decays.of(together, laws=())
    groups = _verify_free(split, reduced, basis, lambda *_: {}, 0, Attempts())
    far, near = (groups[f"/verification/decay/{name}"] for name in names[-2:])
    assert (far.attrs["noise"], far.attrs["withheld"]) == (WITHHELD, 1)
    assert "predictive_band" not in far
    assert not {"coverage", "half_width", "num_values"} & set(far.attrs)
    assert "withheld" not in near.attrs
    assert near.attrs["coverage"] >= 0.95
    # One of a test's records is enough: the band of a test brought later is of all of them.
    later = replace(unseen, name="later")
    assert predict(basis, later, Request(num_draws=20)).attrs["noise"] == WITHHELD


def test_a_kind_that_was_not_left_out_takes_the_largest_share():
    nothing = Missed(NO_SCATTER, NO_SCATTER)
    shares = {"sweep": Scatter(0.02), "loop": Scatter(0.05)}
    found = Discrepancy(nothing, nothing, shares, 0.0, 0.0)
    assert found.share_of("sweep", found.at(None)) == 0.02
    assert found.share_of("tones", found.at(None)) == 0.05
    assert not found.is_nothing


def test_what_cannot_be_scored_is_said():
    empty = model_discrepancy_of_runs(0)
    assert discrepancy_sentences(empty) == [messages.UNSCORED["one run"].sentence]
    assert discrepancy_finding(empty, ()) is None
    two = model_discrepancy_of_runs(0, num_runs=2)
    assert discrepancy_sentences(two) == [messages.UNSCORED["two runs"].sentence]
    assert discrepancy_sentences(model_discrepancy_of_runs(3)) == []
    repeats = model_discrepancy_of_runs(3, y_high=1.05)
    assert discrepancy_sentences(repeats) == [messages.UNSCORED["one level"].sentence]


def model_discrepancy_of_runs(count, *, num_runs=1, y_high=2.0):
    """A dataset as `model_discrepancy` gives it where so many runs show nothing."""
    nothing = np.zeros(4)
    return xr.Dataset(
        {"rest": ("kind", np.zeros(0)), "shift": (("run", "quantity"), np.zeros((count, 2)))},
        {"kind": np.zeros(0, str), "run": [f"run {i}" for i in range(count)]},
        {
            "forced": nothing,
            "decays": nothing,
            "y_low": 1.0,
            "y_high": y_high,
            "num_runs": max(count, num_runs),
        },
    )
