"""What kind of test samples are, by the samples themselves: a tone, noise, a sweep or a decay."""

from typing import Literal

import numpy as np

from jbw.measurement.channels import Reals

PARTS = 16  # of a record, each with a spectrum of its own
LEAST = 64  # samples of a part
ONE_LINE = 0.9  # of a part's power about its strongest line, of a tone
NO_LINE = 0.35  # of it, below which there is no line: of noise
STEADY = 1.2  # largest over smallest part of a steady tone, after the first quarter
FALLS = 0.5  # last quarter over the strongest, of a decay
MOVES = 3  # lines that the strongest one moves by, at least, in a sweep


def course_of(x: Reals) -> Literal["tones", "noise", "sweep"] | None:
    """What a source plays: one steady tone, noise, or a line that moves; None where unclear."""
    x = x[np.isfinite(x)]
    size = len(x) // PARTS
    if size < LEAST or not np.ptp(x):
        return None
    parts = x[: size * PARTS].reshape(PARTS, size)
    parts = parts - parts.mean(axis=1, keepdims=True)
    power = np.abs(np.fft.rfft(parts * np.hanning(size), axis=1)) ** 2
    heard = power.sum(axis=1) > 1e-4 * power.sum(axis=1).max()
    peaks = power.argmax(axis=1)
    line_power = [row[max(at - 2, 0) : at + 3].sum() for row, at in zip(power, peaks, strict=True)]
    share = np.array(line_power)[heard] / power.sum(axis=1)[heard]
    if np.median(share) < NO_LINE:
        return "noise"
    line_bins = peaks[heard]
    rms = parts.std(axis=1)[PARTS // 4 :]
    if np.all(share > ONE_LINE) and np.ptp(line_bins) <= 1 and rms.max() < STEADY * rms.min():
        return "tones"
    steps = np.diff(line_bins)
    one_way = max(np.sum(steps >= 0), np.sum(steps <= 0)) >= 0.8 * len(steps)
    return "sweep" if np.ptp(line_bins) >= MOVES and one_way else None


def falls(x: Reals) -> bool:
    """Whether samples fall as those of a free decay do: the last quarter to half of the largest."""
    x = x[np.isfinite(x)]
    if len(x) < 8:
        return False
    x = x - x.mean()
    rms = [float(part.std()) for part in np.array_split(x, 4)]
    return rms[-1] < FALLS * max(rms)


def strongest_line(x: Reals, fs: float) -> float:
    r"""Frequency of the strongest line [Hz], by the parabola through its logarithms.

    $$f = \frac{f_s}{N}\Bigl(k + \frac{a - c}{2 (a - 2b + c)}\Bigr)$$

    with a, b, c the logarithms of the lines k - 1, k, k + 1 under a Hann window.
    """
    x = x[np.isfinite(x)]
    size = np.abs(np.fft.rfft((x - x.mean()) * np.hanning(len(x))))
    k = 1 + int(np.argmax(size[1:-1]))
    a, b, c = np.log(np.maximum(size[k - 1 : k + 2], 1e-300))
    return float(fs / len(x) * (k + 0.5 * (a - c) / (a - 2.0 * b + c)))
