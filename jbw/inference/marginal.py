"""The marginal distribution of one parameter on a grid: moments and quantiles."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import expit, sici

from jbw.inference.box import Box
from jbw.inference.grid import Grid


class Marginal(NamedTuple):
    """One parameter's distribution: mean, standard deviation, quantiles, in its unit."""

    mean: float
    sd: float
    quantiles: tuple[float, ...]


def marginal(grid: Grid, index: int, box: Box, probabilities: tuple[float, ...]) -> Marginal:
    r"""Marginal of the parameter whose logit the grid's first coordinate alone decides.

    $$F(w) = \sum_j p_j \left[\tfrac12 + \tfrac1\pi \mathrm{Si}
    \!\left(\tfrac{\pi (w - w_j)}{h}\right)\right]$$

    the integral of the series of sinc functions through the nodes, which converges as fast as the
    trapezoidal rule.

    Args:
        grid: Made with this parameter first.
        index: Its place in the box.
        box: The prior box.
        probabilities: Of the quantiles.
    """
    p = grid.weights.reshape(len(grid.axes[0]), -1).sum(axis=1)
    centre = float(grid.whitening.centre[index])
    slope = float(grid.whitening.factor[index, 0])
    lower, width = float(box.lower[index]), float(box.upper[index] - box.lower[index])
    # Moments of the unit coordinate about its centre keep the digits of a narrow posterior.
    x = expit(centre + slope * grid.axes[0])
    middle = float(expit(centre))
    mean = float(p @ (x - middle))
    sd = float(np.sqrt(p @ (x - middle - mean) ** 2))
    places = [_quantile(grid.axes[0], p, grid.spacing, each) for each in probabilities]
    quantiles = tuple(lower + width * float(expit(centre + slope * w)) for w in places)
    return Marginal(lower + width * (middle + mean), width * sd, quantiles)


def _quantile(
    axis: NDArray[np.float64], p: NDArray[np.float64], spacing: float, probability: float
) -> float:
    def short(w: float) -> float:
        return float(distribution(w, axis, p, spacing)) - probability

    found: Any = brentq(short, axis[0] - 2 * spacing, axis[-1] + 2 * spacing, xtol=1e-12)
    return float(found)


def distribution(
    w: float, axis: Float[np.ndarray, " node"], p: Float[np.ndarray, " node"], spacing: float
) -> float:
    """Probability below w.

    Args:
        w: Where.
        axis: Nodes.
        p: Their shares, which sum to one.
        spacing: Between nodes.
    """
    return float(p @ (0.5 + sici(np.pi * (w - axis) / spacing)[0] / np.pi))
