"""The accuracy with which data determine parameters: directions, widths, profile likelihoods.

Directions and widths follow from the covariance of a fit compared with the prior, before sampling.
A profile shows how far one parameter can move while all others compensate.
"""

import logging
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, PyTree
from numpy.typing import NDArray

from jbw.inference.fit.costly_fit import Part, evaluator, from_search, to_search, trust_region
from jbw.inference.fit.fitting import Fit, Residual, svd_of_all
from jbw.inference.fit.identifiability import PRESENT, RESOLVED, UNLEARNT, combination
from jbw.inference.space.box import (
    Box,
    Product,
    alone,
    from_unit,
    gradient_of,
    log_prior_std,
    require_float64,
    value_of,
)
from jbw.inference.thresholds import KNOWN, LEARNT, ROUGHLY, THRESHOLD
from jbw.report.messages import identified
from jbw.report.messages.message import listed

# largest exponent in a named combination; larger exponents only show that prior widths differ
SENSIBLE = 10.0
# Largest ratio of two standard deviations: of a combination of parameters that a sentence names,
# and of the exact direction in parameter space that the combination approximates.
AS_WELL = 2.0
# Parameters compensate each other if the standard deviation of their product is less than this
# fraction of each parameter's standard deviation.
TOLD_APART = 0.5
logger = logging.getLogger("jbw")
# A change of chi-square below this does not show that one parameter value is better than another.
FLAT = 0.1
PLACES = 4  # number of points of a profile on each side of the fit, up to `REACH`
REACH = 3.0  # range of a profile in standard deviations, slightly beyond the 2.58 of 99 %
# largest number of points beyond `REACH`, each twice as far from the fit as the one before
MOST_FURTHER = 6
# Few evaluations per point are enough, because each search starts at the optimum of the point
# before.
MOST_EVALUATIONS = 12
TOLERANCE = 1e-7  # relative tolerance of the cost and of the step
ON_BOUND = 1e-6  # A fit closer to a bound than this fraction of the prior's width lies on it.
# largest rise between two points, in standard deviations, for which a profile is taken as linear
STEEP = 1.5
# largest number of halvings of the interval in which a profile crosses its threshold
MOST_HALVINGS = 6

Point = tuple[NDArray[np.float64], float]  # coordinates and chi-square of a point


@dataclass(frozen=True)
class Direction:
    """A direction in parameter space, and how well the data determine it.

    `names` are the parameters that dominate it, and `loadings` the shares of all parameters, in
    prior standard deviations, in the box's order. `text` is their combination, with leading
    exponent 1, and `sd` its standard deviation, relative for a product, NaN for a mixture. `ratio`
    is posterior over prior deviation.
    """

    information: float
    ratio: float
    names: tuple[str, ...]
    text: str
    sd: float
    loadings: NDArray[np.float64]


@dataclass(frozen=True)
class QuantityInformation:
    """A parameter or product: value, standard deviation, and ratio to the prior's deviation."""

    text: str
    value: float
    sd: float
    ratio: float

    @property
    def relative(self) -> float:
        """The standard deviation divided by the value; infinite if the value is zero."""
        return self.sd / abs(self.value) if self.value else math.inf


@dataclass(frozen=True)
class Information:
    """The Fisher information of a fit by direction (best determined first), parameter, product."""

    names: tuple[str, ...]
    directions: tuple[Direction, ...]
    known: dict[str, QuantityInformation]


def information(best: Fit, box: Box, products: Iterable[Product] = ()) -> Information:
    r"""Return the Fisher information of the data relative to that of the prior, by direction.

    $$J^T J\,v = \lambda\,\Lambda\,v, \qquad \rho = (1 + \lambda)^{-1/2}, \qquad
      \Sigma = (J^T J + \Lambda)^{-1}$$

    with J the residual's derivatives in units of the noise and Lambda the inverse variances of the
    prior. Logarithms are used for parameters that are positive and distinct from zero, and the
    parameters themselves otherwise. A product f has the variance $\nabla f^T \Sigma \nabla f$.
    """
    theta = np.array([best.theta[name] for name in box.names])
    lower, upper = np.asarray(box.lower), np.asarray(box.upper)
    # Use logarithms if the prior bounds are positive, or the data exclude zero.
    resolved = theta * np.linalg.norm(best.jacobian, axis=0) > RESOLVED
    logs = (lower > 0) | ((lower == 0) & resolved)
    slope = np.where(logs, theta, 1.0)
    log_stds = [log_prior_std(a, b) for a, b in zip(lower, upper, strict=True)]
    prior = np.where(logs, log_stds, (upper - lower) / math.sqrt(12))
    singular, rows = svd_of_all(best.jacobian * slope * prior)
    values = singular**2
    root = rows.T / np.sqrt(1 + values) * prior[:, None]
    directions = tuple(
        _direction(value, row, prior, logs, box.names, root)
        for value, row in zip(values, rows, strict=True)
    )
    by_quantity = {}
    for product in (*map(alone, box.names), *products):
        gradient = gradient_of(product, best.theta, box.names) * slope
        sd, alone_sd = np.linalg.norm(gradient @ root), np.linalg.norm(gradient * prior)
        ratio = float(sd / alone_sd) if alone_sd > 0 else 1.0
        value = float(value_of(product, best.theta))
        by_quantity[product.name] = QuantityInformation(product.text, value, float(sd), ratio)
    return Information(box.names, directions, by_quantity)


