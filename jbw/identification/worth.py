r"""How many independent values a group of data is worth, where the model does not follow it.

The misfit of a law that is not quite right is no noise: it follows the motion, the same in every
repeat, and pushes the parameters about as much as a few independent values would. Taken for white
noise it makes intervals absurdly narrow. So every group counts for so many values that the least
squares' covariance is the one that a residual of that spectrum really causes.
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Complex, Float
from scipy.ndimage import uniform_filter1d

from jbw.inference.fitting import Fit
from jbw.observables.decay import Decays
from jbw.observables.evidence import Evidence
from jbw.observables.linear import LineReading
from jbw.observables.weighing import left_by_label

COLOURED = 0.2  # lag-one correlation above which intervals are noticeably too narrow
MISFIT = 0.5  # of a mean's variance: misfit that repeats do not average out
LEAST_WORTH = 8  # independent values of a group, below which nothing could be integrated out
BY_CHANCE = 0.5  # share that white residuals of a few dozen values hardly go below
SMOOTHED = 5  # neighbours among which a residual's squares are averaged

Row = Float[np.ndarray, " n"] | Complex[np.ndarray, " n"]


def correlation_at_one(row: Row) -> float:
    """Lag-one correlation of a residual; of lines of a spectrum, its magnitude."""
    together = np.vdot(row[:-1], row[1:]) / np.real(np.vdot(row, row))
    return float(np.abs(together) if np.iscomplexobj(row) else np.real(together))


def worth_along(
    row: Row,
    slopes: Float[np.ndarray, "parameter n"] | Complex[np.ndarray, "parameter n"],
    covariance: Float[np.ndarray, "parameter parameter"],
) -> float:
    r"""Share of values of a residual that count as independent for what is estimated.

    $$w = w_t\,w_f, \qquad w_t = \frac{\bar S \sum_t D(t)}{\sum_t D(t)\,S(t)}, \quad
      S = |r|^2, \quad D = \sum_i |(L^T J^T)_i|^2, \quad \Sigma = L L^T$$

    and w_f the same of their Fourier transforms. D is the prediction's change by one standard
    deviation of everything estimated. Where the residual is large at the places, or the
    frequencies, at which D is, least squares scatters by more than white noise of its size causes.

    Args:
        row: What the fit leaves of the group.
        slopes: Derivatives of the prediction by the parameters.
        covariance: Of the parameters.

    Returns:
        w, at most 1 and at least eight values' worth.
    """
    along = np.linalg.cholesky(covariance).T @ slopes
    share = _overlap(row, along) * _overlap(np.fft.fft(row), np.fft.fft(along))
    return float(np.clip(share, min(1.0, LEAST_WORTH / len(row)), 1.0))


def _overlap(row: Row, along: Float[np.ndarray, "i n"] | Complex[np.ndarray, "i n"]) -> float:
    """Mean square of a residual, over that where the prediction moves; at most 1."""
    square = uniform_filter1d(np.abs(row) ** 2, SMOOTHED, mode="wrap")
    moved = np.sum(np.abs(along) ** 2, axis=0)
    return min(float(moved.sum() * square.mean() / np.sum(moved * square)), 1.0)


def worth_of(rows: Float[np.ndarray, "row n"] | Complex[np.ndarray, "row n"]) -> float:
    r"""Share of independent values among correlated ones, for what acts on all of them alike.

    $$1/w = 1 + 2 \sum_{k \ge 1} \rho_k$$

    with the correlation over all rows, summed until it first falls below zero.

    Args:
        rows: What a fit leaves of one or more groups.

    Returns:
        w, at most 1.
    """
    n = rows.shape[1]
    unit = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    spectrum = np.mean(np.abs(np.fft.fft(unit, 2 * n)) ** 2, axis=0)
    rho = np.fft.ifft(spectrum).real[1 : n // 2]
    below = np.flatnonzero(rho < 0)
    total = float(rho[: below[0] if below.size else len(rho)].sum())
    return float(np.clip(1 / (1 + 2 * total), min(1.0, LEAST_WORTH / n), 1.0))


def worth_by_label(best: Fit, data: Evidence) -> dict[str, float]:
    r"""Share of independent values of each group that is coloured, or misfitted in all repeats.

    Misfit of variance tau^2 is the same in all K repeats, so that they are worth

    $$f = w\,\frac{\tau^2 + \sigma^2}{K \tau^2 + \sigma^2}$$

    of as many values, w for the colour of the mean's residual.

    Args:
        best: The fit.
        data: The evidence that was fitted.

    Returns:
        Shares below one, by label.
    """
    left = left_by_label(best.residual, data)
    columns = [left_by_label(column, data) for column in best.jacobian.T]
    found = {}
    for part in data.parts:
        if isinstance(part, LineReading | Decays):
            continue
        own = part.repeats
        for i, label in enumerate(own.labels):
            row, count = left[label], float(own.num_repeats[i])
            size = float(own.size[i])
            square = float(np.sum(np.abs(row) ** 2)) / size
            noise = float(own.within[i]) / (size * (count - 1)) if count > 1 else 0.0
            misfit = max(square - noise / count, 0.0)
            slopes = np.stack([column[label] for column in columns])
            share = worth_along(row, slopes, best.covariance)
            coloured = len(row) >= 2 * LEAST_WORTH and abs(correlation_at_one(row)) > COLOURED
            if not coloured and share > BY_CHANCE:
                share = 1.0
            if count > 1 and count * misfit > MISFIT * noise:
                share *= (misfit + noise) / (count * misfit + noise)
            if share < 1.0:
                found[label] = share
    return found


def counted_by_label(data: Evidence) -> Mapping[str, float]:
    """Share of the values of each group that the likelihood counts."""
    return {
        label: float(own.num_values[i] / (own.size[i] * own.num_repeats[i]))
        for part in data.parts
        if not isinstance(part, LineReading | Decays)
        for own in (part.repeats,)
        for i, label in enumerate(own.labels)
    }
