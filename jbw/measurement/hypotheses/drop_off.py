"""A drive that falls into its own noise at the resonance, where the structure moves by itself."""

import numpy as np
from scipy.ndimage import uniform_filter1d

from jbw.measurement.readings.sweep import SweepSignal

FALLS = 0.5  # of its median: a drive that falls by less does not drop off
NOISY = 0.05  # of the drive where it is least: its noise, from which a damping is off by percents
RANDOM = 0.3  # of its median: a drive whose size varies by more throughout is no sweep
SMOOTHED = 0.02  # of the values, over which the drive is smooth


def drop_off(signal: SweepSignal) -> tuple[float, float] | None:
    """Return the least drive over its median, and its noise over it; None where it is no drop."""
    size = np.abs(signal.u)
    width = max(int(SMOOTHED * len(size)), 5)
    smooth = uniform_filter1d(size, width, mode="nearest")
    noise = float(np.sqrt(np.mean((size - smooth)[width:-width] ** 2)))
    inner = smooth[width:-width]
    least, usual = float(inner.min()), float(np.median(inner))
    if least > FALLS * usual or not NOISY * least <= noise <= RANDOM * usual:
        return None
    return least / usual, noise / least