def _direction(
    value: float,
    row: NDArray[np.float64],
    prior: NDArray[np.float64],
    logs: NDArray[np.bool_],
    names: tuple[str, ...],
    root: NDArray[np.float64],
) -> Direction:
    order = np.argsort(-np.abs(row), kind="stable")
    lead = order[0]
    exponents = (row / prior) / (row[lead] / prior[lead])
    ratio = 1 / math.sqrt(1 + value)
    members = _members(order, row, exponents, prior, root, ratio)
    called = tuple(names[i] for i in members)
    text, sd = f"a mixture of {listed(called)}", math.nan
    same = np.all(logs[members]) or not np.any(logs[members])
    if same and np.max(np.abs(exponents[members])) < SENSIBLE:
        text = combination(called, exponents[members], bool(logs[lead]))
        sd = float(ratio * prior[lead] / abs(row[lead]))
    return Direction(float(value), ratio, called, text, sd, row * np.sign(row[lead]))


def _members(
    order: NDArray[np.intp],
    row: NDArray[np.float64],
    exponents: NDArray[np.float64],
    prior: NDArray[np.float64],
    root: NDArray[np.float64],
    ratio: float,
) -> list[int]:
    """Return the indices of the parameters that are needed to name a direction.

    A factor with a narrow prior contributes little to the direction, but without it the other
    factors are determined far worse than the direction: alpha*delta known to a millionth says
    nothing about delta.
    """
    count = int(np.sum(np.abs(row) > PRESENT * np.max(np.abs(row))))
    while count < len(order):
        named = np.where(np.isin(np.arange(len(row)), order[:count]), exponents, 0.0)
        if np.linalg.norm(named @ root) <= AS_WELL * ratio * np.linalg.norm(named * prior):
            break
        count += 1
    return [int(i) for i in order[:count]]


def statements(spectrum: Information, products: Iterable[Product] = ()) -> list[str]:
    """Return sentences on how well the data determine parameters and `products`."""
    sentences = [directions_sentence(spectrum)]
    rows = list(spectrum.known.values())
    for kind in identified.GRADES:
        if of_kind := [_with_error(row) for row in rows if _kind(row) == kind]:
            sentences.append(identified.grade(kind, of_kind))
    return [*sentences, *ties(spectrum, products)]


def directions_sentence(spectrum: Information) -> str:
    """Return the sentence on how many directions the data determine better than the prior."""
    learnt = sum(direction.ratio < UNLEARNT for direction in spectrum.directions)
    return identified.directions(learnt, len(spectrum.directions))


def ties(spectrum: Information, products: Iterable[Product]) -> list[str]:
    """Return sentences on products of parameters that are better determined than their factors."""
    return [sentence for product in products for sentence in _tie(spectrum.known, product)]


def _kind(row: QuantityInformation) -> str:
    """Return the grade of a quantity's identification, in the words of the report."""
    if _is_unlearnt(row):
        return "unknown"
    if row.relative <= KNOWN:
        return "known"
    return "roughly" if row.relative <= ROUGHLY else "hardly"


def _is_unlearnt(row: QuantityInformation) -> bool:
    return row.ratio > math.exp(-LEARNT)


def _with_error(row: QuantityInformation) -> str:
    if _is_unlearnt(row):
        return row.text
    return identified.with_error(row.text, row.value, row.sd, row.relative)


def _tie(rows: Mapping[str, QuantityInformation], product: Product) -> list[str]:
    """Return a sentence if a product of parameters is better determined than its factors."""
    row = rows[product.name]
    factors = [rows[name].relative for name in product.factors if name in rows]
    if _is_unlearnt(row) or not factors or row.relative >= TOLD_APART * min(factors):
        return []
    return [identified.tie(product.text, min(factors) / row.relative)]


