r"""From a dataset to what is sampled: one way for all that fit or draw the joint.

First values, the box, the fit, and what it shows: noise, effective values, run effects,
coordinates, steps of the solver. The noise of a group and the number of its independent values are
what a fit leaves, and the fit is weighted by them: a fixed point, $w = W(\hat\theta(w))$. Its
iteration stops after one round, and one more where runs get effects of their own, which change
what is left: a further round moves the weights by less than they are known.
"""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import jax
import numpy as np
from jaxtyping import Array, Key

from jbw.campaign.settings import Identify
from jbw.identification.accuracy import NUM_DRAWS, SHIFT, solver_change
from jbw.identification.assemble import Report, assemble, measured
from jbw.identification.coordinates import PAPER, box_of, chosen_coordinates, coordinate_box
from jbw.identification.run_effects import recentred, sentence_of, shifts_of, wanted, with_offsets
from jbw.identification.starts import first_values, fit_from, from_amplitude_curve, inside
from jbw.inference.fit.costly_fit import costly_fit
from jbw.inference.fit.fitting import Fit
from jbw.inference.space.box import Box
from jbw.measurement.records import Test
from jbw.observables.dataset import (
    Dataset,
    by_label,
    effective_fractions,
    halved,
    left_by_label,
    stacked,
    with_effective_values,
    with_fitted_noise,
)

logger = logging.getLogger("jbw")
MOST_SUBSTEPS = 16


@dataclass(frozen=True)
class Fitted:
    """A fit of the joint with what it was fitted to, ready to be drawn from.

    Attributes:
        fit: Least squares in the box.
        box: The prior, in the coordinates to sample in.
        data: The dataset with the noise, effective values and run effects that were found; its
            residual is `jbw.observables.dataset.stacked`.
        statements: What the fit showed, a sentence each.
        chi_square: Of the first fit over the groups whose noise repeats tell, and its degrees of
            freedom; None without such groups.
    """

    fit: Fit
    box: Box
    data: Dataset
    statements: tuple[str, ...] = ()
    chi_square: tuple[float, int] | None = None


def fit_joint(
    tests: Sequence[Test],
    settings: Identify,
    *,
    laws: tuple[str, ...] | None = None,
    gain: float | None = None,
    seed: int = 0,
    report: Report = logger.info,
) -> Fitted:
    """Fit the joint to a campaign as the joint posterior would, in the paper's parameters.

    Arguments as of `run_procedure`; `coordinates` of the settings is not read.

    Raises:
        DataError: If there is nothing that the joint can be fitted to.
    """
    data = assemble(measured(tests, settings, laws=laws, gain=gain, report=report))
    report(f"Least squares: all parameters from {len(data.labels)} groups of data")
    settings = settings.model_copy(update={"coordinates": PAPER})
    return prepare(jax.random.split(jax.random.key(seed)), data, settings)


def prepare(
    keys: Sequence[Key[Array, ""]] | Key[Array, " two"],
    data: Dataset,
    settings: Identify,
    known: Mapping[str, float] | None = None,
) -> Fitted:
    """First values, the box, the fit from them, and what the fit settles.

    Args:
        keys: Random keys of the starts and of the steps of the solver.
        data: What was measured.
        settings: The campaign's [identify] table.
        known: Values that earlier steps know.
    """
    values = {**first_values(data), **(known or {})}
    prior = box_of(settings, data, values)
    values = {**from_amplitude_curve(keys[0], data, prior, values), **values}
    first = fit_from(keys[0], data, prior, values)
    found = reweight(keys[1], data, prior, first, settings)
    best = replace(found.fit, waterfall=first.waterfall)  # the later fits have one start
    return replace(found, fit=best, chi_square=explained(first, data))


def explained(first: Fit, data: Dataset) -> tuple[float, int] | None:
    """Chi-square of a fit over the groups whose noise is known from repeats, and its degrees."""
    sizes = {label: size for part in data.parts for label, size in part.noise_known().items()}
    if not sizes:
        return None
    rows = by_label(first.residual, data)
    total = sum(float(np.sum(rows[label] ** 2)) for label in sizes)
    return total, max(int(sum(sizes.values())) - len(first.x), 1)


def reweight(
    key: Key[Array, ""], data: Dataset, prior: Box, first: Fit, settings: Identify
) -> Fitted:
    """Noise, effective values and run effects as fits show them; coordinates and solver steps."""
    words = []
    data = with_weights(first, data, settings)
    best = refit(first, prior, data)
    shifts = shifts_of(best, prior.names, data)
    if shifts is not None and wanted(shifts, settings):
        words.append(sentence_of(shifts))
        data = with_offsets(best, shifts, data)
        best = refit(best, prior, data)
        # The offsets that are known now are where records are linearised in them.
        data = recentred(best, data)
        best = refit(best, prior, data)
        data = with_weights(best, data, settings)
        best = refit(best, prior, data)
    for chosen in chosen_coordinates(best, settings, data.laws):
        prior = coordinate_box(prior, best.theta, settings, chosen)
        start = chosen.coordinates.from_parameters(best.theta)
        best = refit(best, prior, data, theta=start)
        words.append(chosen.sentence)
    if settings.substeps is None:
        finer = refined(key, data, prior, best)
        if finer is not data:
            data, best = finer, refit(best, prior, finer)
    return Fitted(best, prior, data, tuple(words))


def with_weights(best: Fit, data: Dataset, settings: Identify) -> Dataset:
    """The dataset with the noise that a fit leaves, and as many values as are independent."""
    noisy = with_fitted_noise(best.theta, left_by_label(best.residual, data), data)
    if settings.model_error == "none":
        return noisy
    fractions = effective_fractions(best.residual, best.jacobian, best.covariance, data)
    return with_effective_values(fractions, noisy)


def refit(best: Fit, prior: Box, data: Dataset, *, theta: Mapping[str, float] | None = None) -> Fit:
    """The fit again, from where it ended."""
    start = inside(theta or best.theta, prior)
    return costly_fit(stacked, prior, data, starts=start)


def refined(key: Key[Array, ""], data: Dataset, prior: Box, best: Fit) -> Dataset:
    """The dataset with so many solver steps that halving them would not matter to the fit."""
    white = np.asarray(jax.random.normal(key, (NUM_DRAWS, len(best.theta))))
    draws = list(best.theta.values()) + white @ np.linalg.cholesky(best.covariance).T
    theta = inside(dict(zip(best.theta, draws.T, strict=True)), prior)
    for _ in range(int(np.log2(MOST_SUBSTEPS)) - 1):
        change = solver_change(theta, data)
        if change is None or np.std(change) < SHIFT:
            break
        data = halved(data) or data
    return data
