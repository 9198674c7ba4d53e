"""The first fit of the joint to a dataset: its starting points, and the choice of the best.

Starting points come from a fit to frequency and damping against amplitude, without simulation.
"""

import logging
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float, Key

from jbw.campaign.settings import Identify
from jbw.errors import ModelError
from jbw.identification.coordinates import box_of
from jbw.identification.curve_fit import from_amplitude_curve
from jbw.identification.stated_modes import unknown_signs, with_signs
from jbw.identification.thresholds_crossed import log_evidence, other_sides
from jbw.identification.uncertain_shapes import first_factors
from jbw.inference.fit.costly_fit import costly_fit, costly_fits, parameters_at
from jbw.inference.fit.fitting import Fit
from jbw.inference.fit.identifiability import WeakDirection
from jbw.inference.generator import generator
from jbw.inference.lanes import at_points
from jbw.inference.space.box import Box, from_unit
from jbw.observables import dataset
from jbw.observables.dataset import Dataset
from jbw.observables.drives import by_secant, told_by
from jbw.parts import Parts, unkept
from jbw.quantities import STUCK, motion_factors_in
from jbw.report.messages import stages as messages

under_way = logging.getLogger("jbw.progress")
ROUGH = 1e-6  # relative tolerance of the sum of squares and of the step in preliminary fits
# Two fits have reached the same minimum if the relative difference of their sums of squares is
# below this.
SAME_COST = 10 * ROUGH
# number of random points of the prior that are evaluated in addition to the starting point
NUM_SCREENED = 255
# Rounds of additional starts if the best point does not explain the data: number of starts, and
# number of evaluations of each. The best fits of a round continue in the next one.
ROUNDS = ((11, 8), (4, 12), (2, 60))
# If chi-square per degree of freedom is smaller than this, the residuals are mainly noise.
EXPLAINED = 1.2


def first_fit(
    key: Key[Array, ""],
    data: Dataset,
    settings: Identify,
    known: Mapping[str, float] | None = None,
    *,
    start: Mapping[str, float] | None = None,
    alone: bool = False,
    parts: Parts = unkept,
) -> tuple[Box, Fit, Dataset]:
    """Fit a dataset from starting values; return prior bounds, the fit and the dataset.

    Default prior bounds follow from `known` values, measured without the joint's law, and never
    from `start`, the parameters of an earlier fit to the same data.

    The returned dataset contains the signs of modes at the joint, chosen by a rough fit and again
    by the final one. If the fit from the first start does not explain the data, further starts are
    tried unless `alone`. `parts` stores the fit, and the one across the laws' thresholds.
    """
    values = {**first_factors(data), **told_by(data.parts, data.held), **(known or {})}
    prior = box_of(settings, data, values)
    values |= start or {}
    if not set(prior.names) <= values.keys():
        values = from_amplitude_curve(key, data, prior, values) | values
    if unknown_signs(prior, data):
        begun, data = with_signs(fit_from(key, data, prior, values, alone=True), prior, data)
        values |= begun.theta
    fitted = partial(fit_from, key, data, prior, values, alone=alone)
    best, data = with_signs(parts("fit", fitted, Fit, WeakDirection), prior, data)
    across = partial(across_thresholds, best, prior, data)
    return prior, parts("fit across thresholds", across, Fit, WeakDirection), data


def fit_from(
    key: Key[Array, ""],
    data: Dataset,
    prior: Box,
    known: Mapping[str, float],
    *,
    alone: bool = False,
) -> Fit:
    """Fit all parameters by least squares, starting from known values and from likely points.

    If all values are known, as after the steps of Teloli et al., the fit starts there. Otherwise
    the likelihood of many points is evaluated, which costs less than one fit, and the fit starts at
    the best of them. If it does not explain the data, further starts are tried unless `alone`, and
    the best of them are continued.
    """
    ends: list[Fit] = []
    if set(prior.names) <= known.keys():
        with suppress(ModelError):  # The model cannot be solved at the known values.
            ends.append(costly_fit(dataset.stacked, prior, data, starts=inside(known, prior)))
        if ends and explains(ends[0]):
            return ends[0]
    start = middle_but(known, prior)
    guessed = by_secant(data.parts)
    names = [*(quantity.name for quantity in STUCK), *motion_factors_in(known)]
    sure = {name: known[name] for name in names if name in known.keys() - guessed}
    points = screened(key, prior, start, sure)
    under_way.info(messages.PRIOR_POINTS, NUM_SCREENED + 1)
    likelihood = at_points(dataset.log_likelihood, points, data).sum(axis=1)
    order = np.argsort(-np.nan_to_num(likelihood, nan=-np.inf))
    begun = [{name: float(x[row]) for name, x in points.items()} for row in order]
    ends.append(rough(begun[0], prior, data))
    if not (alone or explains(ends[-1])):
        ends += by_rounds(begun[1:], prior, data)
    return with_waterfall(min(ends, key=lambda end: end.cost), ends)


