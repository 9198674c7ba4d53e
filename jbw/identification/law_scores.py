r"""Scores of a law: log predictive density of each held-out run, and evidence.

$$\mathrm{elpd}_r = \log \int p(D_r | \theta, D_{-r})\, p(\theta | D_{-r})\, d\theta$$

is computed from draws of the whole posterior with new weights if these suffice, else from points
near a fit without the run. If the weights of these points are poor too, the score of the fit alone
bounds the error of the score: the width of a posterior adds some nats per parameter.

How much the evidence depends on the width of the priors is shown by the same law in a box twice as
wide. A parameter that the data determine costs ln 2 = 0.69 nats, an undetermined one nothing, and
one that the data push against its bound gains evidence. So the evidence is integrated again and not
corrected.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import jax
import numpy as np
import xarray as xr
from jaxtyping import Array, Float, Key
from scipy.special import logsumexp

from jbw.identification.evidence import Candidate, likelihood_at, place_of
from jbw.identification.held_out import HeldOut, held_out, labels_by_run
from jbw.identification.run_effects import errors_with_own_frequency
from jbw.inference.lanes import at_points
from jbw.inference.posterior.summary import posterior_draws
from jbw.inference.posterior.verdict import GOOD_KHAT
from jbw.inference.samplers import amis
from jbw.inference.samplers.amis import WeighedPoints
from jbw.inference.samplers.ladder import Places, about_draws, choose
from jbw.inference.samplers.weighed_points import weights_of
from jbw.inference.space.box import Box, bounds_by_name, box
from jbw.inference.space.problem import Target, problem_of
from jbw.inference.space.reparametrisation import Reparametrisation
from jbw.measurement.channels import rms
from jbw.observables import dataset, noise
from jbw.observables.dataset import Dataset
from jbw.oscillator.laws import quantities_of
from jbw.results.attributes import DrawnPosterior

# Settings for the posterior without one run: points per round, required number of effective points,
# and largest number of rounds, by whether the likelihood integrates in time.
SIZE, WORTH, ROUNDS = 256, 200.0, {True: 8, False: 24}


@dataclass(frozen=True)
class LeftOut:
    """A law's scores and errors in predicting each held-out run.

    Attributes:
        elpd: Log predictive density by run [nats].
        error: Relative error of the prediction by run.
        khat: Largest k-hat of the weights; good below 0.7. None if only fits were used.
        doubt: Difference of the scores with poor weights from those of fits alone, summed [nats]; 0
            if all weights are good.
    """

    elpd: dict[str, float]
    error: dict[str, float]
    khat: float | None
    doubt: float = 0.0


def runs_of(data: Dataset) -> dict[str, list[str]]:
    """Return, for each run that can be held out, the labels of its data groups."""
    counted, runs = noise.fractions_counted(data), labels_by_run(data).items()
    return {run: labels for run, labels in runs if any(label in counted for label in labels)}


def each_run(one: Candidate) -> dict[str, HeldOut]:
    """Return a candidate law's fits, each without one of the runs."""
    fitted = one.fitted
    return held_out(runs_of(fitted.data), fitted.fit, fitted.box, fitted.data)


def left_out(
    key: Key[Array, ""], one: Candidate, draws: xr.DataTree, about: Reparametrisation
) -> LeftOut:
    """Predict each run from the other runs; return log predictive densities and relative errors.

    Draws of the whole posterior are weighted again, as if without the run. If a run moves the
    posterior far, these weights are poor, as k-hat shows, and points near a fit without the run are
    used. Coordinates `about` the draws may still suit the posterior without the run better than
    those of its fit.
    """
    prior, data = one.fitted.box, one.fitted.data
    elpd, error, worst, doubt = {}, {}, -np.inf, 0.0
    for i, (run, piece) in enumerate(each_run(one).items()):
        score = _by_draws(draws, prior.names, data, piece.rest)
        if score is None:
            score = _by_points(jax.random.fold_in(key, i), one, piece, about)
        elpd[run], khat = score
        error[run] = _error_of(piece, one)
        worst = max(worst, khat)
        if not khat < GOOD_KHAT:
            doubt += abs(elpd[run] - _score_of_fit(piece, data))
    return LeftOut(elpd, error, float(worst), doubt)


def left_out_of_fits(one: Candidate) -> LeftOut:
    r"""Return each run's log density at the fit to the other runs, $\log p(D_r | \hat\theta_{-r})$.

    The width of a posterior adds a few nats, which do not matter for a hopeless law.
    """
    table = each_run(one)
    elpd = {run: _score_of_fit(piece, one.fitted.data) for run, piece in table.items()}
    return LeftOut(elpd, {run: _error_of(piece, one) for run, piece in table.items()}, None)


def _score_of_fit(piece: HeldOut, data: Dataset) -> float:
    """Return the log density [nats] of held-out data groups at a fit to the other groups."""
    return likelihood_at(piece.fit, data) - likelihood_at(piece.fit, piece.rest)


