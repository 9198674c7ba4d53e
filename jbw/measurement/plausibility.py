"""Whether a record of broad-band excitation can be what its campaign file says it is."""

import numpy as np
import scipy.signal
from numpy.typing import NDArray

from jbw.measurement.checks import Finding
from jbw.measurement.records import INPUTS, Record

SEGMENTS = 8  # of the Welch estimates: coarse, but a resonance still stands out
FLOOR = 1e-4  # of the largest density: lines below it are outside the excitation
PEAKED = 10.0  # times more peaked than the response: an input that looks like a response


def doubts(record: Record, band_hz: tuple[float, float] | None) -> tuple[Finding, ...]:
    """Warnings about a record under broad-band excitation: wrong fs, or channels swapped.

    Args:
        record: A noise or multisine record.
        band_hz: Where the campaign file says that the resonance is [Hz].
    """
    freq, response = _density(record, record.response)
    found = [_outside_band(record.response, freq, response, band_hz)]
    source = next((role for role in INPUTS if role in record.channels), None)
    if source:
        found.append(_swapped(source, _density(record, source)[1], response))
    return tuple(finding for finding in found if finding)


def _density(record: Record, role: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    x = record.channels[role]
    length = max(len(x) // SEGMENTS, 2)
    freq, density = scipy.signal.welch(x, record.fs, nperseg=length, detrend="constant")
    return freq[1:], density[1:]


def _outside_band(
    role: str,
    freq: NDArray[np.float64],
    density: NDArray[np.float64],
    band_hz: tuple[float, float] | None,
) -> Finding | None:
    peak = float(freq[density.argmax()])
    if band_hz is None or band_hz[0] <= peak <= band_hz[1]:
        return None
    centre = sum(band_hz) / 2
    return Finding(
        "warning",
        role,
        f"The response is largest at {peak:.4g} Hz, outside `band` = [{band_hz[0]:g}, "
        f"{band_hz[1]:g}] Hz: {peak / centre:.3g} times its centre.",
        "A factor of 6.28 means rad/s, 2 half the sampling frequency, 1.024 rounded 1000 Hz.",
        "Check fs and band.",
    )


def _swapped(
    source: str, force: NDArray[np.float64], response: NDArray[np.float64]
) -> Finding | None:
    excited = (force > FLOOR * force.max()) & (response > FLOOR * response.max())
    if excited.sum() < SEGMENTS:
        return None
    sharp = [float(x[excited].max() / np.median(x[excited])) for x in (force, response)]
    if sharp[0] < PEAKED * sharp[1]:
        return None
    return Finding(
        "warning",
        source,
        f"The input's spectrum is {sharp[0] / sharp[1]:.3g} times more peaked than the response's.",
        "That is how the FRF looks when input and response are swapped.",
        "Check which channel is which.",
    )
