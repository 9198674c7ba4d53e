r"""The noise of data groups, from repeats and fits, and their effective numbers of values.

All functions read only columns of `Groups`: a mean of K repeats of N values, of which n are
independent, with the scatter S of the repeats about it.
"""

from collections.abc import Collection, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
from jaxtyping import Array, Float, Key

from jbw.inference.generator import generator
from jbw.inference.lanes import at_points, seeing, solved_first
from jbw.observables import groups as table
from jbw.observables.dataset import (
    Dataset,
    as_arrays,
    measured_parts,
    residual_by_label,
    sizes_of,
    solved,
    unnamed,
)
from jbw.observables.drives import of_drive
from jbw.observables.effective_values import correlated_fraction
from jbw.observables.groups import Covariance, Rows, changed, sizes
from jbw.observables.misfit import independent_fractions, shared_misfit
from jbw.observables.observable import Observable, Theta

SILENT = 1e-12  # factor by which the number of values of an ignored data group is multiplied

Draws = Float[np.ndarray, "chain draw"]
Drawn = Mapping[str, Float[np.ndarray, "..."]]  # parameters by name, including fixed ones


def num_known(data: Dataset) -> dict[str, float]:
    """Return the number of values of each data group whose noise is known before the fit."""
    known = {}
    for groups in (part.groups for part in data.parts):
        counts = np.asarray(groups.num_repeats), np.asarray(groups.size)
        rows = zip(groups.labels, *counts, strict=True)
        known |= {label: float(size) for label, count, size in rows if count > 1}
    return known


def repeatability(data: Dataset, *, of_mean: bool = False) -> dict[str, float]:
    r"""Return the standard deviation of each data group's repeats, or that of their mean.

    The scatter of the mean of K repeats is that of a single one divided by $\sqrt K$.
    """
    scatter: dict[str, float] = {}
    for part in measured_parts(data):
        count, within = (np.asarray(x) for x in (part.groups.num_repeats, part.groups.within))
        std = np.sqrt(within / np.maximum(count - 1, 1)) / (count**0.5 if of_mean else 1.0)
        rows = zip(sizes_of(part).items(), std.tolist(), count, strict=True)
        scatter |= {label: x / size for (label, size), x, k in rows if k > 1}
    return scatter


def evenly(part: Observable) -> Observable | None:
    """Weight each group of a dataset part by its rms; return None for priors and free decays."""
    groups = part.groups
    if groups.is_prior or part.own_shifts:
        return None
    size = sizes(part.mean, groups)
    columns = {
        "noise_std": np.where(size > 0, size, 1.0),
        "num_values": groups.size,
        "directions": np.asarray(groups.directions)[:, :0],
        "origin": np.asarray(groups.origin)[:, :0],
    }
    return replace(part, groups=changed(groups, **columns))


def with_discrepancy(residuals: Rows, data: Dataset) -> Dataset:
    """Return the dataset with the expected model error, the same fraction of each response."""

    def with_share(part: Observable) -> Observable:
        if part.groups.is_prior or part.own_shifts:
            return part
        share = shared_misfit(part.groups, sizes(part.mean, part.groups), residuals)
        return replace(part, groups=changed(part.groups, discrepancy=share))

    return replace(data, parts=tuple(map(with_share, data.parts)))


def with_fitted_noise(theta: Mapping[str, float], residuals: Rows, data: Dataset) -> Dataset:
    """Return the dataset with the noise of every data group from the residuals of a fit."""
    everything = as_arrays(theta, data)
    parts = tuple(
        p if p.groups.is_prior else p.with_fitted_noise(of_drive(everything, p.drive), residuals)
        for p in data.parts
    )
    return replace(data, parts=parts)


def effective_fractions(
    rows: Float[np.ndarray, " values"],
    jacobian: Float[np.ndarray, "values parameter"],
    covariance: Covariance,
    data: Dataset,
    expected: Dataset | None = None,
) -> dict[str, float]:
    """Return each data group's fraction of independent values, if its residual is correlated.

    `rows`, `jacobian` and `covariance` are of a fit to `data`; `expected` has the expected misfit.
    """
    residuals = residual_by_label(rows, data)
    columns = [residual_by_label(column, data) for column in np.asarray(jacobian).T]
    fractions: dict[str, float] = {}
    for part in measured_parts(expected or data):
        labels = part.groups.labels
        # The residuals of all records of one decay test have the same spectrum.
        if part.own_shifts:
            colour = correlated_fraction([residuals[label] for label in labels])
            fractions |= dict.fromkeys(labels, colour)
        else:
            fractions |= independent_fractions(part.groups, residuals, columns, covariance)
    return fractions


def fractions_counted(data: Dataset) -> dict[str, float]:
    """Return the fraction of each data group's values that the likelihood counts."""
    of_parts = (table.fractions_counted(part.groups) for part in measured_parts(data))
    return {label: fraction for of_part in of_parts for label, fraction in of_part.items()}


def with_effective_values(fractions: Mapping[str, float], data: Dataset) -> Dataset:
    """Return the dataset with given numbers of independent values; all values by default."""
    groups = (table.with_effective_values(fractions, part.groups) for part in data.parts)
    pairs = zip(data.parts, groups, strict=True)
    return replace(data, parts=tuple(replace(part, groups=own) for part, own in pairs))


def silenced(labels: Collection[str], data: Dataset) -> Dataset:
    """Return a dataset whose likelihood ignores the named groups, in arrays of the same shape."""
    return with_effective_values(fractions_counted(data) | dict.fromkeys(labels, SILENT), data)


def draw_noise(
    key: Key[Array, ""],
    theta: Drawn,
    terms: Mapping[str, Draws],
    part: Observable,
    num_offsets: int,
) -> dict[str, Draws]:
    r"""Draw the noise of each data group exactly, once for every draw of the parameters.

    $$\sigma^2 \mid \theta \sim \frac{n}{NK}\,Q(\theta) / \chi^2_{n - q}, \qquad
      \log p = -\tfrac n2 \log Q$$

    Q, over all N K values, is taken from the stored terms of the log likelihood, without another
    solve. Records with q own unknowns are not in these terms, and are solved for.
    """
    groups, count = part.groups, np.asarray(part.groups.num_values)
    if part.own_shifts:
        squares, num_free = squares_at(theta, part), count - groups.num_own
    else:
        rows = np.stack([terms[label] for label in groups.labels], axis=-1)
        squares, num_free = np.exp(-2 * rows / count), count - num_offsets
    chi_square = generator(key).chisquare(num_free, squares.shape)
    noise = np.sqrt(count / np.asarray(groups.num_counted) * squares / chi_square)
    return {label: noise[..., i] for i, label in enumerate(groups.labels)}


def squares_at(theta: Drawn, part: Observable) -> Float[np.ndarray, "... group"]:
    """Return each data group's sum of squared residuals at every draw of the parameters."""
    shape = np.broadcast_shapes(*(np.shape(values) for values in theta.values()))
    points = {name: np.ravel(np.broadcast_to(values, shape)) for name, values in theta.items()}
    return at_points(_squares, points, Dataset.of([part])).reshape(*shape, -1)


@seeing(unnamed)
@solved_first(partial(solved, writes=False))
def _squares(theta: Theta, data: Dataset) -> Float[Array, " group"]:
    return data.parts[0].residual_sums(theta)[0]
