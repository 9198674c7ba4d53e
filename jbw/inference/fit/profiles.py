"""Profile likelihoods: how far a parameter can move while all the others make up for it."""

import logging
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, PyTree
from numpy.typing import NDArray

from jbw.errors import ConfigError
from jbw.inference.fit.costly_fit import evaluator, from_search, to_search
from jbw.inference.fit.fitting import Fit, Residual
from jbw.inference.fit.walks import walk
from jbw.inference.space.box import Box, from_unit, require_float64
from jbw.inference.thresholds import THRESHOLD

logger = logging.getLogger("jbw")
FLAT = 0.1  # of chi-square: less is no preference at all


@dataclass(frozen=True)
class Profile:
    """Chi-square of one parameter, the others at their best.

    Attributes:
        name: The parameter.
        values: Where it was held, rising, in its unit.
        chi_square: Least chi-square there, less the least of all.
        path: All parameters there, by name.
        interval: Where chi-square stays below the threshold; the box's bound on an open side.
        open: Whether the threshold is not reached within the box, below and above.
        better: By how much the least chi-square lies below that of the fit.
    """

    name: str
    values: Float[np.ndarray, " point"]
    chi_square: Float[np.ndarray, " point"]
    path: dict[str, Float[np.ndarray, " point"]]
    interval: tuple[float, float]
    open: tuple[bool, bool]
    better: float


def profiles(
    residual: Residual,
    box: Box,
    data: PyTree,
    best: Fit,
    *,
    names: Iterable[str] | None = None,
    num_points: int = 9,
    worth: float = 1.0,
    report: Callable[[str], None] = logger.debug,
) -> dict[str, Profile]:
    r"""Profile of chi-square along every parameter.

    $$\chi^2_p(\theta_i) = \min_{\theta_j,\, j \ne i} |r(\theta)|^2$$

    over points within three standard deviations of the fit, further where chi-square has not risen
    by the 99 % quantile of its distribution, 6.63, and never beyond the box. Each point starts from
    its neighbour's optimum. The residual and its derivatives are those of `costly_fit`, compiled
    once for all parameters and points: the held parameter's column is left out.

    Args:
        residual: (theta, data) to residuals in units of their standard deviation.
        box: Bounds.
        data: Whatever `residual` takes.
        best: The fit of the same residual, box and data.
        names: Parameters to profile; all when None.
        num_points: Points of a profile, the fit among them; more where it reaches further.
        worth: Share of the residuals that are independent.
        report: Called with one sentence for every parameter.

    Returns:
        Profiles by name.

    Raises:
        ConfigError: A name that the box has not, fewer than three points, or a float32 session.

    Reference:
        Raue et al. (2009), Bioinformatics 25, 1923.
    """
    require_float64()
    wanted = box.names if names is None else tuple(names)
    unknown = [name for name in wanted if name not in box.names]
    if unknown or num_points < 3:
        raise ConfigError(
            f"Argument `names` must name parameters of the box, but holds {', '.join(unknown)}."
            if unknown
            else f"Argument `num_points` must be at least 3, but is {num_points}.",
            remedy=f"The parameters are {', '.join(box.names)}; nine points are usual.",
        )
    part = evaluator(residual, box, data)
    start = np.asarray(to_search(jnp.asarray(best.x), box))
    options: dict[str, Any] = {"num_points": num_points, "worth": worth, "threshold": THRESHOLD}
    walks = {}
    for name in wanted:
        report(f"Profile of {name}")
        walks[name] = walk(part, start, box.names.index(name), **options)
    least = min(np.min(cost) for _, cost in walks.values()) if walks else 0.0
    better = max(2 * worth * best.cost - least, 0.0)
    return {name: _profile(name, s, cost - least, better, box) for name, (s, cost) in walks.items()}


def _profile(
    name: str,
    s: Float[np.ndarray, "point parameter"],
    chi_square: Float[np.ndarray, " point"],
    better: float,
    box: Box,
) -> Profile:
    held = box.names.index(name)
    path = from_unit(jnp.stack([from_search(jnp.asarray(row), box)[0] for row in s]), box)
    root = np.sqrt(np.maximum(chi_square, 0.0))
    middle = int(np.argmin(chi_square))
    ends = [
        _crossing(s[: middle + 1, held][::-1], root[: middle + 1][::-1]),
        _crossing(s[middle:, held], root[middle:]),
    ]
    places = np.array([0.0 if ends[0] is None else ends[0], 1.0 if ends[1] is None else ends[1]])
    bounds = [_value(place, held, box) for place in places]
    return Profile(
        name,
        np.asarray(path[name]),
        chi_square,
        {key: np.asarray(value) for key, value in path.items()},
        (bounds[0], bounds[1]),
        (ends[0] is None, ends[1] is None),
        better,
    )


def _crossing(s: NDArray[np.float64], root: NDArray[np.float64]) -> float | None:
    """Where the root of chi-square, straight for a Gaussian, first passes the threshold."""
    level = np.sqrt(THRESHOLD)
    beyond = np.flatnonzero(root >= level)
    if not beyond.size:
        return None
    j = beyond[0]
    if j == 0:  # another profile found a better fit, and this one none as good
        return float(s[0])
    share = (level - root[j - 1]) / (root[j] - root[j - 1])
    return float(s[j - 1] + share * (s[j] - s[j - 1]))


def _value(place: float, held: int, box: Box) -> float:
    """The parameter at a place of its coordinate of search."""
    x = from_search(jnp.full(len(box.names), place), box)[0]
    return float(box.lower[held] + x[held] * (box.upper[held] - box.lower[held]))


def profile_statements(found: Mapping[str, Profile]) -> list[str]:
    """Every profile in a sentence.

    Args:
        found: From `profiles`.
    """
    said = [_sentence(each) for each in found.values()]
    better = max((each.better for each in found.values()), default=0.0)
    if better > FLAT:
        said.append(
            f"The profiles found a better fit, chi-square lower by {better:.3g}: the fit had "
            "stopped short of its optimum."
        )
    return said


def _sentence(found: Profile) -> str:
    low, high = found.interval
    if found.open == (False, False):
        digits = _digits(low, high)
        return (
            f"By its profile, {found.name} lies within {low:.{digits}g} and {high:.{digits}g} at "
            "99 %."
        )
    rise = float(np.max(found.chi_square))
    if found.open == (True, True):
        flat = "flat" if rise < FLAT else "open on both sides"
        return (
            f"The profile of {found.name} is {flat}: between {low:.4g} and {high:.4g}, its whole "
            f"box, chi-square rises by {rise:.2g} at most, for the other parameters make up for it."
        )
    if found.open[1]:
        return (
            f"By its profile, {found.name} exceeds {low:.5g} at 99 %; the data set no limit above."
        )
    return f"By its profile, {found.name} is below {high:.5g} at 99 %; the data set no limit below."


def _digits(low: float, high: float) -> int:
    """Significant digits that show an interval's width to two of its own, four at least."""
    largest = max(abs(low), abs(high))
    needed = 2 + math.ceil(math.log10(largest / (high - low))) if high > low else 6
    return max(4, needed)
