r"""From a dataset to what is sampled: one way for all that fit or draw the joint.

First values, the box, the fit, and what it shows: noise, effective values, run effects,
coordinates, steps of the solver. The noise of a group and the number of its independent values are
what a fit leaves, and the fit is weighted by them: a fixed point, $w = W(\hat\theta(w))$. Its
iteration stops after one round, and one more where runs get effects of their own, which change
what is left: a further round moves the weights by less than they are known.
"""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from jbw.campaign.settings import Identify
from jbw.identification.accuracy import NUM_DRAWS, SHIFT, solver_change
from jbw.identification.assemble import Measured, Report, assemble
from jbw.identification.coordinates import (
    box_of,
    chosen_coordinates,
    coordinate_box,
    coordinates_sentence,
)
from jbw.identification.run_effects import sentence_of, shifts_of, wanted, with_offsets
from jbw.inference.fit.costly_fit import costly_fit
from jbw.inference.fit.fitting import Fit, fit
from jbw.inference.space.box import Box, bounds_by_name, box, from_unit
from jbw.observables import dataset
from jbw.observables.dataset import Dataset
from jbw.observables.observable import AmplitudeCurve
from jbw.oscillator.oscillator import oscillator_of
from jbw.oscillator.steady.backbone import backbone

logger = logging.getLogger("jbw")
MOST_SUBSTEPS = 16
NUM_SCREENED = 32  # points of the box whose cost is looked at
NUM_STARTS = 3  # of them fitted
EXPLAINED = 5.0  # chi-square a degree of freedom below which a fit explains the data
CURVE_STARTS = 8  # of the fit to frequency and damping against amplitude, which costs nothing
MOST_CURVE_POINTS = 200
FREQUENCY_STD, DAMPING_STD = 1e-4, 0.03  # relative: weights of such a curve


@dataclass(frozen=True)
class Fitted:
    """A fit of the joint with what it was fitted to, ready to be drawn from."""

    fit: Fit  # least squares of `jbw.observables.dataset.stacked` in the box
    box: Box  # the prior, in the coordinates to sample in
    data: Dataset  # with the noise, effective values and run effects that were found
    statements: tuple[str, ...] = ()  # what the fit showed, a sentence each
    # Of the first fit over the groups whose noise repeats tell, and its degrees of freedom.
    chi_square: tuple[float, int] | None = None


def fit_joint(key: Key[Array, ""], seen: Measured, report: Report) -> Fitted:
    """Fit the joint to a campaign as the joint posterior would."""
    data = assemble(seen)
    report(f"Least squares: all parameters from {len(data.labels)} groups of data")
    return prepare(jax.random.split(key), data, seen.settings)


def prepare(
    keys: Key[Array, " two"],
    data: Dataset,
    settings: Identify,
    known: Mapping[str, float] | None = None,
) -> Fitted:
    """First values, the box, the fit from them and from `known` ones, and what the fit settles."""
    values = {**first_values(data), **(known or {})}
    prior = box_of(settings, data, values)
    values = {**from_amplitude_curve(keys[0], data, prior, values), **values}
    first = fit_from(keys[0], data, prior, values)
    ready = reweight(keys[1], data, prior, first, settings)
    best = replace(ready.fit, waterfall=first.waterfall)  # the later fits have one start
    return replace(ready, fit=best, chi_square=explained(first, data))


def first_values(data: Dataset) -> dict[str, float]:
    """omega_n [rad/s], zeta [-] and gain as the first part tells them that can; empty if none."""
    return next((found for part in data.parts if (found := part.first_values())), {})


def from_amplitude_curve(
    key: Key[Array, ""], data: Dataset, prior: Box, known: Mapping[str, float]
) -> dict[str, float]:
    r"""The laws' parameters from frequency and damping against amplitude, where data show them.

    $$\omega(Y)^2 = k + \sum_l K_l(Y), \qquad
      2\,\zeta(Y)\,\omega(Y)^2 = 2\zeta\omega_n\omega(Y) + \sum_l C_l(Y)$$

    with K and C of the steady loops: no solve in time, so that many starts cost nothing.
    """
    curve = next((c for part in data.parts if (c := part.amplitude_curve()) is not None), None)
    if curve is None or "zeta" not in prior.names:
        return {}
    some = np.unique(np.linspace(0, len(curve.y) - 1, MOST_CURVE_POINTS).astype(int))
    thin = AmplitudeCurve(*(values[some] for values in curve))
    laws = data.laws

    def left(theta: Mapping[str, Array], seen: AmplitudeCurve) -> Float[Array, " value"]:
        model = backbone(oscillator_of(theta, laws), seen.y)
        frequency = (model.omega / seen.omega - 1) / FREQUENCY_STD
        damping = (model.zeta - seen.zeta) / (DAMPING_STD * jnp.max(seen.zeta))
        return jnp.concatenate([frequency, damping])

    bounds = {name: pair for name, pair in bounds_by_name(prior).items() if name != "gain"}
    best = fit(left, box(bounds), thin, starts=CURVE_STARTS, key=key)
    return {name: value for name, value in best.theta.items() if name not in known}


