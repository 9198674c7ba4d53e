r"""Does the joint lose energy as hysteresis does, or as drag? The fit beside that of drag alone.

In weak slip Bouc-Wen without softening ($\delta = 0$) adds the damping of a force $c\,v|v|$:

$$\Delta\zeta = \frac{2}{3\pi}\,\frac{\alpha\gamma Y}{\omega_n^2} = \frac{4}{3\pi}\,c\,Y, \qquad
  \frac{|\Delta\omega|}{\omega_n} = \frac{2}{3\pi}\,\frac{\alpha\delta Y}{\omega_n^2}$$

A fit of hysteresis to drag ends there, with narrow intervals of parameters that mean nothing.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import stats

from jbw.identification.equivalent import DAMPING, Effects
from jbw.identification.no_joint import BY_CHANCE, Nested
from jbw.inference.fit.costly_fit import costly_fit
from jbw.inference.fit.fitting import Fit
from jbw.inference.posterior.finding import Finding
from jbw.inference.posterior.summary import QUANTILES
from jbw.inference.space.box import Box, bounds_by_name, box
from jbw.observables.dataset import Dataset, stacked
from jbw.oscillator.damper import Damper
from jbw.oscillator.laws import laws_named
from jbw.quantities import RESIDUAL_TERMS, STUCK

# Change of frequency over damping added, both relative: gamma = delta has 1, Masing's loops of a
# quadratic backbone 3 pi / 4. Below, drag is fitted too, and chi-square decides.
SOFTENS = 0.5
ROOM = 8.0  # times the first value: the upper bound of drag


def may_be_drag(added: Effects, zeta: float, laws: Sequence[str]) -> bool:
    """Whether laws of hysteresis add damping and change the frequency much less than slip does."""
    if not laws or any(issubclass(law, Damper) for law in laws_named(laws)):
        return False
    shift = np.quantile(np.abs(added.frequency), QUANTILES[-1])
    damping = zeta * np.quantile(added.damping, QUANTILES[0])
    return bool(damping > 0.0 and shift < SOFTENS * damping)


def with_drag(best: Fit, prior: Box, data: Dataset, damping: float, y_peak: float) -> Nested:
    """The fit of the oscillator with drag in place of the laws, to the same data and weights.

    It starts where drag adds the damping ratio that the laws add at y_peak [m].
    """
    names = {quantity.name for quantity in (*STUCK, *RESIDUAL_TERMS)}
    bounds = {name: pair for name, pair in bounds_by_name(prior).items() if name in names}
    first = 0.75 * np.pi * damping / y_peak
    start = {name: best.theta[name] for name in bounds} | {DAMPING: first}
    bounds[DAMPING] = (0.0, ROOM * first)
    other = replace(data, parts=tuple(replace(part, laws=(DAMPING,)) for part in data.parts))
    nested_fit = costly_fit(stacked, box(bounds), other, starts=start)
    growth = 2 * (nested_fit.cost - best.cost)
    return Nested(growth, len(best.theta) - len(bounds), nested_fit, bounds)


def drag_finding(drag: Nested, added: Effects, y_peak: float, *, misses: bool) -> Finding:
    r"""Whether hysteresis fits better than drag, which has k parameters less.

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
