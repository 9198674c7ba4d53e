"""The effective number of independent values of a data group with a coloured residual.

The misfit of an imperfect law follows the motion and is the same in every repeat. Treated as white
noise, it makes intervals absurdly narrow. Therefore every group counts for so many values that the
covariance of least squares is the one that a residual of that spectrum really causes.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Complex, Float
from scipy.ndimage import uniform_filter1d

COLOURED = 0.2  # Lag-one correlation of residuals above which intervals are clearly too narrow.
# A correlation counts if it exceeds this multiple of its standard error 1 / sqrt(n).
BEYOND_CHANCE = 3.0
# If model error is more than this fraction of a mean's variance, repeats do not average the error
# out.
MISFIT = 0.5
# Smallest number of independent values in a data group, needed to integrate out its noise.
LEAST_VALUES = 8
# For a white residual, the estimated fraction of independent values is hardly ever below this
# value.
BY_CHANCE = 0.5
MEDIAN_OF_SQUARE = 0.455  # median of the square of a standard normal variable
SMOOTHED = 5  # number of neighbouring values over which squared residuals are averaged

Row = Float[np.ndarray, " n"] | Complex[np.ndarray, " n"]


def correlation_at_one(row: Row) -> float:
    """Return the lag-one autocorrelation of a residual; for spectral lines, its magnitude."""
    together = np.vdot(row[:-1], row[1:]) / np.real(np.vdot(row, row))
    return float(np.abs(together) if np.iscomplexobj(row) else np.real(together))


def coloured_from(row: Row) -> float:
    """Return the lag-one autocorrelation that a white residual hardly ever exceeds."""
    return max(COLOURED, BEYOND_CHANCE / np.sqrt(len(row)))


def is_coloured(row: Row) -> bool:
    """Return whether a sufficiently long residual has a lag-one autocorrelation above the limit."""
    return len(row) >= 2 * LEAST_VALUES and abs(correlation_at_one(row)) > coloured_from(row)


def white_square(row: Row) -> float:
    r"""Estimate the mean square of the white noise in a residual; 0 if it has too few values.

    $$\min\Bigl(\frac{\mathrm{med}\,|r|^2}{c},\ \frac{\mathrm{med}\,|R|^2}{\ln 2}\Bigr), \qquad
      R_k = \frac{\sum_t w_t r_t e^{-2\pi i k t / n}}{\sqrt{\sum_t w_t^2}}$$

    with a Hann window w, and c = ln 2 for complex and 0.455 for real values. Noise is spread over
    all values and all lines of their spectrum; the misfit of a law is not.
    """
    if len(row) < 2 * LEAST_VALUES:
        return 0.0
    window = np.hanning(len(row) + 2)[1:-1]
    lines = np.abs(np.fft.fft(row * window)) ** 2 / np.sum(window**2)
    of_one = np.log(2) if np.iscomplexobj(row) else MEDIAN_OF_SQUARE
    return float(min(np.median(np.abs(row) ** 2) / of_one, np.median(lines) / np.log(2)))


def effective_fraction(
    row: Row,
    slopes: Float[np.ndarray, "parameter n"] | Complex[np.ndarray, "parameter n"],
    covariance: Float[np.ndarray, "parameter parameter"],
) -> float:
    r"""Return the share of a residual's values that count as independent in a fit.

    $$w = w_t\,w_f, \qquad w_t = \frac{\bar S \sum_t D(t)}{\sum_t D(t)\,S(t)}, \quad
      S = |r|^2, \quad D = \sum_i |(L^T J^T)_i|^2, \quad \Sigma = L L^T$$

    and w_f the same for their Fourier transforms; w is at most 1 and at least the share of eight
    values. D is the prediction's change by one standard deviation of all estimates, with J its
    `slopes`: a residual that is large where D is large disturbs least squares more than white noise
    of its size.
    """
    along = np.linalg.cholesky(covariance).T @ slopes
    share = _overlap(row, along) * _overlap(np.fft.fft(row), np.fft.fft(along))
    return float(np.clip(share, min(1.0, LEAST_VALUES / len(row)), 1.0))


def _overlap(row: Row, along: Float[np.ndarray, "i n"] | Complex[np.ndarray, "i n"]) -> float:
    square = uniform_filter1d(np.abs(row) ** 2, SMOOTHED, mode="wrap")
    moved = np.sum(np.abs(along) ** 2, axis=0)
    return min(float(moved.sum() * square.mean() / np.sum(moved * square)), 1.0)


def correlated_fraction(rows: Sequence[Row]) -> float:
    r"""Return the share of values that count as independent, from their autocorrelation.

    The share w follows from $1/w = 1 + 2 \sum_{k \ge 1} \rho_k$, summed until rho is negative.
    """
    n = max(map(len, rows))
    spectra = [np.fft.fft(row / np.linalg.norm(row), 2 * n) for row in rows]
    spectrum = np.mean(np.abs(spectra) ** 2, axis=0)
    rho = np.fft.ifft(spectrum).real[1 : n // 2]
    below = np.flatnonzero(rho < 0)
    total = float(rho[: below[0] if below.size else len(rho)].sum())
    return float(np.clip(1 / (1 + 2 * total), min(1.0, LEAST_VALUES / n), 1.0))
