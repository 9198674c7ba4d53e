"""The misfit of a law to repeated data, as a fraction of the response, and the resulting weights.

Weights by each group's own misfit would give little weight to a record that a poor fit misses, and
the next fit would miss it more. Therefore the law's misfit is the same fraction of the response in
all groups of an observable, and this fraction determines the weight of each group.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jbw.observables.effective_values import (
    BY_CHANCE,
    LEAST_VALUES,
    MISFIT,
    effective_fraction,
    is_coloured,
)
from jbw.observables.groups import Covariance, Groups, Rows


def group_residuals(groups: Groups, residuals: Rows) -> list[tuple[float, float, bool]]:
    """Return mean squares of noise and misfit of each group, and whether misfit is significant.

    The noise is determined from repeats if there are any.
    """
    misfits, arrays = [], (groups.num_repeats, groups.size, groups.within)
    numbers = zip(groups.labels, *(np.asarray(x, float).tolist() for x in arrays), strict=True)
    for label, count, size, within in numbers:
        row = residuals[label]
        square, coloured = float(np.sum(np.abs(row) ** 2)) / size, is_coloured(row)
        if count > 1:
            noise = within / (size * (count - 1))
        else:
            noise = 0.0 if coloured else square
        misfit = max(square - noise / count, 0.0)
        misfits.append((noise, misfit, coloured or count * misfit > MISFIT * noise))
    return misfits


def shared_misfit(
    groups: Groups, sizes: Float[np.ndarray, " group"], residuals: Rows
) -> Float[np.ndarray, " group"]:
    r"""Return the mean-square model error expected of each data group.

    $$\tau_g^2 = \rho^2\,\frac{|\bar d_g|^2}{N_g}, \qquad
      \rho^2 = \frac1G \sum_g \frac{|r_g|^2 - N_g \sigma_g^2 / K_g}{|\bar d_g|^2}$$

    for residuals r_g and means of size $|\bar d_g|$, with sigma the scatter of the repeats; a group
    whose residual is noise adds nothing to rho.
    """
    square = sizes**2 / np.asarray(groups.size)
    misfit = [x if counts else 0.0 for _, x, counts in group_residuals(groups, residuals)]
    return np.mean(misfit / np.where(square > 0, square, 1.0)) * square


def independent_fractions(
    groups: Groups, residuals: Rows, columns: Sequence[Rows], covariance: Covariance
) -> dict[str, float]:
    r"""Return the fraction of independent values of each data group that has a model error.

    $$f = \frac{(a + b)^2}{a^2 + 2ab + b^2 / w}\,\frac{m^2 + \sigma^2 + \tau^2}{a + b}, \qquad
      a = \sigma^2, \quad b = K \tau^2$$

    for the misfit m^2 and its expectation tau^2, which are the same in all K repeats. The first
    factor is the effective number of values of a sum of white noise and misfit, of which the share
    w is independent. The second corrects for the likelihood, whose noise includes m, sigma and tau
    as variance. w, a measure of the colour, is the harmonic mean over the misfitted groups.
    """
    fractions, colours = {}, []
    group_misfits = group_residuals(groups, residuals)
    for label, (_, _, is_misfit) in zip(groups.labels, group_misfits, strict=True):
        slopes = np.stack([column[label] for column in columns])
        fraction = effective_fraction(residuals[label], slopes, covariance)
        if is_misfit:
            colours.append(fraction)
        # The noise is large where the prediction is sensitive to the parameters.
        elif fraction <= BY_CHANCE:
            fractions[label] = fraction
    if not colours:
        return fractions
    colour = len(colours) / sum(1 / coloured_fraction for coloured_fraction in colours)
    for i, (label, (noise, misfit, _)) in enumerate(zip(groups.labels, group_misfits, strict=True)):
        expected = float(groups.discrepancy[i])
        common = float(groups.num_repeats[i]) * expected
        both = noise + common
        independent = both**2 / (noise**2 + 2 * noise * common + common**2 / colour)
        fraction = independent * (misfit + noise + expected) / both
        if fraction < 1.0:
            fractions[label] = max(fraction, min(1.0, LEAST_VALUES / float(groups.size[i])))
    return fractions
