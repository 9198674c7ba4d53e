"""Checks and conversions of channels (arrays of floats), used by all estimators."""

from collections.abc import Sequence
from math import comb

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jbw.errors import ConfigError, DataError

Reals = NDArray[np.float64]
Complexes = NDArray[np.complex128]
# This tolerance is relative, so that it has the same effect in every unit of time. A spectral line
# on the edge of a band counts as inside, and an almost whole number of samples counts as whole.
ROUNDING = 1e-9
# order of the differences; these retain 0.8 % of a sine with eight samples per period
DIFFERENCES = 6
OF_NORMAL = 0.6745  # median of the absolute value of a standard normal variable
# Two records count as equally strong if the ratio of their strengths is smaller than this.
ALIKE = 1.2


def channel(x: ArrayLike, name: str) -> Reals:
    """Return samples as finite float64 of shape (time,) or (repeat, time), or raise a DataError."""
    try:
        samples = np.asarray(x)
        if np.iscomplexobj(samples):
            raise TypeError
        samples = samples.astype(np.float64)
    except (TypeError, ValueError):
        raise DataError(f"Channel `{name}` must contain real numbers.") from None
    if samples.ndim not in (1, 2) or samples.size == 0:
        raise DataError(
            f"Channel `{name}` must have the shape (time,) or (repeat, time), "
            f"but its shape is {samples.shape}."
        )
    bad = ~np.isfinite(samples)
    if bad.any():
        first = tuple(int(i) for i in np.argwhere(bad)[0])
        where = first[0] if len(first) == 1 else first
        raise DataError(
            f"Channel `{name}` must be finite, but {int(bad.sum())} of {samples.size} samples are "
            f"NaN or infinite; the first is sample {where}.",
            why="A Fourier transform of the record would spread one bad sample over every "
            "frequency.",
            remedy="Use the part of the record that is whole, or repair the file.",
        )
    return samples


def same_length(**channels: Reals) -> None:
    """Raise a DataError if the named channels differ in shape."""
    (name, x), *others = channels.items()
    for other, y in others:
        if y.shape != x.shape:
            raise DataError(
                f"Channels `{name}` and `{other}` must have one shape, "
                f"but their shapes are {x.shape} and {y.shape}.",
                why="Samples are paired by their index; nothing is cut silently.",
                remedy="Cut both channels to the samples that both contain.",
            )


def noise_of(x: Reals) -> float:
    r"""Estimate the standard deviation of a signal's white noise from its sixth differences.

    $$\frac{\mathrm{med}\,|\Delta^6 x|}{0.6745 \sqrt{\sum_k \binom 6 k^2}}$$

    A smooth signal hardly adds to the differences, and corners or jumps are too few to move the
    median.
    """
    if len(x) <= DIFFERENCES:
        return 0.0
    # The squares of binomial coefficients sum to one coefficient (Vandermonde's identity).
    size = np.sqrt(comb(2 * DIFFERENCES, DIFFERENCES))
    return float(np.median(np.abs(np.diff(x, DIFFERENCES))) / (OF_NORMAL * size))


def sampling(fs: float) -> float:
    """Return the sampling frequency [Hz] as a float; raise a ConfigError unless it is positive."""
    if not (np.isfinite(fs) and fs > 0):
        raise ConfigError(f"Argument `fs` must be positive [Hz], but it is {fs}.")
    return float(fs)


def lines_within(freq: Reals, band: Sequence[float]) -> NDArray[np.bool_]:
    """Return a mask of the spectral lines in a band, including the edges; units must be equal."""
    low, high = band
    return (freq >= low * (1 - ROUNDING)) & (freq <= high * (1 + ROUNDING))


def whole_down(number: float) -> int:
    """Round a number down; do not round a number that is whole except for round-off."""
    return int(np.floor(number + ROUNDING * abs(number)))


def whole_up(number: float) -> int:
    """Round a number up; do not round a number that is whole except for round-off."""
    return int(np.ceil(number - ROUNDING * abs(number)))


def passband(band: tuple[float, float], nyquist: float) -> tuple[float, float]:
    """Return a band's edges [Hz]; raise a ConfigError if it is empty, reversed or above Nyquist."""
    low, high = (float(edge) for edge in band)
    if not 0 <= low < high or low >= nyquist:
        raise ConfigError(
            f"Argument `band` must be an increasing pair between 0 and {nyquist:g} Hz, "
            f"but it is ({low:g}, {high:g}).",
            remedy="Give `band` as (lowest, highest) in hertz, not in rad/s.",
        )
    return low, high


def rms(values: ArrayLike) -> float:
    """Return the root mean square of values; NaN if there are none."""
    squares = np.square(values)
    return float(np.sqrt(np.mean(squares))) if squares.size else float("nan")


def strength_ranks(sizes: Sequence[float]) -> NDArray[np.int64]:
    """Rank strengths from 0 for the largest; nearly equal strengths get the same rank."""
    values = np.asarray(sizes, float)
    falling = np.argsort(-values, kind="stable")
    is_weaker = values[falling][1:] < values[falling][:-1] / ALIKE
    ranks = np.empty(len(values), np.int64)
    ranks[falling] = np.concatenate([[0], np.cumsum(is_weaker)])
    return ranks
