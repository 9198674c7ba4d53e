"""What a first fit settles: noise, worth, offsets of runs, coordinates, steps of the solver."""

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Key

from jbw.identification.accuracy import NUM_DRAWS, SHIFT, halved, solver_change
from jbw.identification.coordinates import by_products, product_box, products_of
from jbw.identification.shifts import recentred, sentence_of, shifts_of, wanted, with_offsets
from jbw.identification.starts import inside
from jbw.identification.worth import worth_by_label
from jbw.inference.box import Box
from jbw.inference.costly_fit import costly_fit
from jbw.inference.fitting import Fit
from jbw.observables.evidence import Evidence, residual
from jbw.observables.weighing import left_by_label, with_fitted_noise, with_worth

MOST_SUBSTEPS = 16


def settled(
    key: Key[Array, ""],
    data: Evidence,
    prior: Box,
    first: Fit,
    settings: Mapping[str, Any],
) -> tuple[Box, Fit, Evidence, list[str]]:
    """Noise, worth and offsets as the first fit shows them, coordinates and steps that they take.

    Args:
        key: Random key.
        data: What was measured.
        prior: The box.
        first: The first fit.
        settings: The campaign's [identify] table.

    Returns:
        The box and the fit in the coordinates to sample in, the evidence, and what was found, in
        words.
    """
    data = weighed(first, data, settings)
    best = again(first, prior, data)
    words = []
    shifts = shifts_of(best, prior.names, data)
    if shifts is not None and wanted(shifts, settings):
        data = with_offsets(best, shifts, data)
        best = again(best, prior, data)
        data = recentred(best, data)
        best = again(best, prior, data)
        data = weighed(best, data, settings)
        best = again(best, prior, data)
        words.append(sentence_of(shifts))
    if by_products(best, settings):
        prior = product_box(prior, best.theta, settings)
        best = again(best, prior, data, theta=products_of(best.theta))
        words.append(
            "The data know alpha, delta and gamma by their products alone: alpha*delta and "
            "alpha*gamma are sampled, and alpha's share of the stiffness beside them."
        )
    if "substeps" not in settings:
        finer = refined(key, data, prior, best)
        if finer is not data:
            data, best = finer, again(best, prior, finer)
    return prior, best, data, words


def weighed(best: Fit, data: Evidence, settings: Mapping[str, Any]) -> Evidence:
    """The evidence with the noise that a fit leaves, and as many values as that is worth."""
    left = with_fitted_noise(left_by_label(best.residual, data), data)
    if settings.get("model_error", "auto") == "none":
        return left
    return with_worth(worth_by_label(best, data), left)


def again(
    best: Fit, prior: Box, data: Evidence, *, theta: Mapping[str, float] | None = None
) -> Fit:
    """The fit again, from where it ended."""
    start = inside(theta or best.theta, prior)
    return costly_fit(residual, prior, data, starts=start)


def refined(key: Key[Array, ""], data: Evidence, prior: Box, best: Fit) -> Evidence:
    """The evidence with so many steps of the solver that halving them would not matter.

    Args:
        key: Random key of draws from the fit's Gaussian.
        data: The evidence.
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
