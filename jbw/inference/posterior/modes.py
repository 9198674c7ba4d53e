"""Modes of a posterior: where a deep valley parts the draws, and what either side weighs."""

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
NUM_POINTS = 256
FEWEST = 100  # draws that a kernel's width supposes: chains that stick make no modes of themselves
CROSSED = 100.0  # effective draws of the side, from where on its share is a weight
AGREED = 1.05  # R-hat of the side


class Split(NamedTuple):
    """A quantity whose posterior has two modes or more, at its deepest valley.

    Attributes:
        name: The quantity.
        below: Highest density below the valley, in the quantity's unit.
        above: Highest density above it.
        weight: Share of the draws below it.
        error: Monte Carlo standard error of that share; NaN where chains do not cross the valley
            often enough, and the shares are an accident of the starts.
    """

    name: str
    below: float
    above: float
    weight: float
    error: float


def deepest_split(draws: Draws) -> Split | None:
    """The quantity with the deepest valley between two modes; None where there is none.

    A kernel estimate of each marginal is looked through for a valley below half of both peaks
    beside it, with 2 % of the draws or more on either side. Modes that overlap in every marginal
    are not seen.
    """
    found = [
        (depth, split) for name, values in draws.items() for depth, split in _valley(name, values)
    ]
    return min(found, key=lambda pair: pair[0])[1] if found else None


def _valley(name: str, values: Float[np.ndarray, "chain draw"]) -> list[tuple[float, Split]]:
    flat = values.ravel()
    if np.ptp(flat) == 0:
        return []
    ess = diagnose(values)["ess_bulk"]
    count = np.clip(np.nan_to_num(ess), min(FEWEST, flat.size), flat.size)
    grid = np.linspace(flat.min(), flat.max(), NUM_POINTS)
    density = gaussian_kde(flat, bw_method=count**-0.2)(grid)
    left = np.maximum.accumulate(density)
    right = np.maximum.accumulate(density[::-1])[::-1]
    depth = density / np.minimum(left, right)
    share = np.searchsorted(np.sort(flat), grid) / flat.size
    depth[(share < LEAST) | (share > 1 - LEAST)] = 1.0
    i = int(np.argmin(depth))
    if depth[i] >= DEPTH:
        return []
    below, above = (float(grid[np.argmax(np.where(side, density, 0))]) for side in _sides(grid, i))
    side = (values < grid[i]).astype(float)
    return [(float(depth[i]), Split(name, below, above, float(side.mean()), _error(side)))]


def _sides(grid: Float[np.ndarray, " point"], i: int) -> tuple[np.ndarray, np.ndarray]:
    return grid <= grid[i], grid > grid[i]


def _error(side: Float[np.ndarray, "chain draw"]) -> float:
    """Standard error of the share of one side; NaN where the chains do not agree on it."""
    row = diagnose(side)
    crossed = row["ess_bulk"] >= CROSSED and not row["r_hat"] >= AGREED
    return float(side.std() / np.sqrt(row["ess_bulk"])) if crossed else float("nan")


def modes_finding(draws: Draws) -> Finding:
    """Whether any quantity has more than one mode, and what each weighs.

    Returns:
        Failed where there are two, for no mean or interval describes them; its number is the share
        of the smaller.
    """
    split = deepest_split(draws)
    if split is None:
        return Finding("modes", "ok", "No quantity has two modes with a valley between.", 0.0)
    places = f"The posterior of {split.name} has modes at {split.below:.4g} and {split.above:.4g}"
    smaller = min(split.weight, 1 - split.weight)
    if np.isnan(split.error):
        return Finding(
            "modes",
            "failed",
            f"{places}, and the chains do not cross between them often enough to weigh them: "
            f"{split.weight:.0%} of the draws at the first is an accident of their starts.",
            smaller,
            'Set sampler = "tempered_smc" or "nested" in [identify], which weigh modes.',
        )
    return Finding(
        "modes",
        "failed",
        f"{places}, which weigh {split.weight:.3f} and {1 - split.weight:.3f} "
        f"+- {split.error:.1g}.",
        smaller,
        "Report each mode by itself, with its weight: a mean between them describes neither.",
    )