def across_thresholds(best: Fit, prior: Box, data: Dataset) -> Fit:
    """Fit on the other sides of the laws' thresholds, such as macroslip; return the best fit."""
    ends = by_rounds(other_sides(best, prior, data), prior, data)
    return with_waterfall(max([best, *ends], key=log_evidence), [best, *ends])


def with_waterfall(chosen: Fit, ends: Sequence[Fit]) -> Fit:
    """Return the chosen fit, together with the final costs of all fits in rising order."""
    return replace(chosen, waterfall=np.sort(np.concatenate([end.waterfall for end in ends])))


def by_rounds(begun: Sequence[Mapping[str, float]], prior: Box, data: Dataset) -> list[Fit]:
    """Fit from several starts in rounds, and continue the better fits; return the best fit first.

    If all have ended at one minimum, none is continued. If the best ends at a bound and does not
    explain the data, it has run along a valley to a wall of the prior, which is no optimum; then
    the other fits are continued too, one by one.
    """
    going, ends = [dict(theta) for theta in begun], []
    if not going:
        return []
    for number, evaluations in ROUNDS:
        under_way.info(messages.starts(min(number, len(going))))
        fits = roughly(going[:number], prior, data, evaluations)
        ends = sorted([*fits, *ends[number:]], key=lambda end: end.cost)
        going = [end.theta for end in ends]
        if explains(ends[0]):
            return [rough(going[0], prior, data), *ends[1:]]
        if len(ends) > 1 and ends[-1].cost <= (1 + SAME_COST) * ends[0].cost:
            break
    return further(ends, prior, data) if ends[0].at_bound else ends


def further(ends: Sequence[Fit], prior: Box, data: Dataset) -> list[Fit]:
    """Continue unfinished fits until one explains the data; return all fits, the best one first."""
    num = ROUNDS[-1][0]
    finished, stopped = list(ends[:num]), list(ends[num:])
    for place, end in enumerate(stopped):
        under_way.info(messages.FURTHER_START, place + 1, len(stopped))
        stopped[place] = rough(end.theta, prior, data)
        if explains(stopped[place]):
            break
    return sorted([*finished, *stopped], key=lambda fitted: fitted.cost)


def rough(theta: Mapping[str, Any], prior: Box, data: Dataset) -> Fit:
    """Return a preliminary fit from one start."""
    return roughly([theta], prior, data, ROUNDS[-1][1])[0]


def roughly(
    begun: Sequence[Mapping[str, Any]], prior: Box, data: Dataset, evaluations: int
) -> list[Fit]:
    """Return preliminary fits from several starts, each with a limited number of evaluations."""
    starts = {name: np.array([theta[name] for theta in begun]) for name in prior.names}
    return costly_fits(
        dataset.stacked, prior, data, starts=inside(starts, prior),
        max_evaluations=evaluations, tolerance=ROUGH,
    )  # fmt: skip


def explains(found: Fit) -> bool:
    """Return whether a fit's residuals are hardly more than the noise of the data."""
    chi_square, dof = found.chi_square
    return chi_square < EXPLAINED * dof


def screened(
    key: Key[Array, ""], prior: Box, start: Mapping[str, float], known: Mapping[str, float]
) -> dict[str, np.ndarray]:
    """Return trial points: the start, and random points of the prior that keep known values."""
    s = np.asarray(jax.random.uniform(key, (NUM_SCREENED, len(prior.names))))
    points = parameters_at(s, prior)
    points |= {n: np.full(NUM_SCREENED, known[n]) for n in points.keys() & known.keys()}
    return inside({name: np.append(start[name], points[name]) for name in prior.names}, prior)


def middle_but(known: Mapping[str, float], prior: Box) -> dict[str, float]:
    """Return the known parameter values, and for others the middle of their prior bounds."""
    middle = from_unit(np.full(len(prior.names), 0.5), prior)
    return {name: known.get(name, float(middle[name])) for name in prior.names}


def inside(starts: Mapping[str, Any], prior: Box) -> dict[str, np.ndarray]:
    """Return starting points moved into the prior bounds."""
    lower, upper = np.asarray(prior.lower), np.asarray(prior.upper)
    return {name: np.clip(starts[name], lower[i], upper[i]) for i, name in enumerate(prior.names)}


def steps_about(
    key: Key[Array, ""], best: Fit, num_draws: int
) -> Float[np.ndarray, "draw parameter"]:
    """Draw steps from the covariance of a fit; the first step is zero."""
    white = generator(key).standard_normal((num_draws, len(best.theta)))
    steps = white @ np.linalg.cholesky(best.covariance).T
    steps[0] = 0.0
    return steps


def points_at(
    steps: Float[np.ndarray, "draw parameter"], best: Fit, prior: Box
) -> dict[str, np.ndarray]:
    """Return the parameters at steps from a fit, moved into the prior bounds."""
    columns = (list(best.theta.values()) + steps).T
    return inside(dict(zip(best.theta, columns, strict=True)), prior)
