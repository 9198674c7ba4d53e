r"""Faults of hammer tests: an exponential window, and a second blow or missing samples.

By an exponential window an analyser multiplies a record; its noise then decays too:

$$\log P(t, f) = c(f) - 2 t / \tau$$

for the noise outside the band, equally at all frequencies and up to the end of the record. At a
second blow or missing samples, a decay jumps to another state.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.signal import ShortTimeFFT
from scipy.signal.windows import blackmanharris
from scipy.special import chdtrc

from jbw.measurement.channels import Reals
from jbw.measurement.faults.fault import Fault, doubt
from jbw.measurement.faults.hypothesis import Facts, Fits, Hypothesis
from jbw.measurement.readings.decay import DecayCause, DecayFits
from jbw.measurement.spans import kept_part
from jbw.report.messages import decay_faults as messages
from jbw.report.messages.message import FaultText

SURE = 8.0  # number of standard errors by which the noise's rate of decay must exceed zero
# Smallest numbers of frames in time and of lines in frequency for the noise power over time.
FRAMES, LINES_OF_NOISE = 10, 10
APART = 3  # distance of lines that are independent under a Blackman-Harris window
# Number of groups of frequencies, in all of which windowed noise decays equally; and smallest
# number of lines in each group.
GROUPS, LEAST_OF_GROUP = 4, 5
SCATTERED = 0.67  # largest ratio of the lower quartile of the noise's lines to their median
ALIKE = 1e-3  # smallest p-value of the variation between groups and over time
# Noise that decays faster than this fraction of the mode's rate of decay is part of the mode.
OF_MODE = 0.95
# Smallest rms of noise in converter steps. With less noise, the rounding error changes with the
# motion; noise of half a step before rounding has 0.58 steps after it, whatever the motion.
CONVERTED = 0.55
PLACES = 60  # candidate places of a jump
# smallest distance of two candidate times of a jump, relative to the record's length
TIMES_APART = 0.1
LOUD = 6.0  # Only envelopes above this multiple of the noise are searched.
LEAST = 0.05  # smallest jump that is reported: of ln a and the phase [rad] combined
GREW = 0.2  # largest jump of ln a that missing samples can cause
GROWTH = (-1.5, 8.0)  # range of plausible jumps of ln a
ENDS = 0.02  # fraction of the record at either end in which a jump cannot be seen


class Window(Hypothesis):
    """The time constant of an exponential window, determined from noise outside the band."""

    name = "exponential window"

    def seen(self, fits: Fits, facts: Facts) -> Iterator[Fault]:
        """Yield a warning if the noise in a record of a decay decays too."""
        if not isinstance(fits, DecayFits):
            return
        (low, high), record, signal = facts.band_hz, facts.record, fits.signal
        outside = 1.5 * low - 0.5 * high, 1.5 * high - 0.5 * low
        rate = float(fits.fits["linear"].theta[2]) * fits.scale
        x = record.channels[record.response][round((facts.settle_s + signal.begins) * record.fs) :]
        window = window_constant(x, record.fs, outside, rate, signal.quantum * signal.unit)
        if window is not None:
            yield doubt(record.response, *messages.windowed(*window))


def window_constant(
    x: Reals, fs: float, outside_hz: tuple[float, float], decay_rate: float, quantum: float
) -> tuple[float, float] | None:
    """Return a window's time constant and its standard error [s]; None if there is no window.

    Args:
        x: Samples of the decay.
        fs: Sampling frequency [Hz].
        outside_hz: Frequencies below and above which there is only noise [Hz].
        decay_rate: Decay rate of the mode's amplitude [1/s].
        quantum: Step of the converter; 0 if none is visible.
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
    # Noise varies about its median, but the flank of a strong line is smooth. Low values show the
    # difference: the lower quartile of an exponential variable is 0.415 of its median.
    quartiles = np.array([np.log(np.quantile(group, 0.25, axis=0)) for group in groups])
    if np.mean(quartiles - logs) > np.log(SCATTERED):
        return None
    # Frames overlap by half, so that every second one is independent of the others.
    logs, time = logs[:, ::2], time[::2]
    rate, error, chance = _fall_of(logs, time, variance)
    if chance < ALIKE:
        # If there are few lines, other modes may fill more of them than a median tolerates.
        modal = int(np.argmax([group.max() for group in groups]))
        rate, error, chance = _fall_of(np.delete(logs, modal, axis=0), time, variance)
    is_sure = SURE * error <= rate <= OF_MODE * 2 * decay_rate
    if chance < ALIKE or not is_sure:
        return None
    return 2 / rate, 2 * error / rate**2