@dataclass(frozen=True)
class Profile:
    """Chi-square along one parameter, minimised over all other parameters.

    `chi_square` is relative to the least of all profiles, and `path` contains the other parameters'
    optima. The `interval` is where it stays below the threshold; it ends at the box's bound if that
    side, below or above, is `open`. `better` is how far the least chi-square lies below that of the
    fit. `num_refused` counts points that are omitted because the model cannot be solved there.
    """

    name: str
    values: Float[np.ndarray, " point"]
    chi_square: Float[np.ndarray, " point"]
    path: dict[str, Float[np.ndarray, " point"]]
    interval: tuple[float, float]
    open: tuple[bool, bool]
    better: float
    num_refused: int = 0


def profiles(
    residual: Residual,
    box: Box,
    data: PyTree,
    best: Fit,
    *,
    report: Callable[[str], None] = logger.debug,
) -> dict[str, Profile]:
    r"""Compute chi-square along each parameter, minimised over the other parameters.

    $$\chi^2_p(\theta_i) = \min_{\theta_j,\, j \ne i} |r(\theta)|^2$$

    over points within three standard deviations of the fit, further if chi-square has not risen by
    6.63, the 99 % quantile of its distribution, and never beyond the box. Each point starts from
    its neighbour's optimum. The residual, box, data and compiled derivatives are those of the
    `costly_fit` that found `best`. `report` is called with one sentence for every parameter.

    Reference:
        Raue et al. (2009), Bioinformatics 25, 1923.
    """
    require_float64()
    part = evaluator(residual, box, data)
    start = to_search(best.x, box)
    walks = {}
    for held, name in enumerate(box.names):
        report(f"Profile of {name}")
        walks[name] = walk(part, start, held)
    least = min(np.min(chi_square) for _, chi_square in walks.values())
    better = max(2 * best.cost - least, 0.0)
    return {
        name: _profile(name, s, chi_square - least, better, box)
        for name, (s, chi_square) in walks.items()
    }


def _profile(
    name: str,
    s: Float[np.ndarray, "point parameter"],
    chi_square: Float[np.ndarray, " point"],
    better: float,
    box: Box,
) -> Profile:
    held = box.names.index(name)
    path = from_unit(np.stack([from_search(row, box)[0] for row in s]), box)
    root = np.sqrt(np.maximum(chi_square, 0.0))
    middle = int(np.argmin(chi_square))
    below = _crossing(s[: middle + 1, held][::-1], root[: middle + 1][::-1])
    above = _crossing(s[middle:, held], root[middle:])
    low = _value(0.0 if below is None else below, held, box)
    high = _value(1.0 if above is None else above, held, box)
    is_open = below is None, above is None
    solved = np.isfinite(chi_square)
    path = {key: values[solved] for key, values in path.items()}
    num_refused = int(np.count_nonzero(~solved))
    chi_square = chi_square[solved]
    return Profile(
        name, path[name], chi_square, path, (low, high), is_open, better, num_refused=num_refused
    )


def _crossing(s: NDArray[np.float64], root: NDArray[np.float64]) -> float | None:
    """Return where chi-square first exceeds the threshold, by interpolation of its square root."""
    level = np.sqrt(THRESHOLD)
    beyond = np.flatnonzero(root >= level)
    if not beyond.size:
        return None
    j = beyond[0]
    if j == 0:  # The profile of another parameter has found a better fit than the optimum.
        return float(s[0])
    if not np.isfinite(root[j]):  # The model has no solution at this point.
        return float(s[j])
    share = (level - root[j - 1]) / (root[j] - root[j - 1])
    return float(s[j - 1] + share * (s[j] - s[j - 1]))


def _value(place: float, held: int, box: Box) -> float:
    """Return the parameter's value at a point of the search coordinates."""
    x = from_search(np.full(len(box.names), place), box)[0]
    return float(box.lower[held] + x[held] * (box.upper[held] - box.lower[held]))


def walk(
    part: Part, start: NDArray[np.float64], held: int
) -> tuple[Float[np.ndarray, "point parameter"], Float[np.ndarray, " point"]]:
    """Return optima and chi-squares along one coordinate, away from a fit on both sides."""
    sd = _sd(part(start, 1), held)
    centre = float(np.sum(part(start, 0) ** 2))
    sides: list[list[Point]] = []
    for sign in (-1.0, 1.0):
        s, side = start, [(start, centre)]
        for place in _steps(start[held], sign, sd):
            within = abs(place - start[held]) <= REACH * sd * (1 + 1e-9)
            if not within and side[-1][1] > centre + THRESHOLD:
                break
            s, chi_square = constrained(part, s, held, place)
            side.append((s, chi_square))
        sides.append(_refined(part, side, held))
    rows, costs = zip(*sides[0][:0:-1], *sides[1], strict=True)
    return np.array(rows), np.array(costs)


