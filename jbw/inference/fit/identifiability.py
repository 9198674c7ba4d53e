"""How data and prior bounds determine a posterior: weak directions, sensitivity to bounds."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.linalg import eigh, qr

from jbw.inference.space.box import (
    Box,
    Product,
    bounds_by_name,
    log_prior_of,
    log_prior_std,
    prior_of,
    value_of,
)
from jbw.report.messages import identified

Matrix = Float[np.ndarray, "parameter parameter"]
# A direction is weak if the posterior's sd along it is more than this fraction of the prior's.
UNLEARNT = 0.7
# A parameter belongs to a direction if its component exceeds this fraction of the largest one.
PRESENT = 0.3
# Logarithms are used for a parameter that is this many standard deviations away from zero.
RESOLVED = 2.0
NEAR = 0.2  # An exponent closer than this to a multiple of 1/2 is rounded to it.
# fraction of the prior range (or of the posterior's width, if smaller) that is removed at one end
CUT = 0.1
WIDTH = 8.0  # width of a posterior in standard deviations
FOLLOWS = 0.1  # smallest reported shift of a posterior mean, in sd; a uniform one shifts by 0.17
LEAST_SHARE = 0.01  # smallest fraction of the draws that must remain after a cut

Draws = Mapping[str, Float[np.ndarray, "..."]]


@dataclass(frozen=True)
class WeakDirection:
    """Parameters that data determine only in combination, or not at all, and a sentence on them."""

    names: tuple[str, ...]
    ratio: float
    text: str


def weak_direction(mean: Mapping[str, float], covariance: Matrix, box: Box) -> WeakDirection | None:
    r"""Return the directions along which the posterior is nearly as wide as the prior, or None.

    $$\Sigma_{post} v = \rho^2 \Sigma_{prior} v, \qquad \rho > 0.7$$

    Logarithms are used for parameters that cannot be zero, by their box or by the data, so that
    products appear, and the parameters themselves otherwise.
    """
    centre = np.array([float(mean[name]) for name in box.names])
    logs = (np.asarray(box.lower) > 0) | _never_zero(centre, covariance)
    slope = np.where(logs, 1 / np.where(logs, centre, 1.0), 1.0)
    return _weak(covariance * np.outer(slope, slope), logs, box)


def weak_direction_of_draws(draws: Draws, box: Box) -> WeakDirection | None:
    """Return the least determined directions of posterior draws, or None.

    Both logarithms and the parameters themselves are tried. If the data exclude only a part of a
    box over decades, a parameter may look narrower in its logarithm without being determined.
    """
    columns = np.array([np.ravel(draws[name]) for name in box.names])
    one_sign = np.all(columns > 0, axis=1) | np.all(columns < 0, axis=1)
    never_zero = _never_zero(columns.mean(axis=1), np.atleast_2d(np.cov(columns)))
    logs = one_sign & ((np.asarray(box.lower) > 0) | never_zero)
    plain = np.atleast_2d(np.cov(columns))
    columns[logs] = np.log(np.abs(columns[logs]))
    weakest = _weak(np.atleast_2d(np.cov(columns)), logs, box)
    return weakest or _weak(plain, np.zeros_like(logs), box)


def _never_zero(centre: NDArray[np.float64], covariance: Matrix) -> NDArray[np.bool_]:
    """Return the parameters that clearly differ from zero when all other parameters are fixed."""
    std = np.sqrt(np.diag(covariance))
    # The draws have no variation if no chain has ever moved.
    if not (np.all(np.isfinite(covariance)) and np.all(std > 0)):
        return np.zeros(len(std), bool)
    conditional = std / np.sqrt(np.diag(np.linalg.pinv(covariance / np.outer(std, std))))
    return np.abs(centre) > RESOLVED * conditional


def _weak(posterior: Matrix, logs: NDArray[np.bool_], box: Box) -> WeakDirection | None:
    """Return the least determined directions of a covariance of parameters or their logarithms."""
    bounds = bounds_by_name(box).values()
    prior = np.array(
        [
            log_prior_std(low, high) if log else (high - low) / math.sqrt(12)
            for (low, high), log in zip(bounds, logs, strict=True)
        ]
    )
    squares, scaled = eigh(posterior / np.outer(prior, prior))
    weak = scaled[:, squares > UNLEARNT**2]
    if weak.shape[1] == 0:
        return None
    weight = np.linalg.norm(weak, axis=1)
    members = np.flatnonzero(weight > PRESENT * weight.max())
    names = tuple(box.names[i] for i in members)
    directions = weak[members] * prior[members, None]
    text = _in_words(names, directions, bool(np.all(logs[members])))
    return WeakDirection(names, float(np.sqrt(squares[-1])), text)


def _in_words(
    names: tuple[str, ...], directions: Float[np.ndarray, "parameter weak"], logs: bool
) -> str:
    rows = _determined(directions) if len(names) > directions.shape[1] else ()
    combinations = [combination(names, row, logs) for row in rows]
    if set(combinations) <= set(names):  # There is no combination of several parameters.
        return identified.undetermined([name for name in names if name not in combinations])
    return identified.determined(combinations, logs=logs)


def _determined(
    directions: Float[np.ndarray, "parameter weak"],
) -> Float[np.ndarray, "combination parameter"]:
    """Return the exponents of each combination of parameters that the data determine."""
    # Each combination may contain any of the parameters that vary most along the weak directions.
    first = 1 / (1 + NEAR * np.arange(len(directions)))
    decomposition: Any = qr(directions.T * first, mode="r", pivoting=True)
    order = decomposition[1]
    num_weak = directions.shape[1]
    shared, determined = order[:num_weak], np.sort(order[num_weak:])
    mixing = np.linalg.solve(directions[shared].T, directions[determined].T).T
    exponents = np.zeros((len(determined), len(directions)))
    exponents[np.arange(len(determined)), determined] = 1.0
    exponents[:, shared] = -mixing
    return exponents


def combination(names: Sequence[str], exponents: NDArray[np.float64], logs: bool) -> str:
    """Format a product of powers (if `logs`) or a weighted sum of parameters; round the numbers."""
    parts = [
        (name, _rounded(float(exponent)))
        for name, exponent in zip(names, exponents, strict=True)
        if abs(exponent) > NEAR / 2
    ]
    if not logs:
        terms = [name if factor == 1 else f"{factor:g} {name}" for name, factor in parts]
        return " + ".join(terms).replace("+ -", "- ")
    over = [_power(name, exponent) for name, exponent in parts if exponent > 0]
    under = [_power(name, -exponent) for name, exponent in parts if exponent < 0]
    return "*".join(over) + "".join(f"/{factor}" for factor in under)


def _rounded(exponent: float) -> float:
    nearest = round(2 * exponent) / 2
    return nearest if nearest and abs(exponent - nearest) <= NEAR else round(exponent, 2)


def _power(name: str, exponent: float) -> str:
    if exponent == 1:
        return name
    half = Fraction(exponent).limit_denominator(2)
    is_whole = half.denominator == 1 or half != exponent
    return f"{name}^{exponent:g}" if is_whole else f"{name}^({half})"


@dataclass(frozen=True)
class Sensitivity:
    """The largest shift of a posterior mean [sd] when a prior's range is cut at one end."""

    shift: float
    box: str
    end: str


