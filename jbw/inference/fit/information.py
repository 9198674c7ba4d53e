"""What a fit's data know of the parameters beside their prior, before anything is sampled."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jbw.inference.fit.fitting import Fit, svd_of_all
from jbw.inference.fit.identifiability import PRESENT, RESOLVED, UNLEARNT, combination
from jbw.inference.space.box import Box, Product, alone, gradient_of, log_prior_std, value_of
from jbw.inference.thresholds import KNOWN, LEARNT, ROUGHLY
from jbw.report.messages import identified
from jbw.report.messages.message import listed

SENSIBLE = 10.0  # an exponent beyond tells of boxes of unlike widths, and of no combination
AS_WELL = 2.0  # a name may be known so many times worse than its direction
TOLD_APART = 0.5  # a product this much better known than its factors is said to tie them


@dataclass(frozen=True)
class Direction:
    """One direction of the parameters, and the data's information along it over the prior's.

    `names` are the parameters that make it up and `loadings` the shares of all, in prior standard
    deviations, in the box's order; `text` is their combination, of leading exponent 1, and `sd` its
    deviation, relative for a product, NaN for a mixture; `ratio` is posterior over prior deviation.
    """

    information: float
    ratio: float
    names: tuple[str, ...]
    text: str
    sd: float
    loadings: NDArray[np.float64]


@dataclass(frozen=True)
class QuantityInformation:
    """A parameter or product in words, its value, and its deviation, also over the prior's."""

    text: str
    value: float
    sd: float
    ratio: float

    @property
    def relative(self) -> float:
        """Standard deviation over value; infinite at zero."""
        return self.sd / abs(self.value) if self.value else math.inf


@dataclass(frozen=True)
class Information:
    """The Fisher information of a fit: directions, the strongest first, parameters and products."""

    names: tuple[str, ...]
    directions: tuple[Direction, ...]
    known: dict[str, QuantityInformation]


def information(best: Fit, box: Box, products: Iterable[Product] = ()) -> Information:
    r"""Fisher information of the data against the prior's, direction by direction.

    $$J^T J\,v = \lambda\,\Lambda\,v, \qquad \rho = (1 + \lambda)^{-1/2}, \qquad
      \Sigma = (J^T J + \Lambda)^{-1}$$

    with J the residual's derivatives in units of the noise and Lambda the inverse variances of the
    prior, in the logarithms of parameters that are positive and distinct from zero, and in the
    parameters themselves otherwise. A product f has the variance $\nabla f^T \Sigma \nabla f$.
    """
    theta = np.array([best.theta[name] for name in box.names])
    lower, upper = np.asarray(box.lower), np.asarray(box.upper)
    # The logarithm is the coordinate where the box is positive, or the data say non-zero.
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
    """Parameters that name a direction: as many as it takes for the name to be as well known.

    A factor that its prior knows well moves the direction little, yet without it the others are
    known far worse than the direction is: alpha*delta to a millionth says nothing of delta.
    """
    count = int(np.sum(np.abs(row) > PRESENT * np.max(np.abs(row))))
    while count < len(order):
        named = np.where(np.isin(np.arange(len(row)), order[:count]), exponents, 0.0)
        if np.linalg.norm(named @ root) <= AS_WELL * ratio * np.linalg.norm(named * prior):
            break
        count += 1
    return [int(i) for i in order[:count]]


def statements(spectrum: Information, products: Iterable[Product] = ()) -> list[str]:
    """What the data know of parameters and `products`, and what not, in words with numbers."""
    sentences = [directions_sentence(spectrum)]
    rows = list(spectrum.known.values())
    for kind in identified.GRADES:
        if of_kind := [_with_error(row) for row in rows if _kind(row) == kind]:
            sentences.append(identified.grade(kind, of_kind))
    return [*sentences, *ties(spectrum, products)]


def directions_sentence(spectrum: Information) -> str:
    """How many directions of the parameters the data know better than the prior does."""
    learnt = sum(direction.ratio < UNLEARNT for direction in spectrum.directions)
    return identified.directions(learnt, len(spectrum.directions))


def ties(spectrum: Information, products: Iterable[Product]) -> list[str]:
    """Which products are known better than their factors."""
    return [sentence for product in products for sentence in _tie(spectrum.known, product)]


def _kind(row: QuantityInformation) -> str:
    """By the criterion that the report grades parameters by, after sampling."""
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
    """That a product is known better than its factors, where it is."""
    row = rows[product.name]
    factors = [rows[name].relative for name in product.factors if name in rows]
    if _is_unlearnt(row) or not factors or row.relative >= TOLD_APART * min(factors):
        return []
    return [identified.tie(product.text, min(factors) / row.relative)]
