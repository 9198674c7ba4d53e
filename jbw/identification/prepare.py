r"""Preparation of a dataset for sampling: fit, noise, weights, run effects, coordinates.

The noise of a group and the number of its independent values are estimated from the residual of a
fit, and the fit is weighted by them: a fixed point, $w = W(\hat\theta(w))$. The error of the law is
common to all groups of a kind, relative to their size. Weights that followed the misfit of each
group would reduce the weight of a badly fitted record, which would then be fitted even worse.
"""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Array, Key

from jbw.campaign.settings import Identify
from jbw.identification.accuracy import NUM_DRAWS, SHIFT, explained, solver_change
from jbw.identification.assemble import Measured, Report, assemble
from jbw.identification.coordinates import (
    chosen_coordinates,
    coordinate_box,
    coordinates_sentence,
)
from jbw.identification.first_fit import ROUGH, first_fit, inside, points_at, steps_about
from jbw.identification.residual_terms import shown_terms
from jbw.identification.run_effects import (
    damping_scatter,
    sentence_of,
    shifts_of,
    trend_finding,
    wanted,
    with_offsets,
    with_scatter,
)
from jbw.identification.size import announced
from jbw.identification.thresholds_crossed import fitted_displacement
from jbw.inference.fit.costly_fit import TOLERANCE, costly_fit
from jbw.inference.fit.fitting import Fit
from jbw.inference.generator import parts_of
from jbw.inference.lanes import at_points, forget
from jbw.inference.posterior.finding import Finding
from jbw.inference.space.box import Box
from jbw.observables import dataset, noise
from jbw.observables.dataset import Dataset
from jbw.report.messages import stages as messages

under_way = logging.getLogger("jbw.progress")
MOST_SUBSTEPS = 64
# Factor on steps from a fit. So close to the fit, even a curved posterior is nearly Gaussian.
NEAR = 1e-3
# The solver steps are short enough if the solver's error is below this fraction of the allowed
# error.
AMPLE = 0.5
MOST_ROUNDS = 8  # largest number of rounds of fit and weighting
SETTLED = 0.1  # Weights are final if the fit moves by fewer standard deviations than this.


@dataclass(frozen=True)
class Fitted:
    """A fit of the joint with its prior and dataset, ready for sampling."""

    fit: Fit  # least-squares fit within the prior bounds
    box: Box  # the prior, in the sampled coordinates
    data: Dataset  # the data with noise, effective numbers of values, and differences between runs
    statements: tuple[str, ...] = ()  # sentences on the fit
    # Chi-square and degrees of freedom of the first fit, over data groups whose noise repeats
    # determine.
    chi_square: tuple[float, int] | None = None
    findings: tuple[Finding, ...] = ()  # findings on the fit, for the verdict
    wall_s: float = 0.0  # time taken, including compilation

    @property
    def y_peak(self) -> float:
        """The largest fitted displacement [m]."""
        return fitted_displacement(self.fit.theta, self.data)


def fit_joint(key: Key[Array, ""], seen: Measured, report: Report) -> Fitted:
    """Fit the joint to a campaign in the same way as the joint posterior does."""
    data = assemble(seen)
    announced(report, messages.least_squares, data)
    return prepare(parts_of(key, 2), data, seen.settings)


def prepare(
    keys: Key[Array, " two"] | Sequence[Key[Array, ""]],
    data: Dataset,
    settings: Identify,
    known: Mapping[str, float] | None = None,
    *,
    start: Mapping[str, float] | None = None,
    quick: bool = False,
) -> Fitted:
    """Fit a dataset from `known` and starting values, and determine weights and coordinates.

    If `quick`, the solver's steps are not refined.
    """
    ready = weighed(keys, data, settings, known, start=start, quick=quick)
    return completed(keys[1], ready, settings, quick=quick)


def weighed(
    keys: Key[Array, " two"] | Sequence[Key[Array, ""]],
    data: Dataset,
    settings: Identify,
    known: Mapping[str, float] | None = None,
    *,
    start: Mapping[str, float] | None = None,
    quick: bool = False,
) -> Fitted:
    """Fit a dataset and determine its weights; leave coordinates and solver steps as they are."""
    prior, first, data = first_fit(keys[0], data, settings, known, start=start)
    ready = with_effects(keys[1], data, prior, first, settings, quick=quick)
    # Later fits need only one start: the first optimum.
    best = replace(ready.fit, waterfall=first.waterfall)
    return replace(ready, fit=best, chi_square=explained(first, data))


def reweight(
    key: Key[Array, ""],
    data: Dataset,
    prior: Box,
    first: Fit,
    settings: Identify,
) -> Fitted:
    """Update noise, effective values, run offsets, coordinates and solver steps by new fits."""
    return completed(key, with_effects(key, data, prior, first, settings), settings)


