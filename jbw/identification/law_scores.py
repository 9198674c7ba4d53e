r"""The scores of a law: log predictive density of each run that it has not seen, and evidence.

$$\mathrm{elpd}_r = \log \int p(D_r | \theta, D_{-r})\, p(\theta | D_{-r})\, d\theta$$

by the draws of the whole posterior weighed anew where they suffice, else by points about a fit
without the run. Where the weights of those are poor too, the fit alone tells by how much at most
the score may be off: what the width of a posterior adds is some nats a parameter.

How much evidence hangs on the width of the priors, the same law in a box twice as wide tells. A
parameter that the data narrow costs ln 2 = 0.69 nats, one that they leave open nothing, and one
that they push against its bound gains; so the evidence is integrated again and not corrected.
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

# Of points without a run: a round, draws wanted, and rounds where time is stepped through or not.
SIZE, WORTH, ROUNDS = 256, 200.0, {True: 8, False: 24}


@dataclass(frozen=True)
class LeftOut:
    """The predictions of a law for each run that it has not seen: their scores and errors.

    Attributes:
        elpd: Log predictive density [nats].
        error: Error of the prediction over the response.
        khat: Of the weights by which it was found; good below 0.7. None where fits alone tell.
        doubt: What the sum of rough scores is off from that of fits alone [nats]; 0 where good.
    """

    elpd: dict[str, float]
    error: dict[str, float]
    khat: float | None
    doubt: float = 0.0


def runs_of(data: Dataset) -> dict[str, list[str]]:
    """Return the labels of the runs that can be held out: those whose values count."""
    counted, runs = noise.fractions_counted(data), labels_by_run(data).items()
    return {run: labels for run, labels in runs if any(label in counted for label in labels)}


def each_run(one: Candidate) -> dict[str, HeldOut]:
    """Return the fits of a law without each run."""
    fitted = one.fitted
    return held_out(runs_of(fitted.data), fitted.fit, fitted.box, fitted.data)


def left_out(
    key: Key[Array, ""], one: Candidate, draws: xr.DataTree, about: Reparametrisation
) -> LeftOut:
    """Predict each run by what the others know: by draws weighed anew, or fitted again without it.

    Where a run moves the posterior far, its draws weighed without it say little, as k-hat shows.
    Coordinates `about` the draws may yet suit a posterior without it better than those about a fit.
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
    r"""Return the same by the fit without each run alone, $\log p(D_r | \hat\theta_{-r})$.

    What the width of a posterior adds is a few nats: nothing where a law is hopeless.
    """
    table = each_run(one)
    elpd = {run: _score_of_fit(piece, one.fitted.data) for run, piece in table.items()}
    return LeftOut(elpd, {run: _error_of(piece, one) for run, piece in table.items()}, None)


def _score_of_fit(piece: HeldOut, data: Dataset) -> float:
    """Return the log density of a piece at the fit to the rest [nats]."""
    return likelihood_at(piece.fit, data) - likelihood_at(piece.fit, piece.rest)


def _told_by_terms(data: Dataset, rest: Dataset) -> Float[np.ndarray, " term"] | None:
    """Return factors from likelihood terms of `rest` to those of `data`; None if shifts tie runs.

    Without offsets a term is the number of values times what one of them says, and a silenced
    group has next to none: its term tells what it says, and nothing is solved twice.
    """
    if data.has_offsets or any(part.own_shifts for part in data.parts):
        return None
    counted, silent = noise.fractions_counted(data), noise.fractions_counted(rest)
    return np.array([counted[x] / silent[x] if x in counted else 1.0 for x in data.labels])


def _by_draws(
    tree: xr.DataTree, names: Sequence[str], data: Dataset, rest: Dataset
) -> tuple[float, float] | None:
    """Log predictive density of what `rest` lacks [nats] and k-hat; None where weights are poor."""
    posterior = tree["posterior"].to_dataset()
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
    """Return the same by points about the fit without it, or about all draws if worth more."""
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
    """Draw weighted points of a posterior in the best of several coordinate systems."""
    looking, drawing = jax.random.split(key)
    _, place, _ = choose(looking, Target(dataset.log_likelihood, prior, data), places)
    problem = problem_of(dataset.log_likelihood, prior, data, place)
    return amis.points(drawing, problem, size=SIZE, least=WORTH, most_rounds=ROUNDS[data.stepped])


def _error_of(piece: HeldOut, candidate: Candidate) -> float:
    """Return the error of a piece over its response; its runs have their own frequency."""
    fitted = candidate.fitted
    errors = errors_with_own_frequency(piece.fit, fitted.box, fitted.data)
    return rms([errors[label] for label in piece.labels if label in errors])


def twice_as_wide(prior: Box, laws: tuple[str, ...], stated: Collection[str] = ()) -> Box:
    """Return the box with those of the laws' own parameters twice as wide.

    About zero where both signs are possible, otherwise upwards. A part of omega_n^2 has no wider
    prior: it ends where nothing but the joint holds; nor has one whose density is `stated`.
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
    """Log evidence in the wider box [nats]; None where its weights cannot be trusted.

    By points about the fit, or about the moments of the posterior's draws where these are worth
    more.
    """
    data, best, prior = one.fitted.data, one.fitted.fit, one.fitted.box
    wide, log_evidence = (
        twice_as_wide(prior, one.laws, data.stated.names),
        draws.attrs.get("log_evidence"),
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
