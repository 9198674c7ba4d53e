"""Is a joint seen at all? The fit beside that of the same structure without one."""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, Key
from scipy import stats

from jbw.identification.equivalent import Effects
from jbw.identification.first_fit import points_at, steps_about
from jbw.inference.fit.costly_fit import costly_fit
from jbw.inference.fit.fitting import Fit
from jbw.inference.lanes import at_points
from jbw.inference.posterior.finding import Finding
from jbw.inference.posterior.summary import QUANTILES
from jbw.inference.space.box import Box, bounds_by_name, box
from jbw.observables.dataset import Dataset, log_likelihood, stacked
from jbw.quantities import RESIDUAL_TERMS, STUCK

FAR = 5.0  # standard deviations from zero: beyond, a joint is seen without a further fit
NUM_DRAWS = 256
BY_CHANCE = 0.01  # probability of as much better a fit, of data of a structure without a joint


class Nested(NamedTuple):
    """How much chi-square grows without the joint, and by how many parameters it has less."""

    growth: float
    num_parameters: int
    fit: Fit  # of the oscillator alone
    bounds: Mapping[str, tuple[float, float]]  # its prior


def without_joint(best: Fit, prior: Box, data: Dataset) -> Nested:
    """The fit of the oscillator alone, to the same data in the same weights."""
    names = {quantity.name for quantity in (*STUCK, *RESIDUAL_TERMS)}
    bounds = {name: pair for name, pair in bounds_by_name(prior).items() if name in names}
    bare = replace(data, parts=tuple(replace(part, laws=()) for part in data.parts))
    start = {name: best.theta[name] for name in bounds}
    nested_fit = costly_fit(stacked, box(bounds), bare, starts=start)
    growth = 2 * (nested_fit.cost - best.cost)
    return Nested(growth, len(best.theta) - len(bounds), nested_fit, bounds)


def likely(
    key: Key[Array, ""], best: Fit, prior: Box, data: Dataset
) -> dict[str, Float[np.ndarray, " draw"]]:
    r"""Points about a fit that the data do not rule out at 99 %, by name.

    Of those drawn by its covariance, within the prior, that lose no more than half of the quantile
    of $\chi^2_k$ in log likelihood; the fit itself first.
    """
    theta = points_at(steps_about(key, best, NUM_DRAWS), best, prior)
    values = at_points(log_likelihood, theta, data).sum(axis=1)
    least = float(stats.chi2.isf(BY_CHANCE, len(best.theta))) / 2
    keep = values >= values[0] - least
    return {name: x[keep] for name, x in theta.items()}


def joint_finding(nested: Nested, added: Effects, y_peak: float) -> Finding:
    r"""Whether the joint fits better than none, by the likelihood ratio of nested models.

    $$\chi^2_{without} - \chi^2 > F^{-1}_{\chi^2_k}(0.99)$$

    of k parameters more. Where it does not, the bounds on what it may do are the answer.
    """
    least = float(stats.chi2.isf(BY_CHANCE, nested.num_parameters))
    is_seen = nested.growth > least
    if is_seen:
        grown = {"growth": nested.growth, "least": least}
        return Finding("no_joint", "ok", grown, nested.growth)
    shift, damping = (float(np.quantile(np.abs(change), QUANTILES[-1])) for change in added)
    values = {
        "y": y_peak, "frequency": shift, "damping": damping, "growth": max(nested.growth, 0.0)
    }  # fmt: skip
    return Finding("no_joint", "failed", values, nested.growth)


def may_be_absent(added: Effects) -> bool:
    """Whether the posterior hardly tells from zero how the joint changes the frequency."""
    return bool(abs(np.median(added.frequency)) < FAR * np.std(added.frequency))
