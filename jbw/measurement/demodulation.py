"""The complex envelope of a free decay in a band that contains one mode."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.signal import fftconvolve, firwin, kaiser_beta, kaiserord

from jbw.errors import DataError
from jbw.measurement.channels import Complexes, Reals, whole_down

ATTENUATION = 80.0  # attenuation outside the band [dB]
# largest ratio of a record's sampling rate to half the band's width; the filter is longer by a
# factor of five
MOST_TAPS = 2**24
# smallest number of samples per period of the fastest motion in the band that a solver needs
LEAST_PER_PERIOD = 11
# smallest number of independent envelope values of a decay, each of two numbers: three unknowns and
# the noise take a quarter of them
FEWEST_VALUES = 8


@dataclass(frozen=True)
class BandFilter:
    """A linear-phase band filter that shifts the centre of its band to zero frequency."""

    # Band edges [Hz], where the gain is one half; the gain vanishes half a band width further out.
    band_hz: tuple[float, float]
    fs: float  # sampling frequency [Hz]
    taps: Reals  # impulse response of the low-pass part: an odd number of values with sum 1
    # Only every `stride`-th sample and tap is used, because the envelope is the same at less cost.
    stride: int
    step: int  # samples between two envelope values at which white noise is almost independent

    @property
    def centre_hz(self) -> float:
        """The frequency that is shifted to zero [Hz]."""
        return sum(self.band_hz) / 2

    @property
    def half(self) -> int:
        """The number of samples that the filter needs on either side of an envelope value."""
        return len(self.taps) // 2

    @property
    def step_s(self) -> float:
        """The time between two independent envelope values [s]."""
        return self.step / self.fs


def band_filter(band_hz: tuple[float, float], fs: float) -> BandFilter:
    """Compute the Kaiser filter of a band, with 80 dB attenuation.

    Raises:
        DataError: No record resolves the band at this sampling frequency.
    """
    # Independent values are spaced by 1 / B_eq, where B_eq = f_s sum h^2 / (sum h)^2 is the
    # equivalent noise bandwidth; their number then equals the degrees of freedom of white noise in
    # the band.
    half_band = (band_hz[1] - band_hz[0]) / 2
    if half_band < fs / MOST_TAPS:
        raise DataError(
            f"A band of {2 * half_band:g} Hz at a sampling frequency of {fs:g} Hz needs a filter "
            f"of more than {MOST_TAPS} samples.",
            remedy="Widen `band`, or correct `fs`.",
        )
    stride = max(1, whole_down(fs / (LEAST_PER_PERIOD * band_hz[1])))
    length, _ = kaiserord(ATTENUATION, half_band / (fs / 2))
    half = -(-length // (2 * stride)) * stride
    window: Any = ("kaiser", kaiser_beta(ATTENUATION))
    taps = np.asarray(firwin(2 * half + 1, half_band, window=window, fs=fs), dtype=np.float64)
    step = stride * max(1, round(1 / (stride * float(np.sum(taps**2)))))
    return BandFilter(band_hz, fs, taps, stride, step)


def demodulate(x: Float[np.ndarray, " time"], chosen: BandFilter) -> tuple[Reals, Complexes]:
    """Return times [s] and envelope X(t) of a band of a record x(t) = Re X(t) exp(j omega_0 t)."""
    # The envelope is a peak amplitude and exists where the filter lies inside the record. Times
    # count from the start of the record.
    if len(x) <= 2 * chosen.half:
        raise DataError(
            f"A band of {chosen.band_hz[1] - chosen.band_hz[0]:g} Hz needs a record longer than "
            f"{2 * chosen.half / chosen.fs:.3g} s, but only {len(x) / chosen.fs:.3g} s of a record "
            "remain.",
            remedy="Widen `band`, shorten `settle`, or drop the record with `exclude`.",
        )
    n = np.arange(len(x))
    carrier = np.exp(-2j * np.pi * chosen.centre_hz / chosen.fs * n)
    envelope = 2 * fftconvolve(x * carrier, chosen.taps, mode="valid")
    return n[chosen.half : len(x) - chosen.half] / chosen.fs, envelope
