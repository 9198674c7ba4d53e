"""Modes of a posterior: the deepest valley between the draws, and the weight of either side."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.stats import gaussian_kde

from jbw.inference.posterior.finding import Finding
from jbw.inference.posterior.summary import diagnose

Draws = Mapping[str, Float[np.ndarray, "chain draw"]]

DEPTH = 0.5  # of a valley's density over the lower of the peaks beside it
LEAST = 0.02  # of the draws on either side: fewer are a tail
SURE = 2.0  # standard errors by which a side is more
NUM_POINTS = 256
FEWEST = 100  # least draws for a kernel's width: chains that stick must not appear as modes
CROSSED = 100.0  # least effective draws of a side for its share to count as a weight
AGREED = 1.05  # R-hat of the side


class ModeSplit(NamedTuple):
    """A quantity whose density has a valley between the peaks `below` and `above`.

    Its depth is over the lower peak's density. The weight is the share of the draws below the
    valley, its error NaN where too few chains cross: an accident of the starts.
    """

    name: str
    below: float
    above: float
    weight: float
    error: float
    depth: float


def deepest_split(draws: Draws) -> ModeSplit | None:
    """The quantity of the deepest valley, below half of both peaks.

    Either side has more than 2 % of the draws, beyond doubt: fewer are a tail.
    Modes that overlap in every marginal are not seen.
    """
    valleys = [_valley(name, values) for name, values in draws.items()]
    return min(filter(None, valleys), key=lambda split: split.depth, default=None)


def _valley(name: str, values: Float[np.ndarray, "chain draw"]) -> ModeSplit | None:
    flat = values.ravel()
    if np.ptp(flat) == 0:
        return None
    ess = diagnose(values)["ess_bulk"]
    count = np.clip(np.nan_to_num(ess), min(FEWEST, flat.size), flat.size)
    grid = np.linspace(flat.min(), flat.max(), NUM_POINTS)
    density = gaussian_kde(flat, bw_method=count**-0.2)(grid)
    peak_below = np.maximum.accumulate(density)
    peak_above = np.maximum.accumulate(density[::-1])[::-1]
    depth = density / np.minimum(peak_below, peak_above)
    share = np.searchsorted(np.sort(flat), grid) / flat.size
    # Few draws of a heavy tail form clumps: the smaller side must exceed its standard error.
    error = np.maximum(np.sqrt(share * (1 - share) / count), _repeated(flat, grid))
    depth[np.minimum(share, 1 - share) - SURE * error < LEAST] = 1.0
    i = int(np.argmin(depth))
    if depth[i] >= DEPTH:
        return None
    below = float(grid[np.argmax(density[: i + 1])])
    above = float(grid[i + 1 + np.argmax(density[i + 1 :])])
    side = (values < grid[i]).astype(float)
    return ModeSplit(name, below, above, float(side.mean()), _error(side), float(depth[i]))


def _repeated(
    values: Float[np.ndarray, " draw"], grid: Float[np.ndarray, " place"]
) -> Float[np.ndarray, " place"]:
    r"""Standard error of the share s below a place, of draws that are points repeated by weight w.

    $$(1 - s)^2 \sum_{below} w^2 + s^2 \sum_{above} w^2$$
    """
    points, times = np.unique(values, return_counts=True)
    weights = times / values.size
    share, squares = (np.concatenate([[0.0], np.cumsum(x)]) for x in (weights, weights**2))
    at = np.searchsorted(points, grid)
    s, below = share[at], squares[at]
    return np.sqrt((1 - s) ** 2 * below + s**2 * (squares[-1] - below))


def _error(side: Float[np.ndarray, "chain draw"]) -> float:
    """Standard error of the share of one side; NaN where the chains do not agree on it."""
    row = diagnose(side)
    crossed = row["ess_bulk"] >= CROSSED and not row["r_hat"] >= AGREED
    return float(side.std() / np.sqrt(row["ess_bulk"])) if crossed else float("nan")


def modes_findings(draws: Draws) -> list[Finding]:
    """Whether the chains determine the weights of modes, and whether any quantity has two modes.

    Two modes of known weights are two answers of the data; no mean or interval describes them.
    """
    split = deepest_split(draws)
    if split is None:
        return [Finding("crossing", "ok", {}, 0.0)]
    peaks = {
        "name": split.name, "below": split.below, "above": split.above, "weight": split.weight,
    }  # fmt: skip
    smaller = min(split.weight, 1 - split.weight)
    if np.isnan(split.error):
        return [Finding("crossing", "failed", peaks, smaller)]
    weighed = {**peaks, "rest": 1 - split.weight, "error": split.error}
    return [
        Finding("crossing", "ok", {"name": split.name}, split.error, entry="crossing.weighed"),
        Finding("modes", "failed", weighed, smaller),
    ]
