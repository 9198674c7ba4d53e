r"""Fits of laws to measured frequency and damping against amplitude, without simulation.

$$\omega(Y)^2 = k + \sum_l K_l(Y), \qquad
  2\,\zeta(Y)\,\omega(Y)^2 = 2\zeta\omega_n\omega(Y) + \sum_l C_l(Y)$$

K and C are those of the laws' steady loops. Such a fit gives a start for the fit to the records. Of
several laws, the one with the smallest Bayesian information criterion probably fits the records
best,

$$\mathrm{BIC} = \chi^2 + k \ln n$$

with k parameters and n values of frequency and damping.

Reference:
    Schwarz (1978), Ann. Statist. 6, 461.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, Key
from scipy.linalg import block_diag, solve_triangular

from jbw.campaign.settings import Identify
from jbw.identification.coordinates import box_of
from jbw.identification.equivalent import backbones_at
from jbw.identification.uncertain_shapes import first_factors
from jbw.inference.fit.costly_fit import fits_of, parameters_at
from jbw.inference.generator import generator
from jbw.inference.space.box import Box, bounds_by_name, box
from jbw.measurement.resonances import AmplitudeCurve
from jbw.observables.dataset import Dataset
from jbw.observables.drives import of_drive, plain, told_by
from jbw.oscillator.modes.assembled import is_assembled
from jbw.quantities import MODAL

# parameters that frequency and damping against amplitude do not determine
BESIDE_CURVE = {"gain", *(quantity.name for quantity in MODAL)}
# number of random points of the prior; of a fit: number of starts, evaluations per start, relative
# tolerance
POINTS, STARTS, EVALUATIONS, TOLERANCE = 256, 2, 40, 1e-6
# Errors of a law's equivalent stiffness and loss. OF_CHANGE is relative to their changes over the
# amplitudes, because the amplitude of a record is not constant. OF_MEAN is relative to their means.
OF_CHANGE, OF_MEAN = 0.01, {"stiffness": 1e-7, "loss": 2e-3}


class CurveFit(NamedTuple):
    """A law's parameters from measured frequency and damping, with the information criterion."""

    theta: dict[str, float]
    criterion: float


class WhiteRows(NamedTuple):
    """Stiffness and loss at each amplitude, with the factor of their covariance.

    Attributes:
        y: Amplitudes [m].
        values: All omega^2, then all 2 zeta omega^2, divided by `unit`.
        factor: Lower Cholesky factor of the covariance of the values.
        unit: Mean of omega^2 [rad^2/s^2].
    """

    y: Float[np.ndarray, " amplitude"]
    values: Float[np.ndarray, " row"]
    factor: Float[np.ndarray, "row row"]
    unit: float


def from_amplitude_curve(
    key: Key[Array, ""], data: Dataset, prior: Box, known: Mapping[str, float]
) -> dict[str, float]:
    """Fit the laws to the data's frequency and damping over amplitude; return {} if unmeasured."""
    curves = (part.shown().amplitude_curve() for part in data.parts)
    curve = next((curve for curve in curves if curve is not None), None)
    found = None if curve is None else curve_fit(key, data, prior, curve)
    return {} if found is None else {n: x for n, x in found.theta.items() if n not in known}


def from_readings(
    key: Key[Array, ""],
    data: Dataset,
    settings: Identify,
    curve: AmplitudeCurve | None,
    *,
    below: float,
) -> CurveFit | None:
    """Fit the laws of a dataset to frequency and damping that were measured without a model.

    None without measured values, and if the laws' number of parameters alone gives a criterion that
    is not `below`.
    """
    if curve is None:
        return None
    known = {**first_factors(data), **told_by(data.parts, data.held)}
    found = curve_fit(key, data, box_of(settings, data, known), curve, below=below)
    return None if found is None else found._replace(theta={**known, **found.theta})


def curve_fit(
    key: Key[Array, ""],
    data: Dataset,
    prior: Box,
    curve: AmplitudeCurve,
    *,
    below: float = np.inf,
) -> CurveFit | None:
    """Fit laws to frequency and damping over amplitude; start at the most likely prior points.

    Return None where frequency and damping do not determine the laws, as with several joints.

    Raises:
        ModelError: None of the starts has a steady loop.
    """
    # One mode determines only a sum over all joints.
    if "zeta" not in prior.names or is_assembled(data.held):
        return None
    part = next((part for part in data.parts if "zeta" in part.informs), data.parts[0])
    bounds = of_drive(bounds_by_name(prior), part.drive)
    bounds = {n: x for n, x in bounds.items() if n not in BESIDE_CURVE and n == plain(n)}
    inside, rows = box(bounds), rows_of_curve(curve)
    if (penalty := len(bounds) * np.log(len(rows.values))) >= below:
        return None

    def evaluate(s: Float[np.ndarray, "point parameter"]) -> Float[np.ndarray, "point row"]:
        omega, zeta, _ = backbones_at(parameters_at(s, inside), rows.y, data.laws)
        stiffness = omega**2 / rows.unit
        errors = np.concatenate([stiffness, 2 * zeta * stiffness], axis=1) - rows.values
        return solve_triangular(rows.factor, errors.T, lower=True, check_finite=False).T

    points = generator(key).random((POINTS, len(bounds)))
    squares = np.sum(evaluate(points) ** 2, axis=1)
    order = np.argsort(np.where(np.isfinite(squares), squares, np.inf))[:STARTS]
    starts = parameters_at(points[order], inside)
    ends = fits_of(
        evaluate, inside, starts=starts, max_evaluations=EVALUATIONS, tolerance=TOLERANCE
    )
    best = min(ends, key=lambda end: end.cost)
    return CurveFit(dict(best.theta), float(2 * best.cost + penalty))


def rows_of_curve(curve: AmplitudeCurve) -> WhiteRows:
    """Return a curve's equivalent stiffness and loss with their covariance."""
    square = curve.omega**2
    unit = float(np.mean(square))
    stiffness, loss = square / unit, 2 * curve.zeta * square / unit
    slopes = 2 * curve.omega / unit, 2 * square / unit
    covariances = curve.omega_covariance, curve.zeta_covariance
    blocks = [
        np.outer(slope, slope) * covariance
        + (OF_CHANGE * np.ptp(values) + OF_MEAN[name] * np.mean(np.abs(values))) ** 2
        * np.eye(len(values))
        for name, values, slope, covariance in zip(
            OF_MEAN, (stiffness, loss), slopes, covariances, strict=True
        )
    ]  # fmt: skip
    factor = np.linalg.cholesky(np.asarray(block_diag(*blocks)))
    return WhiteRows(curve.y, np.append(stiffness, loss), factor, unit)
