r"""A fit whose motion just reaches what a law keeps for larger ones, against one that does not.

Where a macroslip, a stop or a slip begins a little below the largest motion it can follow the noise
of a few cycles: a narrow optimum, beside the wide plain of all the larger thresholds, which fit
nearly as well and which draws about the optimum would never see. By Laplace's method,

$$\log \int e^{-\chi^2/2} \approx -\tfrac12 \hat\chi^2 + \tfrac12 \log\det\Sigma + const,$$

the covariance nowhere wider than the box, the plain has the more of the posterior then.
"""

from collections.abc import Mapping
from itertools import product
from typing import Any

import numpy as np

from jbw.inference.fit.costly_fit import costly_fit
from jbw.inference.fit.fitting import Fit
from jbw.inference.lanes import at_points
from jbw.inference.space.box import Box
from jbw.observables import dataset
from jbw.observables.dataset import Dataset
from jbw.oscillator.laws import laws_named

BARELY = 0.5  # of the largest motion: a threshold below is crossed so far that the data know it
BEYOND = 1.1  # of the largest motion: where a threshold is not felt
SHARES = (0.25, 0.5, 0.75, 1.0)  # of the way from the fit to a bound


def likelier(best: Fit, prior: Box, data: Dataset) -> Fit:
    """The fit, or one that does not reach its thresholds where more of the posterior lies there."""
    y_peak = dataset.largest_displacement(data, _omega_n(best.theta, data))
    fitted = thresholds(best.theta, data)
    barely = [name for name, y in fitted.items() if BARELY * y_peak < y < BEYOND * y_peak]
    if not barely:
        return best
    points = _towards_bounds(best, prior, data)
    beyond = thresholds(points, data)
    least = np.min(np.broadcast_arrays(*(beyond[name] for name in barely)), axis=0)
    out = np.atleast_1d(least) > BEYOND * y_peak
    if not np.any(out):
        return best
    points = {name: values[out] for name, values in points.items()}
    likelihood = at_points(dataset.log_likelihood, points, data).sum(axis=1)
    chosen = int(np.argmax(np.nan_to_num(likelihood, nan=-np.inf)))
    start = {name: values[chosen] for name, values in points.items()}
    other = costly_fit(dataset.stacked, prior, data, starts=start)
    return other if _log_evidence(other) > _log_evidence(best) else best


def thresholds(theta: Mapping[str, Any], data: Dataset) -> dict[str, Any]:
    """Displacements [m] from which something of a law acts that smaller motions know nothing of."""
    known = {**data.held, **theta}
    return {
        f"{law.name}: {one.what}": one.y
        for law in laws_named(data.laws)
        for one in law.of(known).thresholds()
    }


def _towards_bounds(best: Fit, prior: Box, data: Dataset) -> dict[str, np.ndarray]:
    """Points where one parameter of a law lies on its way from the fit to a bound of its prior."""
    own = {each.name for law in laws_named(data.laws) for each in law.table}
    here = np.array([best.theta[name] for name in prior.names])
    points = []
    for i, name in enumerate(prior.names):
        for bound, share in product((prior.lower[i], prior.upper[i]), SHARES):
            if name in own:
                moved = here.copy()
                moved[i] += share * (float(bound) - here[i])
                points.append(moved)
    return dict(zip(prior.names, np.array(points).T, strict=True))


def _omega_n(theta: Mapping[str, float], data: Dataset) -> float:
    return float({**data.held, **theta}.get("omega_n", 1.0))


def _log_evidence(found: Fit) -> float:
    """Laplace's, but for what two fits to the same data in the same box share."""
    return float(0.5 * np.linalg.slogdet(found.covariance)[1] - found.cost)
