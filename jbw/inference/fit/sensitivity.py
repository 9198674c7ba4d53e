"""What a posterior owes to its data and what to its box, from the draws alone."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from jbw.inference.fit.identifiability import listed
from jbw.inference.fit.information import RESOLVED
from jbw.inference.space.box import Box, Product, log_prior_of, prior_of, value_of

CUT = 0.1  # of the box's width, or of the posterior's where that is less
WIDTH = 8.0  # standard deviations: width of a posterior
FOLLOWS = 0.1  # standard deviations; a posterior that is its uniform prior moves by 0.17
LEAST_SHARE = 0.01  # of the draws that a cut must leave for their mean to be one

Draws = Mapping[str, Float[np.ndarray, "..."]]


@dataclass(frozen=True)
class Sensitivity:
    """How far a mean moves when a bound does.

    Attributes:
        shift: Largest move of the mean, in posterior standard deviations; infinite where a cut
            leaves hardly a draw.
        box: The parameter whose box was cut.
        end: "lower" or "upper".
    """

    shift: float
    box: str
    end: str


def contraction(draws: Draws, box: Box, products: Iterable[Product]) -> dict[str, float]:
    r"""How much the data narrowed each product, $1 - \mathrm{var}_{post} / \mathrm{var}_{prior}$.

    Of the logarithms of what is positive and distinct from zero, as in `information`: in a box over
    decades, a value known to within a factor of two is otherwise taken for known. Of the values
    themselves where they may be zero or negative.

    Args:
        draws: Draws of the box's parameters, by name.
        box: The prior box.
        products: The combinations.

    Returns:
        1 for what is known, 0 for what is not, by name; NaN where the prior's variance is infinite.
    """
    found = {}
    for product in products:
        values = np.ravel(value_of(product, draws))
        if _in_logs(draws, product, box):
            values, prior = np.log(values), log_prior_of(product, box)
        else:
            prior = prior_of(product, box)[1]
        ratio = float(np.std(values, ddof=1)) / prior
        found[product.name] = 1 - ratio**2 if math.isfinite(prior) else math.nan
    return found


def _in_logs(draws: Draws, product: Product, box: Box) -> bool:
    """Whether each factor is positive by its box, or by the data in a box from zero on."""
    return all(
        float(box.lower[box.names.index(name)]) > 0 or _resolved(draws[name], name, box)
        for name in product.powers
    )


def _resolved(draws: Float[np.ndarray, "..."], name: str, box: Box) -> bool:
    if float(box.lower[box.names.index(name)]) < 0 or np.min(draws) <= 0:
        return False
    return float(np.mean(draws)) > RESOLVED * float(np.std(draws))


def box_sensitivity(draws: Draws, box: Box, cut: float = CUT) -> dict[str, Sensitivity]:
    r"""Largest move of every mean when a tenth of a parameter's box is cut off at either end.

    $$\frac{E[\theta \mid \theta_i \in B'] - E[\theta]}{\mathrm{sd}(\theta)}$$

    The draws that the narrower box B' keeps are draws of its posterior. Of a posterior that is far
    narrower than its box, a tenth of its own eight standard deviations is cut: a larger cut would
    take the posterior as a whole, and say nothing of the bound. What is known from data does not
    move; a parameter as uniform as its prior moves by 0.17, one that leans on a bound by more, and
    either takes along those that are known only together with it.

    Args:
        draws: Draws by name: the box's parameters, and whatever else is to be looked at.
        box: The prior box.
        cut: Share of the width of the box or of the posterior, the narrower of the two.

    Returns:
        For every name of `draws`, the cut that moves its mean most.
    """
    flat = {name: np.ravel(values) for name, values in draws.items()}
    found = {name: Sensitivity(0.0, "", "") for name in flat}
    for i, name in enumerate(box.names):
        low, high = float(box.lower[i]), float(box.upper[i])
        step = cut * min(high - low, WIDTH * float(np.std(flat[name])))
        kept_by = {"lower": flat[name] > low + step, "upper": flat[name] < high - step}
        for end, kept in kept_by.items():
            for other, values in flat.items():
                shift = _shift(values, kept)
                if shift > found[other].shift:
                    found[other] = Sensitivity(shift, name, end)
    return found


def _shift(values: Float[np.ndarray, " draw"], kept: NDArray[np.bool_]) -> float:
    sd = float(np.std(values))
    if np.all(kept) or sd == 0:
        return 0.0
    if np.mean(kept) < LEAST_SHARE:
        return math.inf
    return abs(float(np.mean(values[kept]) - np.mean(values))) / sd


def sensitivity_statements(
    found: Mapping[str, Sensitivity], texts: Mapping[str, str] | None = None
) -> list[str]:
    """Which means follow the box, in a sentence.

    Args:
        found: From `box_sensitivity`.
        texts: Names for sentences, where they differ.
    """
    called = texts or {}
    following = {n: each for n, each in found.items() if each.shift > FOLLOWS}
    if not following:
        return ["No mean follows the box: a tenth less of it at either end moves none by 0.1 sd."]
    listed_ = [
        f"{called.get(name, name)} ({_size(each.shift)} by the {each.end} bound of {each.box})"
        for name, each in following.items()
    ]
    return [
        "A box narrower by a tenth moves the posterior mean of "
        f"{listed(listed_)}: there the box speaks as well as the data."
    ]


def _size(shift: float) -> str:
    return f"{shift:.2g} sd" if math.isfinite(shift) else "out of the rest of the box"
