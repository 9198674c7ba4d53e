"""One mode out of a free decay: its complex envelope in a band."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.signal import fftconvolve, firwin, kaiser_beta, kaiserord

from jbw.errors import DataError
from jbw.measurement.channels import Complexes, Reals, whole_down

ATTENUATION = 80.0  # dB, of what lies outside the band
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
    """Build the Kaiser filter of a band, with 80 dB attenuation.

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
    """Return times [s] and envelope X(t) of a record in a band, x(t) = Re X(t) exp(j omega_0 t)."""
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
