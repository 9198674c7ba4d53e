r"""From a dataset to what is sampled: one way for all that fit or draw the joint.

First values, the box, the fit, and what it shows: noise, effective values, run effects,
coordinates, steps of the solver. The noise of a group and the number of its independent values are
what a fit leaves, and the fit is weighted by them: a fixed point, $w = W(\hat\theta(w))$. What
the law misses is shared by all groups of a kind, relative to their size: weights that followed the
misfit of each would let a record that a poor fit misses lose its voice, and be missed the more.
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
NEAR = 1e-3  # of a fit's standard deviations: where even a bent posterior is straight
AMPLE = 0.5  # of what the verdict allows the solver: draws about a fit are not the posterior
MOST_ROUNDS = 8  # of fits and weights in turns
SETTLED = 0.1  # standard deviations: what a further round may move the fit by


@dataclass(frozen=True)
class Fitted:
    """A fit of the joint with what it was fitted to, ready to be drawn from."""

    fit: Fit  # least squares of `jbw.observables.dataset.stacked` in the box
    box: Box  # the prior, in the coordinates to sample in
    data: Dataset  # with the noise, effective values and run effects that were found
    statements: tuple[str, ...] = ()  # what the fit showed, a sentence each
    # Of the first fit over the groups whose noise repeats tell, and its degrees of freedom.
    chi_square: tuple[float, int] | None = None
    findings: tuple[Finding, ...] = ()  # of the same, for the verdict
    wall_s: float = 0.0  # that it took, compiling included

    @property
    def y_peak(self) -> float:
        """The largest displacement fitted [m]."""
        return fitted_displacement(self.fit.theta, self.data)


def fit_joint(key: Key[Array, ""], seen: Measured, report: Report) -> Fitted:
    """Fit the joint to a campaign as the joint posterior would."""
    data = assemble(seen)
    report(messages.least_squares(len(data.labels)))
    return prepare(parts_of(key, 2), data, seen.settings)


def prepare(
    keys: Key[Array, " two"] | Sequence[Key[Array, ""]],
    data: Dataset,
    settings: Identify,
    known: Mapping[str, float] | None = None,
    *,
    quick: bool = False,
) -> Fitted:
    """Prepare first values and the box, fit from them and `known` values, and settle the weights.

    Where it is to be `quick`, one start does that meets the data, and the solver's steps are taken
    as they are.
    """
    ready = weighed(keys, data, settings, known, quick=quick)
    return completed(keys[1], ready, settings, quick=quick)


def weighed(
    keys: Key[Array, " two"] | Sequence[Key[Array, ""]],
    data: Dataset,
    settings: Identify,
    known: Mapping[str, float] | None = None,
    *,
    quick: bool = False,
) -> Fitted:
    """Make the first fit and settle its weights, before coordinates and solver steps."""
    prior, first, data = first_fit(keys[0], data, settings, known, quick=quick)
    ready = with_effects(keys[1], data, prior, first, settings, quick=quick)
    best = replace(ready.fit, waterfall=first.waterfall)  # the later fits have one start
    return replace(ready, fit=best, chi_square=explained(first, data))


def reweight(
    key: Key[Array, ""],
    data: Dataset,
    prior: Box,
    first: Fit,
    settings: Identify,
) -> Fitted:
    """Update noise, effective values, run effects, coordinates and solver steps by new fits."""
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
    """Update a fit with the noise, effective values, run effects and terms that fits show."""
    words: list[str] = []
    findings: tuple[Finding, ...] = ()
    between = ROUGH if quick else TOLERANCE  # of fits that others follow
    best, data = settled(first, prior, data, settings, tolerance=between)
    shifts = shifts_of(best, prior.names, data)
    if shifts is not None and wanted(shifts, settings):
        words.append(sentence_of(shifts, damping_scatter(best, shifts, data)))
        findings = tuple(filter(None, [trend_finding(shifts, data)]))
        under_way.info("offsets of the runs")
        data = with_offsets(best, shifts, data, settings.run_scatter)
        best = refit(best, prior, data, tolerance=between)
        # The offsets that are known now are where records are linearised in them.
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
    """Complete a weighted fit: sampling coordinates, and as many solver steps as needed."""
    best, prior, data = weighted.fit, weighted.box, weighted.data
    words = list(weighted.statements)
    for law, coordinates in chosen_coordinates(best, settings, data.laws):
        prior = coordinate_box(prior, best.theta, settings, law, coordinates)
        best = refit(best, prior, data, theta=coordinates.from_parameters(best.theta))
        words.append(coordinates_sentence(law, coordinates))
    if settings.substeps is None and not quick:
        # Looked at again where the finer solver's fit is: a coarse one may lie elsewhere.
        for _ in range(2):
            under_way.info("steps of the solver")
            finer = refined(key, data, prior, best)
            if finer is data:
                break
            forget()  # the programs of coarser steps
            data, best = finer, refit(best, prior, finer)
    best = replace(best, waterfall=weighted.fit.waterfall)
    return replace(weighted, fit=best, box=prior, data=data, statements=tuple(words))


def settled(
    best: Fit, prior: Box, data: Dataset, settings: Identify, *, tolerance: float = TOLERANCE
) -> tuple[Fit, Dataset]:
    """Return the fits and the weights that they leave, in turns until the weights move no more."""
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
    """Return the dataset with the noise, misfit and effective values that a fit leaves."""
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
    """Return the fit again, from where it ended; what it did not know begins at zero."""
    start = inside(dict.fromkeys(prior.names, 0.0) | dict(theta or best.theta), prior)
    return costly_fit(dataset.stacked, prior, data, starts=start, tolerance=tolerance)


def refined(key: Key[Array, ""], data: Dataset, prior: Box, best: Fit) -> Dataset:
    """Return the dataset with so many solver steps that halving them would not matter to the fit.

    And with as much memory of loops within loops as the motion of the fit asks for.
    """
    data = dataset.remembering(best.theta, data)
    if dataset.halved(data) is None:
        return data
    theta, near = _about(key, data, prior, best)
    for _ in range(int(np.log2(MOST_SUBSTEPS)) - 1):
        change = solver_change(theta, data)
        if change is None or np.std(change) < near * AMPLE * SHIFT:
            break
        data = dataset.halved(data) or data
    return data


def _about(
    key: Key[Array, ""], data: Dataset, prior: Box, best: Fit
) -> tuple[dict[str, np.ndarray], float]:
    r"""Return the draws by a fit's covariance, and by what factor they are nearer than these.

    Where the posterior bends they have left it: their log likelihood lies farther below the fit's
    than twice the half that a Gaussian's does a parameter. Close to the fit all is straight.
    """
    steps = steps_about(key, best, NUM_DRAWS)
    points = points_at(steps, best, prior)
    values = at_points(dataset.log_likelihood, points, data).sum(axis=1)
    near = 1.0 if values[0] - np.median(values) <= len(best.theta) else NEAR
    return points_at(near * steps, best, prior), near
