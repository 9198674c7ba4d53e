"""Segments of an averaged spectrum: how long, and how many averages they are worth."""

import numpy as np
from scipy import fft, signal

from jbw.errors import ConfigError, DataError

DEFAULT_SEGMENTS = 16


def effective_averages(window: str, nperseg: int, noverlap: int, num_segments: int) -> float:
    r"""Independent averages that overlapping segments are worth.

    $$K = N \Big/ \Big(1 + 2\sum_m \frac{N-m}{N}\,\rho_m^2\Big)$$

    with rho_m the window's correlation with itself m segments later.

    Args:
        window: hann or boxcar.
        nperseg: Samples in a segment.
        noverlap: Samples that neighbours share.
        num_segments: Segments N.

    Returns:
        Effective averages K.

    Reference:
        P. D. Welch, IEEE Trans. Audio Electroacoust. 15 (1967) 70-73.
    """
    w = np.asarray(signal.get_window(window, nperseg))
    step = nperseg - noverlap
    lags = np.arange(1, min(num_segments, -(-nperseg // step)))
    rho = np.array([w[m * step :] @ w[: nperseg - m * step] for m in lags]) / (w @ w)
    return float(num_segments / (1 + 2 * np.sum((num_segments - lags) / num_segments * rho**2)))


def segment_length(
    shape: tuple[int, ...],
    fs: float,
    window_s: float | None,
    nperseg: int | None,
    overlap: float,
) -> int:
    """Samples in a segment: as asked, or the longest that gives 16 segments in all.

    Args:
        shape: Shape (repeat, time) of the record.
        fs: Sampling frequency [Hz].
        window_s: Duration asked for [s], or None.
        nperseg: Samples asked for, or None.
        overlap: Shared part of neighbouring segments.

    Returns:
        Samples.

    Raises:
        ConfigError: Both were asked for.
        DataError: The record is shorter than a segment.
    """
    num_repeats, num_samples = shape
    if window_s is not None and nperseg is not None:
        raise ConfigError("Give `window_s` or `nperseg`, not both.")
    each = max(3, -(-DEFAULT_SEGMENTS // num_repeats))
    longest = int(num_samples / (each - (each - 1) * overlap))
    if window_s is not None:
        length = round(window_s * fs)
    elif nperseg is not None:
        length = int(nperseg)
    else:
        length = longest and (fft.prev_fast_len(longest, real=True) or longest)
    if not 8 <= length <= num_samples:
        raise DataError(
            f"A segment must have at least 8 samples and fit in the record, but it has {length} "
            f"({length / fs:g} s) and the record {num_samples} ({num_samples / fs:g} s).",
            remedy=f"Measure {max(length, 128) / fs:g} s or more, or shorten `window_s`.",
        )
    return length
