r"""Do the offsets of runs go with their motion? Then they are no scatter: the law misses something.

Weighted least squares of the offsets on the size of the response, the scatter of runs taken from
what is left, by Student's t with two degrees of freedom less than runs:

$$b_r = a + s\,x_r + e_r, \qquad w_r = 1 / (\sigma_r^2 + \tau^2), \qquad
  \mathrm{se}(s)^2 = \frac{\sum_r w_r e_r^2}{(n - 2) \sum_r w_r (x_r - \bar x)^2}$$

Reference:
    DerSimonian and Laird (1986), Controlled Clinical Trials 7, 177, for tau.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import stats

from jbw.identification.accuracy import another_law
from jbw.identification.run_effects import Shifts, moments_of, sizes_of
from jbw.inference.posterior.finding import Finding, checked
from jbw.observables.dataset import Dataset
from jbw.observables.observable import OFFSETS

Values = Float[np.ndarray, " run"]
FEWEST = 5  # runs from which a trend is told from their scatter
BY_CHANCE = 0.005  # of each of two trends, frequency's and damping's
NAMES = {"omega_n": "natural frequency", "zeta": "damping ratio"}


class Slope(NamedTuple):
    """A slope, its standard error, and the probability of one so steep by chance."""

    value: float
    std: float
    p: float


def slope_of(x: Values, offset: Values, std: Values) -> Slope:
    """Slope of offsets of these standard errors that scatter besides; of equal ones the usual."""
    weight = 1 / (std**2 + _scatter(offset, std))
    middle = np.average(x, weights=weight)
    spread = np.sum(weight * (x - middle) ** 2)
    value = float(np.sum(weight * (x - middle) * offset) / spread)
    residual = offset - np.average(offset, weights=weight) - value * (x - middle)
    dof = len(x) - 2
    error = float(np.sqrt(np.sum(weight * residual**2) / dof / spread))
    return Slope(value, error, float(2 * stats.t.sf(abs(value) / error, dof)))


def _scatter(offset: Values, std: Values) -> float:
    """Variance between runs beyond their standard errors, by moments."""
    chi_square, scale = moments_of(offset, std)
    return max(0.0, (chi_square - (len(offset) - 1)) / scale)


def trend_finding(shifts: Shifts, data: Dataset) -> Finding | None:
    """Whether offsets of frequency or damping go with the motion; None of too few runs."""
    sizes = sizes_of(data)
    indices = [i for i, name in enumerate(shifts.runs) if name in sizes]
    x = np.array([sizes[shifts.runs[i]] for i in indices])
    if len(indices) < FEWEST or np.ptp(x) <= 0:
        return None
    x = (x - x.min()) / np.ptp(x)  # a slope is then the change from the smallest to the largest
    slopes = {
        name: slope_of(x, shifts.offset[indices, i], shifts.std[indices, i])
        for i, name in enumerate(OFFSETS)
    }
    worst = min(slopes, key=lambda name: slopes[name].p)
    return _told(worst, slopes[worst], len(indices), data)


def _told(name: str, slope: Slope, count: int, data: Dataset) -> Finding:
    goes = slope.p < BY_CHANCE
    scale, unit = (1 / (2 * np.pi), "Hz") if name == "omega_n" else (100.0, "% of critical damping")
    values = {
        "quantity": NAMES[name], "count": count, "change": scale * slope.value,
        "std": scale * slope.std, "unit": unit, "p": slope.p,
    }  # fmt: skip
    remedy = {"another_law": another_law(data.laws)}
    return checked("level_trend", not goes, values, slope.p, remedy)
