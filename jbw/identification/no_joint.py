r"""Is a joint seen at all, and does it lose energy as hysteresis does? The fit beside simpler ones.

Without a joint the same structure is linear. With drag alone, in place of the laws: in weak slip
Bouc-Wen without softening ($\delta = 0$) adds the damping of a force $c\,v|v|$:

$$\Delta\zeta = \frac{2}{3\pi}\,\frac{\alpha\gamma Y}{\omega_n^2} = \frac{4}{3\pi}\,c\,Y, \qquad
  \frac{|\Delta\omega|}{\omega_n} = \frac{2}{3\pi}\,\frac{\alpha\delta Y}{\omega_n^2}$$

A fit of hysteresis to drag ends there, with narrow intervals of parameters that mean nothing.
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

FAR = 5.0  # standard deviations from zero: beyond, a joint is seen without a further fit
NUM_DRAWS = 256
BY_CHANCE = 0.01  # probability of as much better a fit, of data of a structure without a joint
# Change of frequency over damping added, both relative: gamma = delta has 1, Masing's loops of a
# quadratic backbone 3 pi / 4. Below, drag is fitted too, and chi-square decides.
SOFTENS = 0.5
ROOM = 8.0  # times the first value: the upper bound of drag


class Nested(NamedTuple):
    """How much chi-square grows with simpler laws or none, and how many parameters these lack."""

    growth: float
    num_parameters: int
    fit: Fit  # of the simpler oscillator
    bounds: Mapping[str, tuple[float, float]]  # its prior


def without_joint(best: Fit, prior: Box, data: Dataset) -> Nested:
    """Return the fit of the oscillator alone, to the same data in the same weights."""
    return _nested(best, prior, data, (), {})


def likely(
    key: Key[Array, ""], best: Fit, prior: Box, data: Dataset
) -> dict[str, Float[np.ndarray, " draw"]]:
    r"""Return the points about a fit that the data do not rule out at 99 %, by name.

    Of those drawn by its covariance, within the prior, that lose no more than half of the quantile
    of $\chi^2_k$ in log likelihood; the fit itself first.
    """
    theta = points_at(steps_about(key, best, NUM_DRAWS), best, prior)
    values = at_points(log_likelihood, theta, data).sum(axis=1)
    least = float(stats.chi2.isf(BY_CHANCE, len(best.theta))) / 2
    keep = values >= values[0] - least
    return {name: x[keep] for name, x in theta.items()}


def joint_finding(nested: Nested, added: Effects, y_peak: float) -> Finding:
    r"""Return whether the joint fits better than none, by the likelihood ratio of nested models.

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
    """Return whether the posterior hardly tells from zero how the joint changes the frequency."""
    return bool(abs(np.median(added.frequency)) < FAR * np.std(added.frequency))


def may_be_drag(added: Effects, zeta: float, laws: Sequence[str]) -> bool:
    """Return whether hysteresis laws add damping but shift frequency much less than slip does."""
    if not laws or any(map(feels_rate, laws_named(laws))):
        return False
    shift = np.quantile(np.abs(added.frequency), QUANTILES[-1])
    damping = zeta * np.quantile(added.damping, QUANTILES[0])
    return bool(damping > 0.0 and shift < SOFTENS * damping)


def with_drag(best: Fit, prior: Box, data: Dataset, damping: float, y_peak: float) -> Nested:
    """Fit the oscillator with drag in place of the laws, to the same data and weights.

    It starts where drag adds the damping ratio that the laws add at y_peak [m].
    """
    return _nested(best, prior, data, (DAMPING,), {DAMPING: 0.75 * np.pi * damping / y_peak})


def _nested(
    best: Fit, prior: Box, data: Dataset, laws: tuple[str, ...], firsts: Mapping[str, float]
) -> Nested:
    """Return the fit with other laws, whose parameters start at `firsts` within ROOM times them."""
    names = {quantity.name for quantity in (*STUCK, *RESIDUAL_TERMS)}
    bounds = {name: pair for name, pair in bounds_by_name(prior).items() if name in names}
    starts = {name: best.theta[name] for name in bounds} | dict(firsts)
    bounds |= {name: (0.0, ROOM * first) for name, first in firsts.items()}
    simpler = replace(data, parts=tuple(replace(part, laws=laws) for part in data.parts))
    nested_fit = costly_fit(stacked, box(bounds), simpler, starts=starts)
    growth = 2 * (nested_fit.cost - best.cost)
    return Nested(growth, len(best.theta) - len(bounds), nested_fit, bounds)


def drag_finding(drag: Nested, added: Effects, y_peak: float, *, misses: bool) -> Finding:
    r"""Return whether hysteresis fits better than drag, which has k parameters less.

    $$\chi^2_{drag} - \chi^2 > F^{-1}_{\chi^2_k}(0.99)$$

    Where it does not, its parameters mean nothing: failed where its fit misses the tests or drag
    fits better by as much, else usable for the response alone.
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