def fit_from(key: Key[Array, ""], data: Dataset, prior: Box, known: Mapping[str, float]) -> Fit:
    """Least squares over all parameters, from what is known of them.

    Where that fit does not explain the data, also from the best of many points all over the box:
    their costs are looked at first, for a solve costs far less than a fit.
    """
    middle = from_unit(jnp.full(len(prior.names), 0.5), prior)
    start = {name: known.get(name, float(middle[name])) for name in prior.names}
    first = costly_fit(dataset.stacked, prior, data, starts=inside(start, prior))
    chi_square, dof = first.chi_square
    if chi_square < EXPLAINED * dof:
        return first
    points = from_unit(jax.random.uniform(key, (NUM_SCREENED, len(prior.names))), prior)
    for name in {"omega_n", "gain"} & set(points) & set(known):  # known far better than the box
        points[name] = jnp.full(NUM_SCREENED, known[name])
    order = np.argsort(np.asarray(_costs(points, data)))[:NUM_STARTS]
    starts = {name: np.asarray(values)[order] for name, values in points.items()}
    second = costly_fit(dataset.stacked, prior, data, starts=inside(starts, prior))
    best = min(first, second, key=lambda one: one.cost)
    return replace(best, waterfall=np.sort(np.append(first.waterfall, second.waterfall)))


def inside(starts: Mapping[str, Any], prior: Box) -> dict[str, np.ndarray]:
    """Starts moved into the box."""
    return {
        name: np.clip(starts[name], prior.lower[i], prior.upper[i])
        for i, name in enumerate(prior.names)
    }


@jax.jit
def _costs(points: Mapping[str, Array], data: Dataset) -> Float[Array, " point"]:
    costs = jax.lax.map(lambda theta: jnp.sum(dataset.stacked(theta, data) ** 2), dict(points))
    return jnp.where(jnp.isfinite(costs), costs, jnp.inf)


def explained(first: Fit, data: Dataset) -> tuple[float, int] | None:
    """Chi-square of a fit over the groups whose noise is known from repeats, and its degrees."""
    sizes = {label: size for part in data.parts for label, size in part.noise_known().items()}
    if not sizes:
        return None
    rows = dataset.by_label(first.residual, data)
    total = sum(float(np.sum(rows[label] ** 2)) for label in sizes)
    return total, max(int(sum(sizes.values())) - len(first.x), 1)


def reweight(
    key: Key[Array, ""], data: Dataset, prior: Box, first: Fit, settings: Identify
) -> Fitted:
    """Noise, effective values and run effects as fits show them; coordinates and solver steps."""
    words = []
    data = with_weights(first, data, settings)
    best = refit(first, prior, data)
    shifts = shifts_of(best, prior.names, data)
    if shifts is not None and wanted(shifts, settings):
        words.append(sentence_of(shifts))
        data = with_offsets(best, shifts, data)
        best = refit(best, prior, data)
        # The offsets that are known now are where records are linearised in them.
        data = dataset.with_directions(best.theta, data, dataset.best_offsets(best.theta, data))
        best = refit(best, prior, data)
        data = with_weights(best, data, settings)
        best = refit(best, prior, data)
    for law, coordinates in chosen_coordinates(best, settings, data.laws):
        prior = coordinate_box(prior, best.theta, settings, law, coordinates)
        best = refit(best, prior, data, theta=coordinates.from_parameters(best.theta))
        words.append(coordinates_sentence(law, coordinates))
    if settings.substeps is None:
        finer = refined(key, data, prior, best)
        if finer is not data:
            data, best = finer, refit(best, prior, finer)
    return Fitted(best, prior, data, tuple(words))


def with_weights(best: Fit, data: Dataset, settings: Identify) -> Dataset:
    """The dataset with the noise that a fit leaves, and as many values as are independent."""
    noisy = dataset.with_fitted_noise(best.theta, dataset.left_by_label(best.residual, data), data)
    if settings.model_error == "none":
        return noisy
    fractions = dataset.effective_fractions(best.residual, best.jacobian, best.covariance, data)
    return dataset.with_effective_values(fractions, noisy)


def refit(best: Fit, prior: Box, data: Dataset, *, theta: Mapping[str, float] | None = None) -> Fit:
    """The fit again, from where it ended."""
    start = inside(theta or best.theta, prior)
    return costly_fit(dataset.stacked, prior, data, starts=start)


def refined(key: Key[Array, ""], data: Dataset, prior: Box, best: Fit) -> Dataset:
    """The dataset with so many solver steps that halving them would not matter to the fit."""
    white = np.asarray(jax.random.normal(key, (NUM_DRAWS, len(best.theta))))
    draws = list(best.theta.values()) + white @ np.linalg.cholesky(best.covariance).T
    theta = inside(dict(zip(best.theta, draws.T, strict=True)), prior)
    for _ in range(int(np.log2(MOST_SUBSTEPS)) - 1):
        change = solver_change(theta, data)
        if change is None or np.std(change) < SHIFT:
            break
        data = dataset.halved(data) or data
    return data
