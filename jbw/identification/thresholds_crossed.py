r"""Additional fits that start beyond a threshold of a law, such as macroslip or a stop.

Thresholds divide the parameters by whether the largest motion reached a macroslip, a stop or a
slip. A fit that starts on one side of a threshold seldom crosses it, even if the data favour the
other side. A threshold that is just reached can fit the noise of a few cycles: a narrow optimum
next to a wide plain of larger thresholds, which fit nearly as well. By Laplace's method,

$$\log \int e^{-\chi^2/2} \approx -\tfrac12 \hat\chi^2 + \tfrac12 \log\det\Sigma + const,$$

with the covariance limited by the box, more of the posterior then lies on the plain.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool

from jbw.inference.fit.costly_fit import parameters_at, to_search
from jbw.inference.fit.fitting import Fit
from jbw.inference.lanes import at_points
from jbw.inference.space.box import Box
from jbw.observables import dataset
from jbw.observables.dataset import Dataset
from jbw.oscillator.laws import laws_named

SHARES = np.linspace(0.125, 1.0, 8)  # fractions of the distance from a fit to a bound


def other_sides(best: Fit, prior: Box, data: Dataset) -> list[dict[str, float]]:
    """Return likely starting values whose motion exceeds other thresholds than that of the fit."""
    here = reached(best.theta, best.theta, data)
    law_names = {quantity.name for law in laws_named(data.laws) for quantity in law.table} & set(
        prior.names
    )
    if not (here.size and law_names):
        return []
    # At each point one parameter of the laws has moved from the fit towards a bound.
    s = to_search(best.x, prior)
    moved = [np.eye(len(s))[i] * (end - s[i]) for i, n in enumerate(prior.names) if n in law_names
             for end in (0.0, 1.0)]  # fmt: skip
    steps = SHARES[:, None, None] * np.array(moved)
    points = parameters_at((s + steps).reshape(-1, len(s)), prior)
    likelihood = at_points(dataset.log_likelihood, points, data).sum(axis=1)
    likelihood = np.nan_to_num(likelihood, nan=-np.inf)
    sides = reached(points, best.theta, data)
    likeliest: dict[tuple[bool, ...], int] = {}
    for row in np.argsort(-likelihood):
        likeliest.setdefault(tuple(sides[:, row].tolist()), int(row))
    likeliest.pop(tuple(here[:, 0].tolist()), None)
    return [{name: float(x[row]) for name, x in points.items()} for row in likeliest.values()]


def reached(
    theta: Mapping[str, Any], fitted: Mapping[str, float], data: Dataset
) -> Bool[np.ndarray, "threshold point"]:
    """Return a mask of the laws' thresholds that the largest motion exceeds, by parameter point."""
    y_peak, parameters = fitted_displacement(fitted, data), {**data.held, **theta}
    laws = [law.build(parameters) for law in laws_named(data.laws)]
    y = [np.atleast_1d(threshold.y) for law in laws for threshold in law.thresholds()]
    return np.stack(np.broadcast_arrays(*y)) < y_peak if y else np.zeros((0, 1), bool)


def fitted_displacement(theta: Mapping[str, float], data: Dataset) -> float:
    """Return the largest measured displacement [m], converted by the fit's natural frequency."""
    omega_n = float({**data.held, **theta}.get("omega_n", 1.0))
    return dataset.largest_displacement(data, omega_n)


def log_evidence(found: Fit) -> float:
    """Return the log evidence by Laplace's approximation, without terms common to all fits."""
    return float(0.5 * np.linalg.slogdet(found.covariance)[1] - found.cost)