def with_effects(
    key: Key[Array, ""],
    data: Dataset,
    prior: Box,
    first: Fit,
    settings: Identify,
    *,
    quick: bool = False,
) -> Fitted:
    """Update noise, effective values, run offsets and residual terms by repeated fits."""
    words: list[str] = []
    findings: tuple[Finding, ...] = ()
    between = ROUGH if quick else TOLERANCE  # tolerance of the fits between the rounds
    best, data = settled(first, prior, data, settings, tolerance=between)
    shifts = shifts_of(best, prior.names, data)
    if shifts is not None and wanted(shifts, settings):
        words.append(sentence_of(shifts, damping_scatter(best, shifts, data)))
        findings = tuple(filter(None, [trend_finding(shifts, data)]))
        under_way.info("offsets of the runs")
        data = with_offsets(best, shifts, data, settings.run_scatter)
        best = refit(best, prior, data, tolerance=between)
        # Linearise the records about the offsets of this fit.
        data = dataset.with_directions(best.theta, data, dataset.best_offsets(best.theta, data))
        best = refit(best, prior, data, tolerance=between)
        best, data = settled(best, prior, data, settings, tolerance=between)
        data = with_scatter(key, best, data)
        best = refit(best, prior, data)
    if (shown := shown_terms(best, prior, data, settings, refit)) is not None:
        prior, best = shown.box, shown.fit
        words += shown.words
        best, data = settled(best, prior, data, settings)
    return Fitted(best, prior, data, tuple(words), findings=findings)


def completed(
    key: Key[Array, ""], weighted: Fitted, settings: Identify, *, quick: bool = False
) -> Fitted:
    """Choose the sampling coordinates of a weighted fit, and refine the solver steps as needed."""
    best, prior, data = weighted.fit, weighted.box, weighted.data
    words = list(weighted.statements)
    for law, coordinates in chosen_coordinates(best, settings, data.laws):
        prior = coordinate_box(prior, best.theta, settings, law, coordinates)
        best = refit(best, prior, data, theta=coordinates.from_parameters(best.theta))
        words.append(coordinates_sentence(law, coordinates))
    if settings.substeps is None and not quick:
        # Check once more with finer steps, because the optimum may have moved.
        for _ in range(2):
            under_way.info("steps of the solver")
            finer = refined(key, data, prior, best)
            if finer is data:
                break
            forget()  # This releases the programs of coarser steps.
            data, best = finer, refit(best, prior, finer)
    best = replace(best, waterfall=weighted.fit.waterfall)
    return replace(weighted, fit=best, box=prior, data=data, statements=tuple(words))


def settled(
    best: Fit, prior: Box, data: Dataset, settings: Identify, *, tolerance: float = TOLERANCE
) -> tuple[Fit, Dataset]:
    """Repeat the fit and its weighting until the fit no longer moves; return fit and dataset."""
    for count in range(1, MOST_ROUNDS + 1):
        under_way.info(messages.REWEIGHTING, count, MOST_ROUNDS)
        before = np.asarray(best.x)
        data = with_weights(best, data, settings)
        best = refit(best, prior, data, tolerance=ROUGH)
        width = np.asarray(prior.upper) - np.asarray(prior.lower)
        moved = (best.x - before) * width / np.sqrt(np.diag(best.covariance))
        if np.all(np.abs(moved) < SETTLED):
            break
    return refit(best, prior, data, tolerance=tolerance), data


def with_weights(best: Fit, data: Dataset, settings: Identify) -> Dataset:
    """Return the dataset with noise, model error and effective values from a fit's residual."""
    residuals = dataset.residual_by_label(best.residual, data)
    if settings.model_error == "none":
        return noise.with_fitted_noise(best.theta, residuals, data)
    expected = noise.with_discrepancy(residuals, data)
    fractions = noise.effective_fractions(
        best.residual, best.jacobian, best.covariance, data, expected
    )
    noisy = noise.with_fitted_noise(best.theta, residuals, expected)
    return noise.with_effective_values(fractions, noisy)


def refit(
    best: Fit,
    prior: Box,
    data: Dataset,
    *,
    theta: Mapping[str, float] | None = None,
    tolerance: float = TOLERANCE,
) -> Fit:
    """Fit again, starting from the last optimum; start new parameters at zero."""
    start = inside(dict.fromkeys(prior.names, 0.0) | dict(theta or best.theta), prior)
    return costly_fit(dataset.stacked, prior, data, starts=start, tolerance=tolerance)


def refined(key: Key[Array, ""], data: Dataset, prior: Box, best: Fit) -> Dataset:
    """Return the dataset with solver steps so short that shorter ones would not change the fit.

    It also gets as much memory for nested loops as the motion of the fit needs.
    """
    data = dataset.remembering(best.theta, data)
    if dataset.halved(data) is None:
        return data
    # If the posterior is curved, draws with the covariance of the fit lie outside the posterior.
    # Their median log likelihood is then lower than that of the fit by more than 1 per parameter
    # (by 1/2 for a Gaussian). The steps are then shortened: close to the fit every posterior is
    # nearly Gaussian.
    steps = steps_about(key, best, NUM_DRAWS)
    values = at_points(dataset.log_likelihood, points_at(steps, best, prior), data).sum(axis=1)
    near = 1.0 if values[0] - np.median(values) <= len(best.theta) else NEAR
    theta = points_at(near * steps, best, prior)
    for _ in range(int(np.log2(MOST_SUBSTEPS)) - 1):
        change = solver_change(theta, data)
        if change is None or np.std(change) < near * AMPLE * SHIFT:
            break
        data = dataset.halved(data) or data
    return data
