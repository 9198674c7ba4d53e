"""Directions of the parameters that the data do not determine, said in words."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.linalg import eigh, qr

from jbw.inference.space.box import Box, prior_std

Matrix = Float[np.ndarray, "parameter parameter"]
UNLEARNT = 0.7  # posterior over prior standard deviation: the data have not halved the variance
PRESENT = 0.3  # a parameter belongs to a direction from this share of its largest component on
NEAR = 0.2  # an exponent this close to a multiple of 1/2 is written as that


@dataclass(frozen=True)
class WeakDirection:
    """Parameters that the data determine only together, or not at all.

    Attributes:
        names: The parameters involved.
        ratio: Posterior over prior standard deviation along the weakest direction.
        text: Which combination is determined, in words.
    """

    names: tuple[str, ...]
    ratio: float
    text: str


def weak_direction(mean: Mapping[str, float], covariance: Matrix, box: Box) -> WeakDirection | None:
    r"""Find the directions along which the posterior is nearly as wide as the prior.

    $$\Sigma_{post} v = \rho^2 \Sigma_{prior} v, \qquad \rho > 0.7$$

    in the logarithms of the parameters whose box is positive, so that products appear, and in the
    parameters themselves otherwise. The combinations orthogonal to all such directions are what
    the data determine.

    Args:
        mean: Posterior mean, or the optimum of a fit, by name.
        covariance: Covariance in the parameters' units, in the order of `box.names`.
        box: The prior box.

    Returns:
        The weak direction, or None where there is no such direction.
    """
    lower, upper = np.asarray(box.lower), np.asarray(box.upper)
    positive = lower > 0
    centre = np.array([float(mean[name]) for name in box.names])
    slope = np.where(positive, 1 / np.where(positive, centre, 1.0), 1.0)
    posterior = covariance * np.outer(slope, slope)
    prior = np.array([prior_std(a, b) for a, b in zip(lower, upper, strict=True)])
    squares, scaled = eigh(posterior / np.outer(prior, prior))
    weak = scaled[:, squares > UNLEARNT**2]
    if weak.shape[1] == 0:
        return None
    weight = np.linalg.norm(weak, axis=1)
    members = np.flatnonzero(weight > PRESENT * weight.max())
    names = tuple(box.names[i] for i in members)
    ratio = float(np.sqrt(squares[-1]))
    directions = weak[members] * prior[members, None]
    return WeakDirection(
        names, ratio, _in_words(names, directions, bool(np.all(positive[members])))
    )


def weak_direction_of_draws(
    draws: Mapping[str, NDArray[np.float64]], box: Box
) -> WeakDirection | None:
    """The same from draws of a posterior.

    Returns:
        The weak direction, or None where there is no such direction.
    """
    columns = np.array([np.ravel(draws[name]) for name in box.names])
    means = dict(zip(box.names, columns.mean(axis=1).tolist(), strict=True))
    return weak_direction(means, np.atleast_2d(np.cov(columns)), box)


def _in_words(
    names: tuple[str, ...], directions: Float[np.ndarray, "parameter weak"], logs: bool
) -> str:
    if len(names) <= directions.shape[1]:
        return f"{listed(names)} {'is' if len(names) == 1 else 'are'} not determined by the data"
    combinations = [combination(names, row, logs) for row in _determined(directions)]
    noun = ("product" if logs else "combination") + ("s" if len(combinations) > 1 else "")
    verb = "are" if len(combinations) > 1 else "is"
    return f"only the {noun} {listed(combinations)} {verb} determined"


def _determined(
    directions: Float[np.ndarray, "parameter weak"],
) -> Float[np.ndarray, "combination parameter"]:
    """Exponents orthogonal to the weak directions, each with one parameter of exponent 1."""
    # The parameters that move most along the weak directions are those that combinations share.
    decomposition: Any = qr(directions.T, mode="r", pivoting=True)
    order = decomposition[1]
    num_weak = directions.shape[1]
    shared, own = order[:num_weak], np.sort(order[num_weak:])
    mixing = np.linalg.solve(directions[shared].T, directions[own].T).T
    exponents = np.zeros((len(own), len(directions)))
    exponents[np.arange(len(own)), own] = 1.0
    exponents[:, shared] = -mixing
    return exponents


def combination(names: Sequence[str], exponents: NDArray[np.float64], logs: bool) -> str:
    """A product of powers, or a sum where not `logs`, in words; exponents near halves rounded."""
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
    fraction = Fraction(exponent).limit_denominator(2)
    text = (
        f"({fraction})" if fraction == exponent and fraction.denominator == 2 else f"{exponent:g}"
    )
    return f"{name}^{text}"


def listed(items: Sequence[str]) -> str:
    """Names in a sentence."""
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} and {items[-1]}"
