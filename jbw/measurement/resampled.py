r"""Band-limited interpolation of samples of one clock to the times of another clock.

Even samples are resampled at another rate by

$$x(\tau) = \sum_n x_n\,\mathrm{sinc}(\tau - n)\,w(\tau - n)$$

with a Kaiser window w over 64 samples, which keeps frequencies below nine tenths of half the
sampling rate to about 1e-6. Beyond its ends a record continues as its mirror image through the end.
For a lower rate the kernel is wider in proportion and removes frequencies above half that rate.

Uneven samples, of a clock that jitters or pauses, are fitted by a band-limited signal

$$\min_g \sum_n \Big[x_n - \sum_k g_k\,\mathrm{sinc}(q t_n - k)\,w(q t_n - k)\Big]^2$$

in least squares. Its rate q is below three quarters of the mean rate, and below one sample per
pause. Its error is estimated on every eighth sample, by a signal fitted without these samples.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from jaxtyping import Float

from jbw.errors import DataError
from jbw.measurement.channels import Reals
from jbw.measurement.records import RESPONSES, Record
from jbw.measurement.spans import unbroken_line
from jbw.report.messages import reading as messages

REACH = 32  # number of samples on either side from which a value is interpolated
BETA = 10.0  # shape of the Kaiser window
CHUNK = 1 << 14  # number of samples that are interpolated at once
MILLION = 1e6
PASSED = 0.9  # Frequencies below this fraction of half the sampling rate are kept.
SHARE = 0.75  # rate of the signal fitted to uneven samples, divided by their mean rate
# number of values found at once, and number of values that two blocks share
BLOCK, OVERLAP = 1 << 15, 128
DAMPED = 1e-4  # weight that keeps values finite at places where no sample determines them
HELD_OUT = 8  # Every eighth sample is held out to estimate the error.
LARGEST_ERROR = 0.5  # largest error of a fitted signal, divided by its rms
# A rate is rounded to a whole number of hertz if it differs from that number by less than this
# fraction.
NEAR = 2e-3
PAUSE = 1.5  # A step of uneven times that exceeds this number of usual steps is a pause.
ABOVE = 1.05  # highest rate for resampling, as a multiple of the usual rate of uneven samples
OF_RESPONSE = (*RESPONSES, "drive_point")  # roles that the response's recorder samples


def interpolated(
    x: Float[np.ndarray, " time"], place: Float[np.ndarray, " at"], stretch: float = 1.0
) -> Reals:
    """Return the values of a sampled band-limited signal at given places, counted in samples.

    Frequencies above half of the rate over `stretch`, which is 1 or more, are removed.
    """
    reach = int(np.ceil(REACH * stretch))
    offsets = np.arange(1 - reach, reach + 1)
    # The signal is extended by its mirror image at both ends, repeatedly if necessary.
    padded = np.asarray(np.pad(x, reach, mode="reflect", reflect_type="odd"), np.float64)
    values = []
    for first in range(0, len(place), max(1, int(CHUNK / stretch))):
        at = place[first : first + max(1, int(CHUNK / stretch))]
        nearest = np.floor(at).astype(int)
        weight = _kernel(((at - nearest)[:, None] - offsets) / stretch)
        rows = padded[nearest[:, None] + offsets + reach]
        # Divide by the sum of the weights, because it is one only within the window's ripple; a
        # constant then stays unchanged.
        values.append(np.sum(weight * rows, axis=1) / np.sum(weight, axis=1))
    return np.concatenate(values) if values else np.zeros(0)


def _kernel(away: Reals) -> Reals:
    inside = np.clip(1 - (away / REACH) ** 2, 0.0, None)
    shown = np.abs(away) < REACH
    return np.sinc(away) * np.i0(BETA * np.sqrt(inside)) / np.i0(BETA) * shown


def at_rate(x: Reals, fs: float, new_fs: float) -> tuple[Reals, str]:
    """Resample even samples to an equal or lower rate; return them with a description."""
    if new_fs > fs * (1 + 2e-5):
        raise DataError(
            f"`resample` must be at most the channel's sampling frequency, {fs:.7g} Hz, but is "
            f"{new_fs:g} Hz.",
            why=f"Nothing was measured above {fs / 2:.7g} Hz, half of the sampling frequency.",
            remedy=f"Put under [[test]]: `resample = {fs:.9g}`, or less.",
        )
    size = int(np.floor((len(x) - 1) * new_fs / fs * (1 + 1e-12))) + 1
    ratio = max(fs / new_fs, 1.0)
    if len(x) < 2 * REACH * ratio:
        raise DataError(
            f"{len(x)} samples are too few to be resampled from {fs:g} to {new_fs:g} Hz.",
            remedy="Measure longer, or measure all channels at the same rate.",
        )
    y = interpolated(x, np.arange(size) * (fs / new_fs), ratio)
    lost = np.sqrt(max(0.0, 1 - np.var(y) / max(float(np.var(x)), 1e-300)))
    return y, messages.to_rate(fs, new_fs, PASSED, lost)


def from_uneven(x: Reals, time: Reals, new_fs: float, begins: float = 0.0) -> tuple[Reals, str]:
    """Resample uneven samples to an even rate; return them and a description with the error.

    Times count from the first sample in the file. `begins` is the start of the wanted span [s].
    """
    time = time - begins
    usual = 1 / float(np.median(np.diff(time)))
    if new_fs > ABOVE * usual:
        raise DataError(
            f"`resample` must be at most the usual sampling frequency, {usual:.5g} Hz, but is "
            f"{new_fs:g} Hz.",
            why=f"Nothing was measured above {usual / 2:.5g} Hz, half of the sampling frequency.",
            remedy=f"Put under [[test]]: `resample = {proposed_rate(time):.9g}`, or less.",
        )
    last = float(time[-1])
    pause = float(np.max(np.diff(time)))
    rate = _rate_through(time, new_fs)
    at = np.arange(int(np.floor(last * new_fs * (1 + 1e-12))) + 1) / new_fs
    out = np.arange(len(time)) % HELD_OUT == HELD_OUT // 2
    met = _band_limited(x[~out], time[~out], rate, time[out])
    error = float(np.std(met - x[out]) / max(float(np.std(x[out])), 1e-300))
    if not error < LARGEST_ERROR:
        raise DataError(
            f"Resampling fails: a signal below {PASSED * rate / 2:.4g} Hz, fitted without every "
            f"{HELD_OUT}th sample, differs from the omitted samples by {100 * error:.3g} % of "
            "their rms.",
            why=f"The samples are up to {1e3 * pause:.3g} ms apart, so faster parts of the signal "
            "cannot be recovered.",
            remedy=_without_pauses(time, begins),
        )
    y = _band_limited(x, time, rate, at)
    return y, messages.from_uneven(usual, new_fs, PASSED * rate / 2, error)


def _rate_through(time: Reals, new_fs: float) -> float:
    """Return the rate of the band-limited signal that uneven samples determine [Hz]."""
    mean_rate = (len(time) - 1) / float(time[-1] - time[0])
    return min(SHARE * mean_rate, 1 / float(np.max(np.diff(time))), new_fs)


def resample_line(time: Reals) -> str:
    """Return the campaign line for resampling uneven samples, with its frequency limit."""
    fs = proposed_rate(time)
    return f"`resample = {fs:.9g}`, accurate below {PASSED * _rate_through(time, fs) / 2:.3g} Hz"


def _without_pauses(time: Reals, begins: float) -> str:
    """Return the remedy for times with pauses; `begins` is the first time in the file [s]."""
    steps = np.diff(time)
    pauses = np.flatnonzero(steps > PAUSE * np.median(steps))
    line = unbroken_line(time, pauses, begins + float(time[0])) if len(pauses) else ""
    return messages.part_or_higher_rate(line) if line else messages.HIGHER_RATE


def proposed_rate(time: Reals) -> float:
    """Return the rate proposed for resampling uneven samples: their usual rate, rounded [Hz]."""
    usual = 1 / float(np.median(np.diff(time)))
    rounded = round(usual)
    return float(rounded) if abs(rounded - usual) < NEAR * usual else float(f"{usual:.3g}")


def _band_limited(x: Reals, time: Reals, rate: float, at: Reals) -> Reals:
    """Fit a band-limited signal to uneven samples; return its values at new times."""
    last = max(float(time[-1]), float(at[-1]))
    size = int(np.ceil(last * rate)) + 1
    mean, scale = float(np.mean(x)), float(np.std(x)) or 1.0
    values = np.zeros(size + 2 * REACH)
    for first, end in _blocks(size):
        low, high = (first - REACH) / rate, (end + REACH) / rate
        rows = (time >= low) & (time <= high)
        matrix = _matrix(time[rows] * rate - first + REACH, end - first + 2 * REACH)
        solved = scipy.sparse.linalg.lsmr(
            matrix, (x[rows] - mean) / scale, damp=DAMPED, atol=1e-10, btol=1e-10, maxiter=400
        )[0]
        inner = OVERLAP // 2 if first else 0
        values[first + inner : end + 2 * REACH] = solved[inner:]
    interpolants = np.concatenate([
        _matrix(at[i : i + CHUNK] * rate + REACH, len(values)) @ values
        for i in range(0, len(at), CHUNK)
    ])  # fmt: skip
    return np.asarray(mean + scale * interpolants, np.float64)


def _blocks(size: int) -> Iterator[tuple[int, int]]:
    """Yield the first and the end index of overlapping blocks of values."""
    step = BLOCK - OVERLAP
    for first in range(0, max(size - OVERLAP, 1), step):
        yield first, min(first + BLOCK, size)


def _matrix(place: Reals, size: int) -> scipy.sparse.csr_array:
    """Return the matrix that interpolates values at whole numbers (columns) at places (rows)."""
    nearest = np.floor(place).astype(int)
    columns = nearest[:, None] + np.arange(1 - REACH, REACH + 1)
    inside = (columns >= 0) & (columns < size)
    weight = np.where(inside, _kernel(place[:, None] - columns), 0.0)
    rows = np.broadcast_to(np.arange(len(place))[:, None], columns.shape)
    picked = (weight[inside], (rows[inside], columns[inside]))
    return scipy.sparse.csr_array(picked, shape=(len(place), size))


def on_one_clock(record: Record, clock_ppm: float) -> Record:
    r"""Resample responses from a clock that runs fast to the clock of the drive.

    Sample n of the fast clock was taken at $n / (1 + \epsilon)$ of the other clock. Samples of one
    channel beyond the end of the other are cut off.

    Args:
        record: A record with a response and a source.
        clock_ppm: Parts per million by which the response's clock is fast; negative if slow.
    """
    if not clock_ppm:
        return record
    ratio = 1 + clock_ppm / MILLION
    num_samples = min(record.num_samples, int(np.floor((record.num_samples - 1) / ratio)) + 1)
    place = np.arange(num_samples) * ratio
    channels = {
        role: interpolated(x, place) if role in OF_RESPONSE else x[:num_samples]
        for role, x in record.channels.items()
    }
    how = messages.response_clock(clock_ppm)
    return replace(record, channels=channels, provenance={**record.provenance, "clock": how})
