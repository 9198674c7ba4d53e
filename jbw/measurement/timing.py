"""From a time column to one sampling frequency, and the values that a rounded one must mean."""

import numpy as np
from numpy.typing import NDArray

from jbw.errors import DataError

REGULARITY = 1e-3  # of a sampling interval: the largest deviation of a sample from the even grid
LOOSEST_SNAP = 2e-5  # relative: however coarse the times are printed
SNAP = 5e-6  # relative: what six printed digits of a sampling interval lose

EVEN = "Spectra and sampled inputs need even samples."


def snapped(fs: float, uncertainty: float = 0.0) -> float:
    """The round sampling frequency that a rounded one must mean, or `fs` itself.

    A file that keeps dt = 0.000976562 s means 1024 Hz, not 1024.0005 Hz: after 16 s the two are
    8 us apart.

    Args:
        fs: Sampling frequency as found [Hz].
        uncertainty: Relative uncertainty of `fs` beyond six digits [-].

    Returns:
        The nearest multiple of 1 Hz, or of 0.1 Hz, when within the uncertainty; else `fs` [Hz].
    """
    for step in (1.0, 0.1):
        # Dividing by 10 instead of multiplying by 0.1 keeps 51.2 exactly 51.2.
        near = round(fs / step) / round(1 / step)
        if near > 0 and abs(near - fs) <= (SNAP + uncertainty) * fs:
            return near
    return fs


def sampling_frequency(time: NDArray[np.floating], name: str = "time") -> tuple[float, float]:
    r"""Sampling frequency of an even time column, snapped.

    $$f_s = \frac{N - 1}{t_{N-1} - t_0}, \qquad |t_n - t_0 - n / f_s| \le 10^{-3} / f_s + r$$

    with r the rounding of the printed or stored times.

    Args:
        time: Times of the samples [s].
        name: The channel's name, for messages.

    Returns:
        Sampling frequency and the one before snapping [Hz].

    Raises:
        DataError: Too short, not finite, not increasing, or not even.
    """
    if time.ndim != 1 or len(time) < 2:
        raise DataError(
            f"Time channel `{name}` must hold at least two samples on one axis, "
            f"but its shape is {time.shape}."
        )
    rounding = resolution(time)
    time = np.asarray(time, dtype=np.float64)
    _must_increase(time, name)
    steps = len(time) - 1
    found = steps / (time[-1] - time[0])
    fs = snapped(found, min(2 * rounding / (time[-1] - time[0]), LOOSEST_SNAP))
    _no_gaps(time, rounding, name)
    off = np.abs((time - time[0]) * fs - np.arange(steps + 1))
    if off.max() > REGULARITY + rounding * fs:
        i = int(np.argmax(off > REGULARITY))
        raise DataError(
            f"Time channel `{name}` must be even within {REGULARITY:g} of an interval at "
            f"{fs:.6g} Hz, but sample {i} is {off[i]:.3g} off and the worst {off.max():.3g}.",
            why=EVEN,
            remedy="Resample to an even grid where it was measured, or give fs instead of time.",
        )
    return fs, found


def resolution(time: NDArray[np.floating]) -> float:
    """Rounding of a time column [s]: its last bit, or its last decimal digit if that is more.

    A clock that keeps significant digits from another origin shows its rounding only in the
    intervals, late in the record; that counts up to a hundredth of an interval.
    """
    bit = float(np.spacing(np.abs(time).max()))
    time = np.asarray(time, dtype=np.float64)
    late = np.diff(time)[len(time) // 2 :]
    interval = float(time[-1] - time[0]) / (len(time) - 1)
    return max(bit, _last_digit(time, bit), min(_last_digit(late, 2 * bit), 0.01 * interval))


def _last_digit(values: NDArray[np.float64], error: float) -> float:
    """The decimal unit of which all values are multiples within their error; 0 if there is none."""
    for digits in range(3, 10):
        scaled = values * 10**digits
        if np.all(np.abs(scaled - np.round(scaled)) < 1e-6 + error * 10**digits):
            return 10.0**-digits
    return 0.0


def _must_increase(time: NDArray[np.float64], name: str) -> None:
    if not np.isfinite(time).all():
        first = int(np.flatnonzero(~np.isfinite(time))[0])
        raise DataError(f"Time channel `{name}` must be finite, but sample {first} is not.")
    backward = np.flatnonzero(np.diff(time) <= 0)
    if len(backward):
        i = int(backward[0]) + 1
        raise DataError(
            f"Time channel `{name}` must increase, but sample {i} ({time[i]:.9g} s) "
            f"follows {time[i - 1]:.9g} s.",
            why="Sorting or dropping samples silently could hide a damaged file.",
            remedy="Export the record again, or cut it there with span = [start, stop].",
        )


def _no_gaps(time: NDArray[np.float64], rounding: float, name: str) -> None:
    steps = np.diff(time)
    usual = float(np.median(steps))
    gaps = np.flatnonzero(steps - usual > max(0.5 * usual, 1.01 * rounding))
    if len(gaps):
        listed = ", ".join(f"{time[i]:.6g}-{time[i + 1]:.6g} s" for i in gaps[:5])
        raise DataError(
            f"Time channel `{name}` must be even, but has {len(gaps)} gap(s): {listed}.",
            why=EVEN,
            remedy="Keep a part without gaps with span = [start, stop], or export it again.",
        )
