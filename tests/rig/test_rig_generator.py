"""The excitations against sums of cosines, their spectra and their definitions."""

import numpy as np
import pytest

from jbw.rig.generator import Noise, Steps, Sweep, Tone, analog, draw_phases
from jbw.rig.presets import LABORATORY, STEPPED_HZ, stepped_plan, sweep_plan

FS = 1024.0
NONE = np.empty(0)


@pytest.fixture(scope="module")
def noise():
    excitation = Noise(level=0.05, duration=30.0, settle=2.0)
    return excitation, draw_phases(excitation, np.random.default_rng(1), FS)


def test_noise_is_flat_up_to_nyquist_and_of_the_stated_rms(noise):
    excitation, phases = noise
    period = 2 * (phases.size + 1)
    assert period > 32 * FS  # longer than settling and record together
    u = analog(excitation, FS, phases, fs=FS)(0, period)
    assert np.sqrt(np.mean(u**2)) == pytest.approx(0.05, rel=1e-12)
    lines = np.abs(np.fft.rfft(u))
    assert lines[[0, -1]].max() < 1e-12 * lines[1]
    np.testing.assert_allclose(lines[1:-1], lines[1], rtol=1e-9)


def test_noise_between_samples_holds_nothing_above_nyquist(noise):
    excitation, phases = noise
    period = 2 * (phases.size + 1)
    fine = analog(excitation, 4 * FS, phases, fs=FS)(0, 4 * period)
    np.testing.assert_allclose(
        fine[::4], analog(excitation, FS, phases, fs=FS)(0, period), atol=1e-14
    )
    lines = np.abs(np.fft.rfft(fine))
    assert lines[period // 2 :].max() < 1e-12 * lines[1]


def test_noise_is_gaussian(noise):
    excitation, phases = noise
    u = analog(excitation, FS, phases, fs=FS)(0, 30_000) / 0.05
    # Standard errors of skewness and kurtosis of 30,000 normal values: 0.014 and 0.028.
    assert abs(np.mean(u**3)) < 5 * 0.014
    assert abs(np.mean(u**4) - 3.0) < 5 * 0.028


def test_noise_is_the_sum_of_its_lines_also_when_it_lags():
    phases = np.array([0.3, 1.1, 5.0])
    lag = 0.37 / FS
    samples = analog(Noise(0.2, 1.0, 0.0), 32 * FS, phases, fs=FS, lag=lag)(5, 300)
    t = np.arange(5, 300) / (32 * FS) - lag
    line = np.arange(1, 4)[:, None]
    waves = np.cos(2 * np.pi * line * FS / 8 * t + phases[:, None])
    np.testing.assert_allclose(samples, 0.2 * np.sqrt(2 / 3) * waves.sum(0), atol=1e-14)


def test_the_tail_of_a_noise_wraps_into_its_period():
    phases = np.array([0.3, 1.1, 5.0])
    voltage = analog(Noise(0.2, 1.0, 0.0), FS, phases, fs=FS)
    np.testing.assert_array_equal(voltage(8, 16), voltage(0, 8))


def test_tone_and_its_distortion():
    tone = Tone(5.0, 0.6, duration=1.0, settle=0.0)
    t = np.arange(64) / 64.0
    expected = 0.6 * (np.cos(10 * np.pi * t) + 1e-3 * np.cos(30 * np.pi * t))
    np.testing.assert_allclose(analog(tone, 64.0, NONE, fs=64.0, distortion=1e-3)(0, 64), expected)


def test_nothing_is_played_before_switching_on():
    u = analog(Tone(5.0, 0.6, 1.0, 0.0), FS, NONE, fs=FS, lag=2.5 / FS)(0, 6)
    np.testing.assert_array_equal(u[:3], 0.0)
    np.testing.assert_allclose(u[3:], 0.6 * np.cos(10 * np.pi * np.array([0.5, 1.5, 2.5]) / FS))


def test_sweep_is_the_stated_chirp_then_silence():
    sweep = Sweep(0.0, 40.0, 0.2, burst=8.0, fade=0.2, duration=16.0)
    u = analog(sweep, FS, NONE, fs=FS)(0, 16_384)
    t = np.arange(16_384) / FS
    full = t < 7.8
    np.testing.assert_allclose(u[full], 0.2 * np.sin(np.pi * 5.0 * t[full] ** 2), atol=1e-13)
    middle = round(7.9 * FS)  # the fade is at one half, to half a sample
    assert u[middle] == pytest.approx(0.1 * np.sin(np.pi * 5.0 * t[middle] ** 2), abs=2e-3)
    np.testing.assert_array_equal(u[t >= 8.0], 0.0)


def test_sampled_sweep_is_band_limited():
    """What lies between the samples follows from them: no cut at the end of the burst."""
    sweep = sweep_plan(0.20).excitation
    fine = analog(sweep, 32 * FS, NONE, fs=FS)(0, 32 * 16_384)
    between = 32 * np.fft.irfft(np.fft.rfft(fine[::32]), 32 * 16_384)
    # The second derivative jumps at switching on and at the fade: 3e-8 found.
    assert np.sqrt(np.mean((between - fine) ** 2) / np.mean(fine**2)) < 1e-7


def test_steps_join_without_a_jump_and_hold_whole_periods():
    steps = stepped_plan(0.05).excitation
    periods = np.array(STEPPED_HZ) * steps.dwell
    np.testing.assert_array_equal(periods, np.rint(periods))
    assert STEPPED_HZ[0] == 3.0
    assert STEPPED_HZ[-1] == 23.0
    assert np.all(np.diff(STEPPED_HZ) > 0)
    u = analog(steps, FS, NONE, fs=FS)(0, round(steps.duration * FS))
    largest = 0.05 * 2 * np.pi * 23.0 / FS  # the steepest slope times a sample
    assert np.abs(np.diff(u)).max() < 1.01 * largest


def test_steps_play_each_frequency_in_turn():
    steps = Steps((3.0, 4.0), 0.1, dwell=2.0)
    u = analog(steps, FS, NONE, fs=FS)(0, 4096)
    t = np.arange(2048) / FS
    np.testing.assert_allclose(u[:2048], 0.1 * np.cos(6 * np.pi * t), atol=1e-14)
    np.testing.assert_allclose(u[2048:], 0.1 * np.cos(8 * np.pi * t), atol=1e-14)


def test_tones_are_recorded_from_a_whole_period_on():
    for plan in LABORATORY.plans:
        if isinstance(plan.excitation, Tone):
            periods = plan.excitation.frequency_hz * plan.excitation.settle
            assert periods == round(periods)