def contraction(draws: Draws, box: Box, products: Iterable[Product]) -> dict[str, float]:
    r"""Return each product's contraction, $1 - \mathrm{var}_{post} / \mathrm{var}_{prior}$.

    It is NaN if the prior's variance is infinite. Logarithms are used as in `information`: in a box
    over decades, a value known to within a factor of two would otherwise count as determined.
    """
    learnt, bounds = {}, bounds_by_name(box)
    for product in products:
        values = np.ravel(value_of(product, draws))
        if all(_positive(draws[name], bounds[name][0]) for name in product.powers):
            values, prior = np.log(values), log_prior_of(product, box)
        else:
            prior = prior_of(product, box)[1]
        ratio = float(np.std(values, ddof=1)) / prior
        learnt[product.name] = 1 - ratio**2 if math.isfinite(prior) else math.nan
    return learnt


def _positive(draws: Float[np.ndarray, "..."], lower: float) -> bool:
    """Return whether bounds make a parameter positive, or its draws lie clearly above zero."""
    if lower != 0:
        return lower > 0
    return bool(np.min(draws) > 0 and np.mean(draws) > RESOLVED * np.std(draws))


def box_sensitivity(draws: Draws, box: Box) -> dict[str, Sensitivity]:
    r"""Return the shift of each posterior mean if a tenth of the parameter's range is removed.

    $$\frac{E[\theta \mid \theta_i \in B'] - E[\theta]}{\mathrm{sd}(\theta)}$$

    The draws within the narrower box B' are draws of its posterior. If a posterior is far narrower
    than its box, a tenth of its own eight standard deviations is cut: a larger cut would remove all
    of it and not test the bound. A parameter that is as uniform as its prior shifts by 0.17, one
    that is pressed against a bound by more. Either shifts parameters that are determined only
    together with it.
    """
    flat = {name: np.ravel(values) for name, values in draws.items()}
    worst = {name: Sensitivity(0.0, "", "") for name in flat}
    for name, (low, high) in bounds_by_name(box).items():
        step = CUT * min(high - low, WIDTH * float(np.std(flat[name])))
        kept_by = {"lower": flat[name] > low + step, "upper": flat[name] < high - step}
        for end, inside in kept_by.items():
            for other, values in flat.items():
                shift = _shift(values, inside)
                if shift > worst[other].shift:
                    worst[other] = Sensitivity(shift, name, end)
    return worst


def _shift(values: Float[np.ndarray, " draw"], inside: NDArray[np.bool_]) -> float:
    sd = float(np.std(values))
    if np.all(inside) or sd == 0:
        return 0.0
    if np.mean(inside) < LEAST_SHARE:
        return math.inf
    return abs(float(np.mean(values[inside]) - np.mean(values))) / sd


def sensitivity_statements(
    sensitivity: Mapping[str, Sensitivity], texts: Mapping[str, str] | None = None
) -> list[str]:
    """Return sentences on the means that depend on prior bounds; `texts` gives display names."""
    shown = texts or {}
    following = {name: row for name, row in sensitivity.items() if row.shift > FOLLOWS}
    moves = [
        identified.follows_bound(shown.get(name, name), row.shift, f"{row.end} bound of {row.box}")
        for name, row in following.items()
    ]
    return [identified.box_sensitivity(moves)]
