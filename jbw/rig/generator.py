"""The signal generator: excitations as analog voltages, as functions of continuous time.

Time runs from the moment the generator is switched on; before it the voltage is zero. A record
starts `settle` seconds later and lasts `duration` seconds.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len

Samples = NDArray[np.float64]


@dataclass(frozen=True)
class Tone:
    """A cosine excitation, A cos(2 pi f t)."""

    frequency_hz: float  # frequency f [Hz]
    level: float  # peak voltage A [V]
    duration: float  # length of the record [s]
    settle: float  # time before the record starts [s]; whole periods keep the phase

    def volts(self, t: Samples, distortion: float) -> Samples:
        """Return the voltage at times t >= 0."""
        return self.level * _wave(np.cos, 2.0 * np.pi * self.frequency_hz * t, distortion)


@dataclass(frozen=True)
class Sweep:
    """A linear sweep from rest, A sin(phi(t)), faded out to stay band-limited, then silence."""

    start_hz: float  # frequency at t = 0 [Hz]
    stop_hz: float  # frequency at the end of the burst [Hz]
    level: float  # peak voltage A [V]
    burst: float  # length of the sweep [s]
    fade: float  # length of the fade, the last part of the burst [s]
    duration: float  # length of the record, which contains burst and free decay [s]
    settle: float = 0.0  # time before the record starts [s]; zero to record from rest

    def volts(self, t: Samples, distortion: float) -> Samples:
        """Return the voltage at times t >= 0."""
        on = t < self.burst
        s = t[on]
        slope = (self.stop_hz - self.start_hz) / self.burst
        phase = 2.0 * np.pi * (self.start_hz + slope * s / 2.0) * s
        fade_out = np.minimum((self.burst - s) / self.fade, 1.0)
        u = np.zeros_like(t)
        u[on] = self.level * np.sin(np.pi / 2.0 * fade_out) ** 2 * _wave(np.sin, phase, distortion)
        return u


@dataclass(frozen=True)
class Steps:
    """A stepped sine, A cos(2 pi f (t - t_step)), with a whole number of periods per frequency."""

    frequencies_hz: tuple[float, ...]  # frequencies in sequence [Hz]
    level: float  # peak voltage A [V]
    dwell: float  # time on each frequency [s]
    settle: float = 0.0  # time before the record starts [s]; zero to record from rest

    @property
    def duration(self) -> float:
        """The length of the record [s]."""
        return self.dwell * len(self.frequencies_hz)

    def volts(self, t: Samples, distortion: float) -> Samples:
        """Return the voltage at times t >= 0."""
        step = np.minimum((t / self.dwell).astype(int), len(self.frequencies_hz) - 1)
        frequency = np.asarray(self.frequencies_hz)[step]
        phase = 2.0 * np.pi * frequency * (t - step * self.dwell)
        return self.level * _wave(np.cos, phase, distortion)


@dataclass(frozen=True)
class Noise:
    """White noise up to the Nyquist frequency: equal spectral lines with random phases."""

    level: float  # rms voltage [V]
    duration: float  # length of the record [s]
    settle: float  # time before the record starts [s]


@dataclass(frozen=True)
class Multisine:
    """A repeated multisine: harmonics in a band, with equal amplitudes and random phases."""

    level: float  # rms voltage [V]
    period: float  # period, which is a whole number of samples [s]
    low_hz: float  # lowest frequency [Hz]
    high_hz: float  # end of the band, at most half the sampling frequency [Hz]
    periods: int  # number of periods in the record
    settle: float  # time before the record starts [s]

    @property
    def duration(self) -> float:
        """The length of the record [s]."""
        return self.period * self.periods

    @property
    def lines(self) -> NDArray[np.int64]:
        """The orders of the harmonics in the band."""
        first, behind = (math.ceil(f * self.period) for f in (self.low_hz, self.high_hz))
        return np.arange(first, behind, dtype=np.int64)


Excitation = Tone | Sweep | Steps | Noise | Multisine
Voltage = Callable[[int, int], Samples]
"""voltage(i, j): volts at grid points i .. j - 1 from the moment of switching on."""


def analog(
    excitation: Excitation,
    rate: float,
    phases: Samples,
    *,
    fs: float,
    lag: float = 0.0,
    distortion: float = 0.0,
) -> Voltage:
    """Return the excitation at t_i = i / rate - lag, with a third harmonic (ratio `distortion`)."""
    if isinstance(excitation, Noise | Multisine):
        period = _period(excitation, phases, round(rate / fs), fs, lag * fs)
        return lambda i, j: period.take(np.arange(i, j), mode="wrap")

    def voltage(i: int, j: int) -> Samples:
        t = np.arange(i, j) / rate - lag
        u, on = np.zeros_like(t), t >= 0.0
        u[on] = excitation.volts(t[on], distortion)
        return u

    return voltage


def draw_phases(excitation: Excitation, rng: np.random.Generator, fs: float) -> Samples:
    """Return random phases of the lines of noise or multisine [rad]; empty for other signals."""
    if isinstance(excitation, Multisine):
        return rng.uniform(0.0, 2.0 * np.pi, excitation.lines.size)
    if not isinstance(excitation, Noise):
        return np.empty(0)
    run = excitation.settle + excitation.duration
    half_period = cast(int, next_fast_len(int(np.ceil(1.01 * run * fs / 2)), real=True))
    return rng.uniform(0.0, 2.0 * np.pi, half_period - 1)


def _period(
    excitation: Noise | Multisine, phases: Samples, factor: int, fs: float, lag_samples: float
) -> Samples:
    """Return a period of noise or multisine at `factor` points per sample, by zero padding."""
    lines, num_points = np.arange(1, phases.size + 1), 2 * (phases.size + 1)
    if isinstance(excitation, Multisine):
        lines, num_points = excitation.lines, round(excitation.period * fs)
    turn = phases - 2.0 * np.pi * lines * (lag_samples / num_points)
    spectrum = np.zeros(lines[-1] + 1, complex)
    spectrum[lines] = excitation.level / np.sqrt(2.0 * lines.size) * np.exp(1j * turn)
    return np.fft.irfft(spectrum, num_points * factor, norm="forward")


def _wave(sine: Callable[[Samples], Samples], phase: Samples, distortion: float) -> Samples:
    wave = sine(phase)
    return wave + distortion * sine(3.0 * phase) if distortion else wave
