"""The FRF of one transient record, such as a sweep: a single segment from rest to rest."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from jbw.errors import ConfigError, DataError
from jbw.measurement.channels import channel, lines_within, passband, same_length, sampling
from jbw.measurement.spectra import FRF
from jbw.quantities import Motion, derivative_order

# If an input line is below this fraction of the largest one, the ratio of response to input is that
# of noise to noise.
DRIVEN = 1e-3


def record_frf(
    u: ArrayLike,
    y: ArrayLike,
    fs: float,
    band: tuple[float, float],
    *,
    response: Motion = "displacement",
    delay: float = 0.0,
) -> FRF:
    r"""Estimate the receptance of one record from rest to rest as the ratio $H = Y / U$.

    A sweep has no segments to average over, so that its lines do not determine their noise. The
    residual of a fit to them is mostly due to the joint and not to the sensor. The noise is taken
    as constant over the lines of the measured response per unit of input; the fit determines its
    level (`fit_modes`).

    Args:
        u: Input, shape (time,).
        y: Response, of the same shape [m, m/s or m/s^2].
        fs: Sampling frequency [Hz].
        band: Lowest and highest frequency to keep [Hz], within the swept range.
        response: Kind of `y`: displacement, velocity or acceleration.
        delay: Lag of the response channel behind the input channel [s].

    Raises:
        DataError: A sample is NaN, shapes differ, or the input does not drive a line of the band.
        ConfigError: The band contains no line.

    Examples:
        A weak sweep of the virtual rig peaks at its 18.8 Hz:

        >>> import jbw; jbw.enable_x64()
        >>> (test,) = jbw.rig.measure(tests=["sweep_0p05V"], repeats=1).tests
        >>> u, v = test.records[0].channels["input"], test.records[0].channels["velocity"]
        >>> frf = jbw.record_frf(u, v, 1024.0, band=(15.0, 22.0), response="velocity")
        >>> print(f"{frf.freq[abs(frf.h).argmax()]:.1f} Hz")
        18.8 Hz
    """
    u, y, fs = channel(u, "u"), channel(y, "y"), sampling(fs)
    same_length(u=u, y=y)
    if u.ndim != 1:
        raise DataError(f"Channel `u` must be one record, but its shape is {u.shape}.")
    freq = np.fft.rfftfreq(len(u), 1 / fs)
    low, high = passband(band, fs / 2)
    keep = (freq > 0) & lines_within(freq, (low, high))
    if not keep.any():
        raise ConfigError(
            f"Argument `band` = ({low:g}, {high:g}) Hz contains no spectral line of the record.",
            remedy="Widen `band`, or give a longer record.",
        )
    spectra: Any = [np.fft.rfft(x - x.mean()) for x in (u, y)]
    size = np.abs(spectra[0])
    if np.min(size[keep]) <= DRIVEN * np.max(size):
        raise DataError(
            f"Channel `u` must excite every line from {low:g} to {high:g} Hz, but some lines have "
            f"less than {DRIVEN:g} of the largest amplitude of `u`.",
            remedy="Narrow `band` to the swept frequencies.",
        )
    freq, (above, below) = freq[keep], (spectra[1][keep], spectra[0][keep])
    factor = (2j * np.pi * freq) ** derivative_order(response)
    h = above / below * np.exp(2j * np.pi * freq * delay) / factor
    power = 2 / (fs * len(u)) * np.abs(np.array([below, above])) ** 2
    # Only the variation over the lines matters, because noise is constant in the measured response.
    variance = np.mean(np.abs(h * factor) ** 2) / np.abs(factor) ** 2
    return FRF(
        freq=freq, h=h, coherence=np.ones_like(freq), variance=variance, input_spectrum=power[0],
        output_spectrum=power[1], num_averages=1.0, num_segments=1, num_repeats=1,
        nperseg=len(u), noverlap=0, fs=fs, window="boxcar", estimator="h1", response=response,
    )  # fmt: skip
