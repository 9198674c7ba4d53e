r"""An exponential window: the noise of a record decays along all of it.

Noise is read above the band, by the median of its modulus in 16 parts of the record; it decays as
$e^{-t/\tau}$ under a window, and stays without one.
"""

import numpy as np
from scipy.signal import fftconvolve, firwin

from jbw.measurement.channels import Reals
from jbw.measurement.readings.slow_flow import converter_step

PARTS = 16
ABOVE = 3.2  # times the mode's frequency: above it there is noise
LINES = (0.01, 0.15)  # this share of lines holds that share of noise: more is a mode
FALL = 0.7  # of ln along the record, at the least
SURE = 8.0  # standard errors
STRAIGHT = (0.6, 1.7)  # of the fall in the second half over that in the first


def window_constant(x: Reals, fs: float, hz: float) -> tuple[float, float] | None:
    """Return the time constant of a window and its standard error [s]; None where there is none.

    Args:
        x: Samples of the whole record.
        fs: Sampling frequency [Hz].
        hz: Frequency of the mode [Hz].
    """
    edge = min(ABOVE * hz, 0.42 * fs) if ABOVE * hz < 0.4 * fs else 0.38 * fs
    noise = fftconvolve(x - np.median(x), firwin(65, edge, pass_zero=False, fs=fs), "valid")
    if len(noise) < 40 * PARTS:
        return None
    lines = np.sort(np.abs(np.fft.rfft(noise)) ** 2)
    if lines[-max(int(len(lines) * LINES[0]), 1) :].sum() > LINES[1] * lines.sum():
        return None
    size = np.array([np.median(np.abs(part)) for part in np.array_split(noise, PARTS)])
    if size[-4:].min() < max(0.6 * converter_step(x), 1e-13 * np.abs(x).max()):
        return None
    time, logs = np.arange(PARTS)[3:], np.log(size[3:])
    slope, level = np.polyfit(time, logs, 1)
    spread = np.sqrt(np.sum((time - time.mean()) ** 2))
    error = float(np.std(logs - slope * time - level, ddof=2) / spread)
    ends = [-np.polyfit(time[part], logs[part], 1)[0] for part in (slice(6), slice(-6, None))]
    is_straight = STRAIGHT[0] < ends[1] / ends[0] < STRAIGHT[1]
    if -slope * len(time) < FALL or -slope < SURE * error or not is_straight:
        return None
    part_s = len(x) / fs / PARTS
    tau = part_s / -slope
    return float(tau), float(tau * error / -slope)
