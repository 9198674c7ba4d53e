r"""What repeats allow one to see: how far they scatter, and whether as noise or as another joint.

$$d_k = \bar d + a_k\,\bar d + b_k\,\dot{\bar d} + c_k\,t\,\dot{\bar d} + e_k$$

A gain that moves, a trigger that comes late and a natural frequency that shifts each change a
record along one of three directions; what is left is noise. Where the directions explain more than
chance, the repeats differ, and no averaging makes their scatter smaller than that.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import f as f_distribution

from jbw.errors import DataError
from jbw.measurement.channels import channel

BY_CHANCE = 1e-3  # probability below which repeats are said to differ
SHAPES = 3  # directions along which repeats differ by other than noise


class Repeatability(NamedTuple):
    """Scatter of repeats of one test, over the root mean square of their mean."""

    scatter: float  # of one repeat, all of it
    noise: float  # of one repeat, what no change of size, time or pace explains
    size: float  # standard deviation of the size
    p: float  # probability of so much along the three directions by noise alone
    num_repeats: int

    @property
    def differ(self) -> bool:
        """Whether the repeats differ by more than noise."""
        return self.p < BY_CHANCE

    @property
    def floor(self) -> float:
        """What the mean leaves to be seen: an effect below it is none."""
        return self.scatter / self.num_repeats**0.5


def repeatability(y: ArrayLike) -> Repeatability:
    """Scatter of repeats of one excitation, shape (repeat, time), begun together.

    Raises:
        DataError: NaN, fewer than two repeats, or a dead channel.
    """
    rows = channel(y, "y")
    if rows.ndim != 2 or len(rows) < 2 or rows.shape[1] <= SHAPES:
        raise DataError(
            f"Channel `y` must hold two repeats of more than {SHAPES} samples, (repeat, time), but "
            f"has the shape {rows.shape}.",
            remedy="Measure the test again, with nothing changed.",
        )
    count, length = rows.shape
    mean = rows.mean(axis=0)
    power = float(np.mean(mean**2))
    if power == 0:
        raise DataError("Channel `y` is constant.", why="It shows no response.")
    slope, t = np.gradient(mean), np.linspace(-1.0, 1.0, length)
    basis = np.linalg.qr(np.column_stack([mean, slope, t * slope]))[0]
    deviations = rows - mean
    along = deviations @ basis
    explained = float(np.sum(along**2))
    rest = max(float(np.sum(deviations**2)) - explained, 0.0)
    degrees = SHAPES * (count - 1), (length - SHAPES) * (count - 1)
    noise = rest / degrees[1]
    # Coloured noise has more power where the response has: its own band is what it is judged by.
    ratio = explained / degrees[0] / max(_in_band(deviations, mean), noise, 1e-300)
    return Repeatability(
        scatter=float(np.sqrt(np.sum(deviations**2) / ((count - 1) * length) / power)),
        noise=float(np.sqrt(noise / power)),
        size=float(np.std(along[:, 0], ddof=1) / np.sqrt(length * power)),
        p=float(f_distribution.sf(ratio, degrees[0], max(_lines(mean) * (count - 1), 1))),
        num_repeats=count,
    )


def _band(mean: np.ndarray) -> np.ndarray:
    """Lines that hold the response: those of a hundredth of its largest amplitude."""
    size = np.abs(np.fft.rfft(mean))
    return size > 0.01 * size.max()


def _lines(mean: np.ndarray) -> int:
    return 2 * int(np.sum(_band(mean)))


def _in_band(deviations: np.ndarray, mean: np.ndarray) -> float:
    """Variance a sample of noise as strong everywhere as the median line of the response's band."""
    band = _band(mean)
    power = np.sum(np.abs(np.fft.rfft(deviations))[:, band] ** 2, axis=0) / (len(deviations) - 1)
    # Median over mean of a chi-square of 2 k degrees of freedom, by Wilson and Hilferty.
    k = len(deviations) - 1
    return float(np.median(power) / deviations.shape[1] / (1 - 1 / (9 * k)) ** 3)
