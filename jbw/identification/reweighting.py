r"""From a first fit to what is sampled: noise, effective values, run effects, coordinates, steps.

The noise of a group and the number of its independent values are what a fit leaves, and the fit
is weighted by them: a fixed point, $w = W(\hat\theta(w))$. Its iteration stops after one round,
and one more where runs get effects of their own, which change what is left: a further round moves
the weights by less than they are known.
"""

from collections.abc import Mapping
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Key

from jbw.campaign.settings import Identify
from jbw.identification.accuracy import NUM_DRAWS, SHIFT, solver_change
from jbw.identification.coordinates import chosen_coordinates, coordinate_box
from jbw.identification.run_effects import recentred, sentence_of, shifts_of, wanted, with_offsets
from jbw.identification.starts import inside
from jbw.inference.fit.costly_fit import costly_fit
from jbw.inference.fit.fitting import Fit
from jbw.inference.space.box import Box
from jbw.observables.dataset import Dataset, halved, stacked
from jbw.observables.weighting import (
    effective_fractions,
    left_by_label,
    with_effective_values,
    with_fitted_noise,
)

MOST_SUBSTEPS = 16


class Reweighted(NamedTuple):
    """What is sampled.

    Attributes:
        box: Its prior.
        fit: The fit in this box.
        data: The dataset with its weights.
        words: What was found, a sentence each.
    """

    box: Box
    fit: Fit
    data: Dataset
    words: list[str]


def reweight(
    key: Key[Array, ""], data: Dataset, prior: Box, first: Fit, settings: Identify
) -> Reweighted:
    """Noise, effective values and run effects as fits show them; coordinates and solver steps.

    Args:
        key: Random key.
        data: What was measured.
        prior: The box.
        first: The first fit.
        settings: The campaign's [identify] table.
    """
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
    return Reweighted(prior, best, data, words)


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
    """The dataset with so many steps of the solver that halving them would not matter.

    Args:
        key: Random key of draws from the fit's Gaussian.
        data: The dataset.
        prior: The box.
        best: The fit.
    """
    white = np.asarray(jax.random.normal(key, (NUM_DRAWS, len(best.theta))))
    draws = list(best.theta.values()) + white @ np.linalg.cholesky(best.covariance).T
    theta = inside(dict(zip(best.theta, draws.T, strict=True)), prior)
    for _ in range(int(np.log2(MOST_SUBSTEPS)) - 1):
        change = solver_change(theta, data)
        if change is None or np.std(change) < SHIFT:
            break
        data = halved(data) or data
    return data
