"""One mode out of a free decay: its complex envelope in a band, its frequency and damping."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Complex, Float
from scipy.signal import fftconvolve, firwin, kaiser_beta, kaiserord

from jbw.errors import DataError
from jbw.measurement.channels import Complexes, Reals, whole_down

ATTENUATION = 80.0  # dB, of what lies outside the band
WINDOW = 0.25  # of the time constant of a decay: a reading's window, over which it falls by a fifth
LEAST_VALUES = 5  # of a window: a parabola has three
FEWEST = 5  # readings of a decay so slow that its time constant would leave fewer
MISSED = 0.5  # of the response in a window: noise alone leaves more
DECADE = 10.0  # the part of a decay that its time constant is read from
MOST_TAPS = 2**24  # samples over those of half a band: its filter is five times as long
LEAST_PER_PERIOD = 11  # samples of the fastest motion in the band that a solver is given


@dataclass(frozen=True)
class BandFilter:
    """A linear-phase filter that moves a band about its centre to zero frequency."""

    band_hz: tuple[float, float]  # where its gain is one half [Hz]; gone half a band further out
    fs: float  # sampling frequency [Hz]
    taps: Reals  # impulse response of the low-pass part; an odd number, sum 1
    stride: int  # every so-many-th sample and tap give the same envelope, for a cheaper model
    step: int  # samples between two envelope values that white noise leaves almost independent

    @property
    def centre_hz(self) -> float:
        """Frequency that becomes zero [Hz]."""
        return sum(self.band_hz) / 2

    @property
    def half(self) -> int:
        """Samples on either side of the middle tap: what the filter needs around a value."""
        return len(self.taps) // 2

    @property
    def step_s(self) -> float:
        """Time between two envelope values [s]."""
        return self.step / self.fs


def band_filter(band_hz: tuple[float, float], fs: float) -> BandFilter:
    """Design the Kaiser filter of a band, of 80 dB.

    Raises:
        DataError: A band that no record resolves at such a sampling frequency.
    """
    # Values are taken apart by 1 / B_eq, B_eq = f_s sum h^2 / (sum h)^2, the equivalent noise
    # bandwidth: there are as many of them as white noise has degrees of freedom in the band.
    half_band = (band_hz[1] - band_hz[0]) / 2
    if half_band < fs / MOST_TAPS:
        raise DataError(
            f"A band of {2 * half_band:g} Hz at a sampling frequency of {fs:g} Hz takes a record "
            f"of more than {MOST_TAPS} samples.",
            remedy="Correct `fs` or `band`.",
        )
    stride = max(1, whole_down(fs / (LEAST_PER_PERIOD * band_hz[1])))
    length, _ = kaiserord(ATTENUATION, half_band / (fs / 2))
    half = -(-length // (2 * stride)) * stride
    window: Any = ("kaiser", kaiser_beta(ATTENUATION))
    taps = np.asarray(firwin(2 * half + 1, half_band, window=window, fs=fs), dtype=np.float64)
    step = stride * max(1, round(1 / (stride * float(np.sum(taps**2)))))
    return BandFilter(band_hz, fs, taps, stride, step)


def demodulate(x: Float[np.ndarray, " time"], chosen: BandFilter) -> tuple[Reals, Complexes]:
    """Times [s] and envelope X(t), x(t) = Re X(t) exp(j omega_0 t), of a record in a band."""
    # Peak amplitudes, where the filter lies wholly inside the record; time counts from its start.
    if len(x) <= 2 * chosen.half:
        raise DataError(
            f"A band of {chosen.band_hz[1] - chosen.band_hz[0]:g} Hz takes a record longer than "
            f"{2 * chosen.half / chosen.fs:.3g} s, but {len(x) / chosen.fs:.3g} s are left of one.",
            remedy="Widen `band`, shorten `settle`, or drop the record with `exclude`.",
        )
    n = np.arange(len(x))
    carrier = np.exp(-2j * np.pi * chosen.centre_hz / chosen.fs * n)
    envelope = 2 * fftconvolve(x * carrier, chosen.taps, mode="valid")
    return n[chosen.half : len(x) - chosen.half] / chosen.fs, envelope


@dataclass(frozen=True)
class DecayReading:
    """Frequency and damping along a decay, read without any model of the joint."""

    amplitude: Reals  # peak amplitude, in the unit of the response
    frequency_hz: Reals  # instantaneous frequency [Hz]
    damping: Reals  # decay rate over angular frequency [-]


def read_decay(
    envelope: Complex[np.ndarray, " time"],
    step_s: float,
    centre_hz: float,
    window_s: float | None = None,
) -> DecayReading:
    r"""Frequency and damping along a decay, from parabolas through the logarithm of its envelope.

    $$\frac{d}{dt} \log X = -\zeta\omega + j (\omega - \omega_0)$$

    in windows that do not overlap, of a quarter of the decay's own time constant unless stated:
    decays that differ by their scale of time alone have the same readings. A window whose damping
    is not positive, or in which the parabola misses half of the response, holds no reading.

    Args:
        envelope: X about the centre, values `step_s` apart.
        step_s: Time between two values [s].
        centre_hz: Frequency that became zero [Hz].
        window_s: Length of a window [s].
    """
    log = np.log(np.abs(envelope)) + 1j * np.unwrap(np.angle(envelope))
    steps = WINDOW * decay_steps(log.real) if window_s is None else window_s / step_s
    # No window so long that fewer than FEWEST readings are left, where the record allows that.
    longest = max(LEAST_VALUES, len(log) // FEWEST)
    size = min(len(log), max(LEAST_VALUES, round(min(steps, longest))))
    x = np.arange(size) - (size - 1) / 2
    powers = np.vander(x, 3, increasing=True)
    pieces = log[: len(log) // size * size].reshape(-1, size)
    fitted = np.linalg.pinv(powers) @ pieces.T
    level, slope, _ = fitted
    omega = 2 * np.pi * centre_hz + slope.imag / step_s
    damping = -slope.real / step_s / omega
    missed = np.linalg.norm(np.exp(pieces) - np.exp((powers @ fitted).T), axis=1)
    is_reading = (damping > 0) & (missed < MISSED * np.linalg.norm(np.exp(pieces), axis=1))
    reading = np.exp(level.real), omega / (2 * np.pi), damping
    return DecayReading(*(values[is_reading] for values in reading))


def decay_steps(log_size: Float[np.ndarray, " time"]) -> float:
    """Steps in which a decay falls by a factor of e, on average over its first decade.

    By the straight line through the logarithm of its size from the largest value on; infinite
    where it does not fall.
    """
    start = int(np.argmax(log_size))
    low = np.flatnonzero(log_size[start:] < log_size[start] - np.log(DECADE))
    fall = log_size[start : start + max(int(low[0]), LEAST_VALUES) if low.size else len(log_size)]
    if len(fall) < 2:
        return np.inf
    rate = -np.polyfit(np.arange(len(fall)), fall, 1)[0]
    return float(1 / rate) if rate > 0 else np.inf