def _refined(part: Part, side: list[Point], held: int) -> list[Point]:
    """Return one side of a profile, with additional points where chi-square rises steeply."""
    centre = side[0][1]
    for _ in range(MOST_HALVINGS):
        rise = np.array([max(chi_square - centre, 0.0) for _, chi_square in side])
        beyond = np.flatnonzero(rise > THRESHOLD)
        if not beyond.size:
            break
        j = int(beyond[0])
        if np.sqrt(rise[j]) - np.sqrt(rise[j - 1]) < STEEP:
            break
        inner, outer = side[j - 1][0], side[j][0]
        between = constrained(part, inner, held, (inner[held] + outer[held]) / 2)
        side = [*side[:j], between, *side[j:]]
    return side


def _sd(jacobian: Float[np.ndarray, "residual parameter"], held: int) -> float:
    """Return a coordinate's standard deviation with all others free, at most that of the prior."""
    others, column = np.delete(jacobian, held, axis=1), jacobian[:, held]
    explained = others @ np.linalg.lstsq(others, column)[0] if others.shape[1] else 0.0
    residual = float(np.linalg.norm(column - explained))
    # A column that the other columns explain up to rounding contains no information.
    return min(1 / residual, 1.0) if residual > 1e-9 * float(np.linalg.norm(column)) else 1.0


def _steps(centre: float, side: float, sd: float) -> list[float]:
    """Return the values of a coordinate at which its profile is computed, from fit to bound."""
    room = 1 - centre if side > 0 else centre
    if room <= ON_BOUND:
        return []
    reach = min(REACH * sd, room)
    steps = list(reach * np.arange(1, PLACES + 1) / PLACES)
    beyond = [REACH * sd * 2.0**k for k in range(1, MOST_FURTHER + 1)]
    steps += [step for step in beyond if reach < step < room]
    if steps[-1] < room:
        steps.append(room)
    # Put the last point exactly on the bound, which rounding might miss.
    return [float(np.clip(centre + side * step, 0.0, 1.0)) for step in steps]


def constrained(part: Part, s: NDArray[np.float64], held: int, place: float) -> Point:
    """Minimise chi-square with one coordinate fixed; return the point and chi-square.

    If the model cannot be solved there, chi-square is infinite.
    """
    free = np.arange(len(s)) != held

    def point_of(rest: NDArray[np.float64]) -> NDArray[np.float64]:
        point = np.full(len(s), place)
        point[free] = rest
        return point

    if not np.any(free):
        point_alone = point_of(np.empty(0))
        chi_square = float(np.sum(part(point_alone, 0) ** 2))
        return point_alone, chi_square if np.isfinite(chi_square) else np.inf

    def of_rest(rest: NDArray[np.float64], which: int) -> NDArray[np.float64]:
        value = part(point_of(rest), which)
        return value[:, free] if which else value

    end: Any = trust_region(of_rest, np.clip(s[free], 0.0, 1.0), MOST_EVALUATIONS, TOLERANCE)
    return point_of(end.x), 2 * float(end.cost)


def profile_statements(of_all: Mapping[str, Profile]) -> list[str]:
    """Return the sentences on all profile likelihoods."""
    sentences = [_sentence(profile) for profile in of_all.values()]
    sentences += [
        identified.profile_refused(profile.name, profile.num_refused)
        for profile in of_all.values()
        if profile.num_refused
    ]
    better = max((profile.better for profile in of_all.values()), default=0.0)
    return [*sentences, identified.better_fit(better)] if better > FLAT else sentences


def _sentence(profile: Profile) -> str:
    low, high = profile.interval
    if profile.open == (False, False):
        # Print both ends of the interval with enough digits that its width shows two of them, and
        # with at least four significant digits.
        largest = max(abs(low), abs(high))
        needed = 2 + math.ceil(math.log10(largest / (high - low))) if high > low else 6
        ends = [f"{end:.{max(4, needed)}g}" for end in profile.interval]
        return identified.profile_interval(profile.name, ends)
    rise = float(np.max(profile.chi_square))
    if profile.open == (True, True):
        return identified.profile_open(profile.name, profile.interval, rise, flat=rise < FLAT)
    if profile.open[1]:
        return identified.profile_limit(profile.name, low, "below")
    return identified.profile_limit(profile.name, high, "above")
