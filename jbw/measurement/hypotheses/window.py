r"""An exponential window: a record was multiplied by exp(-t / tau), so that its noise decays too.

$$\log P(t, f) = c(f) - 2 t / \tau$$

of the noise outside the band, alike at all frequencies and to the record's end.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.signal import ShortTimeFFT
from scipy.signal.windows import blackmanharris
from scipy.special import chdtrc

from jbw.measurement.channels import Reals

SURE = 8.0  # standard errors of the fall
FRAMES, LINES_OF_NOISE = 10, 10  # in time and in frequency, at the least, for the noise's course
APART = 3  # lines between two that a Blackman-Harris window leaves independent
GROUPS, LEAST_OF_GROUP = 4, 5  # of frequencies, in which noise under a window falls alike; of lines
SCATTERED = 0.67  # lower quartile of the noise's lines over their median, at the most
ALIKE = 1e-3  # probability of the scatter between them and along time, at the least
OF_MODE = 0.95  # of the mode's own decay: noise that falls faster is its skirt
CONVERTED = 0.35  # of a converter step: rms of noise below which samples show steps, not noise


def window_constant(
    x: Reals, fs: float, outside_hz: tuple[float, float], decay_rate: float, quantum: float
) -> tuple[float, float] | None:
    """Return the time constant of a window and its standard error [s]; None where there is none.

    Args:
        x: Samples of the decay.
        fs: Sampling frequency [Hz].
        outside_hz: Below and above these there is noise alone [Hz].
        decay_rate: Of the mode's amplitude [1/s].
        quantum: Step of the converter, 0 where none shows.
    """
    size = len(x) // (2 * FRAMES)
    if size < LINES_OF_NOISE:
        return None
    window = blackmanharris(2 * size, sym=False)
    transform = ShortTimeFFT(window, size, fs)
    spectra = np.abs(transform.stft(x - np.mean(x))) ** 2
    complete = slice(transform.lower_border_end[1], transform.upper_border_begin(len(x))[1])
    spectra, time = spectra[:, complete], transform.t(len(x))[complete]
    low, high = outside_hz
    outside = (transform.f < low) | (transform.f > high)
    spectra = spectra[outside][1:-1:APART]
    if len(spectra) < LINES_OF_NOISE or spectra.shape[1] < FRAMES // 2 or not spectra.min() > 0:
        return None
    quietest = np.median(spectra, axis=0).min() / np.log(2) / np.sum(window**2)
    if np.sqrt(quietest) < CONVERTED * quantum:
        return None
    groups = np.array_split(spectra, min(GROUPS, len(spectra) // LEAST_OF_GROUP))
    logs = np.array([np.log(np.median(group, axis=0)) for group in groups])
    count = len(spectra) // len(groups)
    # The median of n exponential variables has the relative variance 1 / (n ln^2 2).
    variance = 1 / (count * np.log(2) ** 2)
    # Noise scatters about its median; the skirt of a strong line is smooth. Low values tell:
    # the lower quartile of an exponential variable is 0.415 of its median.
    quartiles = np.array([np.log(np.quantile(group, 0.25, axis=0)) for group in groups])
    if np.mean(quartiles - logs) > np.log(SCATTERED):
        return None
    # Frames overlap by half: every second is independent.
    logs, time = logs[:, ::2], time[::2]
    fall = _fall_of(logs, time, variance)
    if fall.unlike < ALIKE:
        # Of few lines those that other modes stand in are more than a median passes over.
        modal = int(np.argmax([group.max() for group in groups]))
        fall = _fall_of(np.delete(logs, modal, axis=0), time, variance)
    is_sure = SURE * fall.error <= fall.rate <= OF_MODE * 2 * decay_rate
    if fall.unlike < ALIKE or not is_sure:
        return None
    return 2 / fall.rate, 2 * fall.error / fall.rate**2


class _Fall(NamedTuple):
    """Fall of log P [1/s], its standard error, and how likely its misfit is by chance."""

    rate: float
    error: float
    unlike: float


def _fall_of(logs: Float[np.ndarray, "group frame"], time: Reals, variance: float) -> _Fall:
    """Return the one fall of all groups, whose values have a variance."""
    centred = time - time.mean()
    spread = float(np.sum(centred**2))
    rate = -float(np.mean(logs @ centred)) / spread
    misfit = logs - logs.mean(axis=1, keepdims=True) + rate * centred
    degrees = misfit.size - len(logs) - 1
    unlike = float(chdtrc(degrees, float(np.sum(misfit**2)) / variance))
    return _Fall(rate, float(np.sqrt(variance / spread / len(logs))), unlike)
