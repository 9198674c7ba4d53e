"""What a fit leaves of every group of data, and the dataset weighted by it."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from jbw.observables.dataset import Dataset, as_arrays, by_label
from jbw.observables.observable import Row


def left_by_label(rows: Float[np.ndarray, " values"], data: Dataset) -> dict[str, Row]:
    """What a fit leaves of the mean of each group, in its unit; complex where its values are.

    Args:
        rows: `stacked` at the fit, or a column of its Jacobian.
        data: The dataset.
    """
    labelled = by_label(rows, data)
    found: dict[str, Row] = {}
    for part in data.parts:
        found |= part.in_units(labelled)
    return found


def size_by_label(data: Dataset) -> dict[str, float]:
    """Root of the sum of squares of the mean of each group of `left_by_label`."""
    return {label: size for part in data.parts for label, size in part.sizes().items()}


def error_by_label(left: Mapping[str, Row], data: Dataset) -> dict[str, float]:
    """Size of what a fit leaves of the mean of each group, over that of the mean.

    Args:
        left: From `left_by_label`.
        data: The dataset.
    """
    sizes = size_by_label(data)
    return {label: float(np.linalg.norm(left[label])) / size for label, size in sizes.items()}


def with_fitted_noise(
    theta: Mapping[str, float], left: Mapping[str, Row], data: Dataset
) -> Dataset:
    """The dataset with the noise that a fit leaves in every group.

    Args:
        theta: The fit.
        left: From `left_by_label`.
        data: The dataset.
    """
    everything = as_arrays(theta, data)
    parts = tuple(part.with_fitted_noise(everything, left) for part in data.parts)
    return replace(data, parts=parts)


def effective_fractions(
    rows: Float[np.ndarray, " values"],
    jacobian: Float[np.ndarray, "values parameter"],
    covariance: Float[np.ndarray, "parameter parameter"],
    data: Dataset,
) -> dict[str, float]:
    """Fraction of independent values of each group that is coloured, or misfitted in all repeats.

    Args:
        rows: `stacked` at a fit.
        jacobian: Its derivatives by the parameters.
        covariance: Of the fit.
        data: The dataset that was fitted.

    Returns:
        Fractions below one, by label.
    """
    left = left_by_label(rows, data)
    columns = [left_by_label(column, data) for column in np.asarray(jacobian).T]
    found: dict[str, float] = {}
    for part in data.parts:
        found |= part.effective_fractions(left, columns, covariance)
    return found


def with_effective_values(fractions: Mapping[str, float], data: Dataset) -> Dataset:
    """The dataset with as many independent values as the residuals have.

    Args:
        fractions: Fraction of independent values, by label; 1 where not named.
        data: The dataset.
    """
    parts = tuple(part.with_effective_values(fractions) for part in data.parts)
    return replace(data, parts=parts)


def fractions_counted(data: Dataset) -> dict[str, float]:
    """Fraction of the values of each group that the likelihood counts."""
    return {label: f for part in data.parts for label, f in part.fractions_counted().items()}