def _told_by_terms(data: Dataset, rest: Dataset) -> Float[np.ndarray, " term"] | None:
    """Return factors on the likelihood terms of held-out groups; None if rescaling is impossible.

    The factors lead from the terms of `rest`, where these groups are silenced, to those of `data`.

    Without offsets, a likelihood term is proportional to the number of values that count. A
    silenced group keeps a tiny number, so its term can be scaled up and nothing is solved twice.
    """
    if data.has_offsets or any(part.own_shifts for part in data.parts):
        return None
    counted, silent = noise.fractions_counted(data), noise.fractions_counted(rest)
    return np.array([counted[x] / silent[x] if x in counted else 1.0 for x in data.labels])


def _by_draws(
    tree: xr.DataTree, names: Sequence[str], data: Dataset, rest: Dataset
) -> tuple[float, float] | None:
    """Return held-out groups' log predictive density [nats] and k-hat, from the draws, or None."""
    posterior = posterior_draws(tree)
    terms = tree["log_likelihood"].to_dataset()["terms"].values
    terms = terms.reshape(-1, terms.shape[-1])
    times = _told_by_terms(data, rest)
    if times is None:
        theta = {name: posterior[name].values.ravel() for name in names}
        without = at_points(dataset.log_likelihood, theta, rest).reshape(len(terms), -1)
        gained = terms.sum(axis=1) - without.sum(axis=1)
    else:
        gained = terms[:, : len(times)] @ (1 - 1 / times)
    importance = weights_of(-gained)
    if not (importance.khat < GOOD_KHAT and importance.effective >= WORTH):
        return None
    return float(np.asarray(logsumexp(gained, b=importance.weights))), importance.khat


def _by_points(
    key: Key[Array, ""],
    candidate: Candidate,
    piece: HeldOut,
    about_all: Reparametrisation,
) -> tuple[float, float]:
    """Return held-out groups' log predictive density [nats] and k-hat, from newly drawn points."""
    parametrisations = {"fit": lambda: place_of(piece.fit, candidate), "draws": lambda: about_all}
    points = weighed_in(key, candidate.fitted.box, piece.rest, parametrisations)
    times = _told_by_terms(candidate.fitted.data, piece.rest)
    if times is None:
        log_terms = at_points(dataset.log_likelihood, points.theta, candidate.fitted.data)
        gained = log_terms.reshape(len(points.weights), -1).sum(axis=1) - points.terms.sum(axis=1)
    else:
        gained = points.terms[:, : len(times)] @ (times - 1)
    with np.errstate(divide="ignore"):
        score = logsumexp(np.where(np.isfinite(gained), gained, -np.inf), b=points.weights)
    return float(np.asarray(score)), points.khat


def weighed_in(key: Key[Array, ""], prior: Box, data: Dataset, places: Places) -> WeighedPoints:
    """Draw weighted points of a posterior in the best of several sets of coordinates."""
    looking, drawing = jax.random.split(key)
    _, place, _ = choose(looking, Target(dataset.log_likelihood, prior, data), places)
    problem = problem_of(dataset.log_likelihood, prior, data, place)
    return amis.points(drawing, problem, size=SIZE, least=WORTH, most_rounds=ROUNDS[data.stepped])


def _error_of(piece: HeldOut, candidate: Candidate) -> float:
    """Return the relative error of held-out data groups, with a separate omega_n for each run."""
    fitted = candidate.fitted
    errors = errors_with_own_frequency(piece.fit, fitted.box, fitted.data)
    return rms([errors[label] for label in piece.labels if label in errors])


def twice_as_wide(prior: Box, laws: tuple[str, ...], stated: Collection[str] = ()) -> Box:
    """Return prior bounds in which the ranges of the laws' parameters are twice as wide.

    Bounds widen on both sides of zero if both signs are possible, otherwise upwards. Shares of
    omega_n^2 keep their bounds, because the joint alone cannot be stiffer than the whole; so do
    parameters with a `stated` density.
    """
    bounds = bounds_by_name(prior)
    for quantity in quantities_of(laws):
        if quantity.name in bounds and not (quantity.is_share or quantity.name in stated):
            low, high = bounds[quantity.name]
            has_both_signs = quantity.least is None and low < 0.0 < high
            bounds[quantity.name] = (
                (2.0 * low, 2.0 * high) if has_both_signs else (low, 2.0 * high - low)
            )
    return box(bounds)


def log_evidence_wide(key: Key[Array, ""], one: Candidate, draws: xr.DataTree) -> float | None:
    """Return the log evidence [nats] for a prior twice as wide; None if it is unreliable.

    Points are drawn around the fit, or around the moments of the posterior's draws if these are
    better.
    """
    data, best, prior = one.fitted.data, one.fitted.fit, one.fitted.box
    wide, log_evidence = (
        twice_as_wide(prior, one.laws, data.stated.names),
        DrawnPosterior.of(draws).log_evidence,
    )
    if log_evidence is None or bounds_by_name(wide) == bounds_by_name(prior):
        return log_evidence
    about_fit = place_of(best, replace(one, fitted=replace(one.fitted, box=wide)))
    parametrisations = {
        "fit": lambda: about_fit,
        "draws": lambda: about_draws(draws, wide, about_fit),
    }
    weighed = weighed_in(jax.random.fold_in(key, 2), wide, data, parametrisations)
    return weighed.log_evidence if weighed.khat < GOOD_KHAT else None
