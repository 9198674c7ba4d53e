r"""Tests of the joint against simpler models: no joint, or drag instead of hysteresis.

Without a joint, the structure is linear. With drag in place of the laws, there is damping without
softening: in weak slip, Bouc-Wen without softening ($\delta = 0$) adds the damping of a force
$c\,v|v|$:

$$\Delta\zeta = \frac{2}{3\pi}\,\frac{\alpha\gamma Y}{\omega_n^2} = \frac{4}{3\pi}\,c\,Y, \qquad
  \frac{|\Delta\omega|}{\omega_n} = \frac{2}{3\pi}\,\frac{\alpha\delta Y}{\omega_n^2}$$

A fit of hysteresis to data with drag ends there, with narrow intervals of meaningless parameters.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, Key
from scipy import stats

from jbw.identification.equivalent import DAMPING, Effects
from jbw.identification.first_fit import points_at, steps_about
from jbw.inference.fit.costly_fit import costly_fit
from jbw.inference.fit.fitting import Fit
from jbw.inference.lanes import at_points
from jbw.inference.posterior.finding import Finding
from jbw.inference.posterior.summary import QUANTILES
from jbw.inference.space.box import Box, bounds_by_name, box
from jbw.observables.dataset import Dataset, log_likelihood, stacked
from jbw.oscillator.law import feels_rate
from jbw.oscillator.laws import laws_named
from jbw.quantities import RESIDUAL_TERMS, STUCK

# A joint is detected without a further fit if its effect is this many standard deviations away from
# zero.
FAR = 5.0
NUM_DRAWS = 256
# A larger model is preferred if chance alone would improve the fit as much with a probability below
# this.
BY_CHANCE = 0.01
# Drag is fitted too if the ratio of relative frequency change to added damping is below this. The
# ratio is 1 for gamma = delta, and 3 pi / 4 for Masing's loops of a quadratic backbone.
SOFTENS = 0.5
ROOM = 8.0  # upper bound of the drag coefficient, relative to its starting value


class Nested(NamedTuple):
    """A fit with a simpler model: increase of chi-square, and number of omitted parameters."""

    growth: float
    num_parameters: int
    fit: Fit  # fit of the simpler oscillator
    bounds: Mapping[str, tuple[float, float]]  # prior of the simpler oscillator


def without_joint(best: Fit, prior: Box, data: Dataset) -> Nested:
    """Fit an oscillator without a joint to the same data, with the same weights."""
    return _nested(best, prior, data, (), {})


def likely(
    key: Key[Array, ""], best: Fit, prior: Box, data: Dataset
) -> dict[str, Float[np.ndarray, " draw"]]:
    r"""Return, by name, parameter values near a fit that the data do not exclude (99 %).

    Points are drawn from the covariance of the fit, within the prior. A point is kept if its log
    likelihood is lower by no more than half of the quantile of $\chi^2_k$. The first point is the
    fit.
    """
    theta = points_at(steps_about(key, best, NUM_DRAWS), best, prior)
    values = at_points(log_likelihood, theta, data).sum(axis=1)
    least = float(stats.chi2.isf(BY_CHANCE, len(best.theta))) / 2
    keep = values >= values[0] - least
    return {name: x[keep] for name, x in theta.items()}


def joint_finding(nested: Nested, added: Effects, y_peak: float) -> Finding:
    r"""Return the finding on whether a joint is detected, by a likelihood-ratio test.

    $$\chi^2_{without} - \chi^2 > F^{-1}_{\chi^2_k}(0.99)$$

    with k additional parameters. If the joint does not fit better, the bounds on its effect are the
    result.
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
    """Return whether the joint's frequency change is within five standard deviations of zero."""
    return bool(abs(np.median(added.frequency)) < FAR * np.std(added.frequency))


def may_be_drag(added: Effects, zeta: float, laws: Sequence[str]) -> bool:
    """Return whether the joint adds damping but softens the structure less than slip would."""
    if not laws or any(map(feels_rate, laws_named(laws))):
        return False
    shift = np.quantile(np.abs(added.frequency), QUANTILES[-1])
    damping = zeta * np.quantile(added.damping, QUANTILES[0])
    return bool(damping > 0.0 and shift < SOFTENS * damping)


def with_drag(best: Fit, prior: Box, data: Dataset, damping: float, y_peak: float) -> Nested:
    """Fit an oscillator with drag in place of the laws, to the same data with the same weights.

    The fit starts where drag adds the damping ratio that the laws add at y_peak [m].
    """
    return _nested(best, prior, data, (DAMPING,), {DAMPING: 0.75 * np.pi * damping / y_peak})


def _nested(
    best: Fit, prior: Box, data: Dataset, laws: tuple[str, ...], firsts: Mapping[str, float]
) -> Nested:
    """Fit an oscillator with other laws to the same data, from given starting values."""
    names = {quantity.name for quantity in (*STUCK, *RESIDUAL_TERMS)}
    bounds = {name: pair for name, pair in bounds_by_name(prior).items() if name in names}
    starts = {name: best.theta[name] for name in bounds} | dict(firsts)
    bounds |= {name: (0.0, ROOM * first) for name, first in firsts.items()}
    simpler = replace(data, parts=tuple(replace(part, laws=laws) for part in data.parts))
    nested_fit = costly_fit(stacked, box(bounds), simpler, starts=starts)
    growth = 2 * (nested_fit.cost - best.cost)
    return Nested(growth, len(best.theta) - len(bounds), nested_fit, bounds)


def drag_finding(drag: Nested, added: Effects, y_peak: float, *, misses: bool) -> Finding:
    r"""Return the finding on whether hysteresis fits better than drag with fewer parameters.

    $$\chi^2_{drag} - \chi^2 > F^{-1}_{\chi^2_k}(0.99)$$

    Drag has k parameters fewer. If hysteresis does not fit better, its parameters are meaningless.
    The finding is failed if the fit misses the tests or drag fits clearly better, else usable for
    the response alone.
    """
    least = float(stats.chi2.isf(BY_CHANCE, drag.num_parameters))
    frequency, damping = (np.quantile(change, QUANTILES).tolist() for change in added)
    values = {
        "growth": drag.growth, "least": least, "number": drag.num_parameters,
        "y": 1e3 * y_peak, "frequency": frequency, "damping": damping,
    }  # fmt: skip
    entry = "no_hysteresis.drag"
    if drag.growth > least:
        return Finding("no_hysteresis", "ok", values, drag.growth, entry=entry)
    status = "failed" if misses or drag.growth < -least else "usable"
    return Finding("no_hysteresis", status, values, drag.growth, {"law": DAMPING}, entry=entry)
