r"""Removal of steady lines from a free decay, such as mains hum or a machine nearby.

$$x(t) = \sum_i A_i \cos(2\pi f_i t + \varphi_i)
  + B\,e^{-\sigma t} \cos(2\pi f_0 t + \beta) + e(t)$$

is fitted by least squares to the last half of a record, where the decay is weakest, under a Hann
window, which suppresses other modes. Amplitudes and phases follow by linear algebra for every f_i,
f_0 and sigma. The fitted lines are subtracted from the whole record.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from jbw.errors import DataError
from jbw.measurement.channels import Reals
from jbw.report.messages import reading as messages

PERIODS = 8.0  # smallest number of periods of a line in half a record; fewer are a drift
STATED = 1.0  # largest error of a stated frequency, in lines of the spectrum of half a record
KNOWN = 0.3  # largest extrapolated error of a line, divided by its amplitude
FINER = 8  # number of spectrum values per line, for the starting values of the mode


class SteadyLine(NamedTuple):
    """A removed line: its frequency, its amplitude, and the error of its removal.

    Attributes:
        hz: Frequency [Hz].
        amplitude: Peak amplitude, in the unit of the samples.
        error: Standard error of the line at the end of the record where it is least certain.
    """

    hz: float
    amplitude: float
    error: float


def without_lines(
    x: Float[np.ndarray, " time"], fs: float, lines_hz: Sequence[float]
) -> tuple[Reals, tuple[SteadyLine, ...]]:
    """Subtract steady lines near stated frequencies; return the samples and the fitted lines.

    Args:
        x: Response in a free decay.
        fs: Sampling frequency [Hz].
        lines_hz: Frequencies [Hz], each accurate to a line of the half record's spectrum,
            2 fs / len(x).

    Raises:
        DataError: A line is too slow for the record, above fs / 2, or not larger than its error.
    """
    first = len(x) // 2
    part = x[first:] - np.mean(x[first:])
    resolution = fs / max(len(part), 1)
    for hz in lines_hz:
        if not PERIODS * resolution <= hz < fs / 2:
            raise DataError(
                f"a line of `lines_hz` must lie between {PERIODS * resolution:.4g} and "
                f"{fs / 2:.4g} Hz in a record of {len(x) / fs:.4g} s, but is {hz:g} Hz.",
                remedy=f"Leave {hz:g} Hz out of `lines_hz`, or give a longer record.",
            )
    time: Reals = np.asarray((np.arange(len(part)) - (len(part) - 1) / 2) / fs, np.float64)
    weight = np.hanning(len(part) + 2)[1:-1]
    start = [*lines_hz, *_mode_of(x[:first], fs, lines_hz, resolution)]

    def design(values: Reals) -> Float[np.ndarray, "time column"]:
        *lines, mode, rate = values
        columns = [wave(2 * np.pi * hz * time) for hz in lines for wave in (np.cos, np.sin)]
        # The decay is scaled to its first sample, so that no rate makes it large.
        decay = np.exp(-rate * (time - time[0]))
        columns += [decay * wave(2 * np.pi * mode * time) for wave in (np.cos, np.sin)]
        return np.stack(columns, axis=1)

    def residual(steps: Reals) -> Reals:
        columns = weight[:, None] * design(start + resolution * steps)
        amplitudes = np.linalg.lstsq(columns, weight * part)[0]
        return weight * part - columns @ amplitudes

    num = len(lines_hz)
    limits = np.array([STATED] * num + [STATED, np.inf])
    lowest = np.array([-STATED] * (num + 1) + [-start[-1] / resolution])
    solution = least_squares(residual, np.zeros(num + 2), bounds=(lowest, limits), x_scale=0.1)
    values = np.array(start + resolution * solution.x)
    columns = design(values)
    amplitudes = np.linalg.lstsq(weight[:, None] * columns, weight * part)[0]
    fitted = _WeightedPart(columns, part, weight, time)
    lines = _with_errors(values[:num], amplitudes, fitted, len(x) / fs)
    whole_time = (np.arange(len(x)) - first - (len(part) - 1) / 2) / fs
    removed = np.zeros(len(x))
    for line, (a, b) in zip(lines, amplitudes.reshape(-1, 2), strict=False):
        if line.error > KNOWN * line.amplitude:
            raise DataError(
                f"the line of `lines_hz` at {line.hz:.5g} Hz is not significant: its amplitude is "
                f"{line.amplitude:.3g}, with a standard error of {line.error:.2g} over the record.",
                remedy=f"Remove {line.hz:.5g} from `lines_hz`, or correct the frequency.",
            )
        turn = 2 * np.pi * line.hz * whole_time
        removed += a * np.cos(turn) + b * np.sin(turn)
    return x - removed, lines


def lines_removed(lines: Sequence[SteadyLine]) -> str:
    """Describe the removed lines in words: frequency, amplitude and error of each."""
    return ", ".join(messages.removed_line(line.hz, line.amplitude, line.error) for line in lines)


def _mode_of(x: Reals, fs: float, lines_hz: Sequence[float], resolution: float) -> list[float]:
    """Return starting values for the strongest decaying mode: frequency [Hz] and rate [1/s]."""
    size = np.abs(np.fft.rfft((x - np.mean(x)) * np.hanning(len(x)), FINER * len(x)))
    freq = np.fft.rfftfreq(FINER * len(x), 1 / fs)
    size[freq < PERIODS * resolution] = 0
    for hz in lines_hz:
        size[np.abs(freq - hz) < resolution] = 0
    # The rate is that between the first and the second quarter of the record.
    quarter = len(x) // 2
    fall = np.std(x[:quarter]) / max(float(np.std(x[quarter:])), 1e-300)
    rate = max(np.log(max(fall, 1.0)) * fs / max(quarter, 1), resolution)
    return [float(freq[np.argmax(size)]), float(rate)]


class _WeightedPart(NamedTuple):
    """One part of a record, and the columns with which lines and a decay are fitted to the part."""

    columns: Float[np.ndarray, "time column"]
    part: Reals
    weight: Reals
    time: Reals  # times from the middle of this part [s]


def _with_errors(
    lines_hz: Reals, amplitudes: Reals, fitted: _WeightedPart, length_s: float
) -> tuple[SteadyLine, ...]:
    """Return the fitted lines with the errors of the removal, from the residual of the fit."""
    columns, part, weight, time = fitted
    scatter = part - columns @ amplitudes
    variance = float(np.sum((weight * scatter) ** 2) / np.sum(weight**2))
    slopes = [
        2 * np.pi * time * (b * columns[:, 2 * i] - a * columns[:, 2 * i + 1])
        for i, (a, b) in enumerate(amplitudes[: 2 * len(lines_hz)].reshape(-1, 2))
    ]
    jacobian = np.column_stack([columns, *slopes])
    size = np.linalg.norm(jacobian, axis=0)
    weighed = (weight**2)[:, None] * jacobian / size
    normal = np.linalg.pinv(weighed.T @ jacobian / size)
    # Use the sandwich covariance, because the weights do not match the white noise.
    covariance = variance * normal @ (weighed.T @ weighed) @ normal / np.outer(size, size)
    furthest = length_s - time[-1]  # distance of the part's middle from the record's start
    lines = []
    for i, (a, b) in enumerate(amplitudes[: 2 * len(lines_hz)].reshape(-1, 2)):
        chosen = [2 * i, 2 * i + 1, len(amplitudes) + i]
        # The errors of amplitude and phase are combined at the end of the record that is furthest
        # from the fitted part, for the worst phase.
        peak = float(np.hypot(a, b))
        along = np.array([a, b, 0.0]) / max(peak, 1e-300)
        across = np.array([-b, a, 0.0]) / max(peak, 1e-300)
        across[2] = 2 * np.pi * furthest * peak
        of_line = covariance[np.ix_(chosen, chosen)]
        error = float(np.sqrt(max(along @ of_line @ along, across @ of_line @ across)))
        lines.append(SteadyLine(float(lines_hz[i]), peak, error))
    return tuple(lines)