def _fall_of(
    logs: Float[np.ndarray, "group frame"], time: Reals, variance: float
) -> tuple[float, float, float]:
    """Return the rate at which log noise power falls in all groups of frequencies [1/s].

    Its standard error and the probability of its misfit follow.
    """
    centred = time - time.mean()
    spread = float(np.sum(centred**2))
    rate = -float(np.mean(logs @ centred)) / spread
    misfit = logs - logs.mean(axis=1, keepdims=True) + rate * centred
    degrees = misfit.size - len(logs) - 1
    chance = float(chdtrc(degrees, float(np.sum(misfit**2)) / variance))
    return rate, float(np.sqrt(variance / spread / len(logs))), chance


class SecondBlow(Hypothesis):
    """A jump of a decay from one state to another: time, jumps of log amplitude and phase."""

    name = "second blow"

    def causes(self, fits: Any, basis: str) -> Iterator[DecayCause]:
        """Yield jumps at the two times at which the log envelope changes most."""
        if isinstance(fits, DecayFits):
            yield from map(DecayCause, _places(fits))

    def matters(self, values: Reals, fits: Any) -> bool:
        """Return whether a jump is inside the record and changes the motion by at least 5 %."""
        place, growth, turn = values
        size = np.hypot(growth, np.angle(np.exp(1j * turn)))
        return ENDS < place < 1 - ENDS and GROWTH[0] < growth < GROWTH[1] and size > LEAST

    def fault(self, values: Reals, fits: Any, facts: Facts) -> FaultText:
        """Return the text on a jump: time, size, and a remedy that keeps one side of it."""
        place, growth, turn = values
        signal = fits.signal
        at = facts.settle_s + signal.begins + float(place) * float(signal.time[-1])
        record = facts.record
        from_jump = np.abs(np.arange(record.num_samples) / record.fs - at)
        remedy = kept_part(record, from_jump < 1 / signal.centre_hz)
        jump = float(abs(np.exp(growth + 1j * turn) - 1))
        return messages.second_blow(at, jump, remedy, grows=bool(growth > GREW))


def _places(fits: DecayFits) -> list[Reals]:
    """Return starting values of jumps, for the times at which a step best explains ln amplitude."""
    signal, linear = fits.signal, fits.fits["linear"].theta
    size, count = signal.size, len(signal.z)
    loud = np.flatnonzero(size > LOUD * max(signal.tail, 1e-4 * size.max()))
    count = int(loud[-1]) + 1 if loud.size else count
    if count <= 30:
        return []
    time, z = signal.time[:count], signal.z[:count]
    turned = z * np.exp(-1j * linear[3] * fits.scale * time)
    logs = np.log(np.abs(z) + 1e-300) + 1j * np.unwrap(np.angle(turned))
    weight = np.minimum(size[:count], size[count // 2])
    powers = np.vander(time / time[-1], 4, increasing=True)
    smooth, _ = np.linalg.qr(powers * weight[:, None])
    left = logs * weight - smooth @ (smooth.T @ (logs * weight))
    found = []
    for at in np.unique(np.linspace(0.03 * count, 0.97 * count, PLACES).astype(int)):
        step = signal.filtered_step(float(time[at]))[:count] * weight
        step = step - smooth @ (smooth.T @ step)
        power = float(step @ step)
        jump = complex(step @ left) / power if power > 1e-12 else 0j
        found.append((abs(jump) ** 2 * power, int(at), jump))
    found.sort(key=lambda row: -row[0])
    others = [row for row in found if abs(row[1] - found[0][1]) > TIMES_APART * count]
    return [
        np.array([time[at] / signal.time[-1], jump.real, jump.imag])
        for _, at, jump in found[:1] + others[:1]
    ]
