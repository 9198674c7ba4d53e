r"""Comparison of laws by their evidence, on the same data.

All laws are fitted to the same values with the same weights. Noise, misfit, number of independent
values and offsets of the runs are those of the law with the smallest residual. A white likelihood
would treat every sample of a law's own error as independent information. The unit of evidence is
the run: each run is left out in turn and predicted by a fit to the others (`law_scores`).

Reference:
    For the weights of misfit, Grunwald and van Ommen (2017), Bayesian Analysis 12, 1069.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from operator import itemgetter
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Key

from jbw.campaign.settings import Identify
from jbw.errors import ConfigError, JbwError
from jbw.identification.assemble import Measured, Report, assemble
from jbw.identification.assembled import ASSEMBLED, require_known_laws
from jbw.identification.first_fit import first_fit
from jbw.identification.joint import with_derived
from jbw.identification.one_mode_readings import joint_readings
from jbw.identification.prepare import Fitted, refined, refit, reweight
from jbw.identification.residual_terms import terms_of, with_terms
from jbw.identification.step import attrs
from jbw.identification.uncertain_shapes import with_shape_priors, with_stated_priors
from jbw.identification.widening import widened_by_fit
from jbw.inference.compiled import forget_when_many
from jbw.inference.fit.fitting import Fit
from jbw.inference.fit.valley import about_valley
from jbw.inference.generator import generator
from jbw.inference.lanes import at_points
from jbw.inference.posterior.verdict import GOOD_KHAT
from jbw.inference.samplers.ladder import about_draws, choose
from jbw.inference.samplers.sampling import SamplingRequest, draw_posterior
from jbw.inference.space.problem import Target, problem_of
from jbw.inference.space.reparametrisation import Reparametrisation, along_logarithms, never_zero
from jbw.inference.space.ridge import along_ridge
from jbw.measurement.channels import rms
from jbw.observables import dataset
from jbw.observables.dataset import Dataset
from jbw.oscillator.laws.bouc_wen import BoucWenLaw
from jbw.oscillator.modes.parameters import NAMES
from jbw.parts import Parts, unkept
from jbw.quantities import law_name, split
from jbw.report.messages import stages as messages
from jbw.report.messages.laws import IN_FIRST_MODE, OF_EACH_MODE
from jbw.results.attributes import DrawnPosterior

Laws = tuple[str, ...]

NUM_SAMPLES = 250  # number of draws in each of four independent groups of draws
# largest number of rounds of weighted points for the evidence of laws that fit badly
MOST_ROUNDS = 24
# A parameter is at a bound if it is closer to the bound than this fraction of the prior's width.
AT_BOUND = 1e-3
# relative standard deviation of omega_n between runs, typical of runs on different days
RUN_SCATTER = 5e-4
# additions to the name of laws, which state how several modes have separate joints
MEET = {"apart": OF_EACH_MODE, "first": IN_FIRST_MODE}
OF_JOINT = frozenset(name for names in NAMES for name in (names.sign, names.shape, names.coupling))
# Largest number of rounds; in each one, all laws are fitted with the error weights of the best law.
MOST_TURNS = 2
# A law is hopeless, that is, it does not fit at all, if its largest likelihood is this many nats
# below that of the best law and its error is this many times that of the best law.
FAR_BELOW, FAR_OFF = 100.0, 2.0
FEW_DRAWS = 50  # number of draws per group from the fit of a law that does not fit at all


@dataclass(frozen=True)
class Candidate:
    """One or more parallel laws, fitted to the data of a comparison."""

    laws: Laws
    fitted: Fitted
    meet: str = ""  # key of MEET: how modes share joints; empty if the campaign's statement applies

    @property
    def name(self) -> str:
        """The laws' names, and the way in which modes share joints if it is not the campaign's."""
        return name_of(self.laws, self.meet)

    @property
    def error(self) -> float:
        """The relative error of the fit: root mean square over the data groups."""
        return rms(list(errors_of(self.fitted.fit, self.fitted.data).values()))

    @property
    def at_bound(self) -> tuple[str, ...]:
        """The parameters whose optimum lies at a bound of their prior."""
        names, x = self.fitted.box.names, np.asarray(self.fitted.fit.x)
        return tuple(
            n
            for n, coordinate in zip(names, x, strict=True)
            if min(coordinate, 1.0 - coordinate) < AT_BOUND
        )


def candidates(
    key: Key[Array, ""],
    seen: Measured,
    sets: Sequence[Laws],
    report: Report,
    parts: Parts = unkept,
) -> tuple[list[Candidate], dict[str, str]]:
    """Fit each set of laws, then fit all sets again with the data weights of the best one.

    The priors are fixed before the first fit, by omega_n, zeta and the largest displacement alone;
    a default bound that a law's first fit reaches is moved away once. With several modes, the
    campaign's own laws are tried in one joint, in a separate joint for each mode, and in the first
    mode alone. Laws that cannot be fitted are returned by name with the reason. `parts` stores the
    first fit of every law.
    """
    data, settings = assemble(seen), alike(seen.settings)
    known = joint_starts(key, seen)
    fits: list[Candidate] = []
    refused: dict[str, str] = {}
    for laws, meet in trials(sets, seen):
        report(f"Fitting {name_of(laws, meet)}")
        forget_when_many()
        try:
            tried, own_settings = tried_under(laws, data, meet, settings)
            named = partial(_named, parts, name_of(laws, meet))
            prior, first, weighed_data = first_fit(key, tried, own_settings, known, parts=named)
        except JbwError as error:
            refused[name_of(laws, meet)] = str(error)
        else:
            fitted = Fitted(first, prior, weighed_data)
            fitted = widened_by_fit(fitted, own_settings.prior) or fitted
            fits.append(Candidate(laws, fitted, meet))
    if not fits:
        raise ConfigError(f"None of the laws can be fitted: {next(iter(refused.values()))}")
    weighing: Candidate | None = None
    for _ in range(MOST_TURNS):
        best = min(fits, key=lambda candidate: candidate.error)
        if weighing is not None and best.name == weighing.name:
            break
        report(messages.fitting_as(best.name))
        best_fitted = best.fitted
        # Keep the priors of these laws, and the signs of the modes that this fit found.
        unweighed = replace(
            under(best.laws, data, best.meet),
            held=best_fitted.data.held,
            stated=best_fitted.data.stated,
        )
        ready = reweight(key, unweighed, best_fitted.box, best_fitted.fit, settings)
        weighing = replace(best, fitted=ready)
        keys = jax.random.split(key, len(fits))
        fits = [again(k, candidate, ready) for k, candidate in zip(keys, fits, strict=True)]
    return fits, refused


def _named[T](parts: Parts, law: str, name: str, make: Callable[[], T], *kinds: type) -> T:
    return parts(f"{name} of {law}", make, *kinds)


def tried_under(
    laws: Laws, data: Dataset, meet: str, settings: Identify
) -> tuple[Dataset, Identify]:
    """Return the dataset with other laws, and the settings with the priors of these laws.

    Raises:
        ConfigError: A law cannot be identified for several joints.
    """
    tried = under(laws, data, meet)
    if data.modes is None or data.modes.meet != ASSEMBLED:
        return tried, settings
    require_known_laws(laws)
    settings = with_shape_priors(data.modes, laws, settings)
    return with_stated_priors(settings, tried), settings


def joint_starts(key: Key[Array, ""], seen: Measured) -> dict[str, float]:
    """Return starting values of Bouc-Wen laws at several joints; empty for one joint."""
    if seen.joints is None:
        return {}
    groups = dict.fromkeys(split(law)[1] for law in seen.laws)
    laws = tuple(law_name(BoucWenLaw.name, joints) for joints in groups)
    joints = replace(seen.joints, laws=laws)
    return joint_readings(key, replace(seen, laws=laws, joints=joints)).known


def alike(settings: Identify) -> Identify:
    """Return settings that treat all laws equally: same coordinates, same variation between runs.

    Softening and the runs' offsets are correlated: with a wide prior, offsets could replace all
    softening.
    """
    scatter = settings.run_scatter or RUN_SCATTER
    return settings.model_copy(update={"coordinates": "paper", "run_scatter": scatter})


def again(key: Key[Array, ""], one: Candidate, common: Fitted) -> Candidate:
    """Fit a candidate law again, to the data and with the residual terms common to all candidates.

    The number of solver steps is increased as needed.
    """
    forget_when_many()
    terms = terms_of(common.box)
    prior, best = with_terms(one.fitted.box, terms), one.fitted.fit
    data = with_modes_of(one, under(one.laws, common.data, one.meet))
    begun = {name: common.fit.theta[name] for name in terms} | dict(best.theta)
    best = refit(best, prior, data, theta=begun)
    if data.has_offsets:
        data = dataset.with_directions(best.theta, data, dataset.best_offsets(best.theta, data))
        best = refit(best, prior, data)
    finer = refined(key, data, prior, best)
    if finer is not data:
        data, best = finer, refit(best, prior, finer)
    return replace(one, fitted=Fitted(best, prior, data, one.fitted.statements))


def trials(sets: Sequence[Laws], seen: Measured) -> list[tuple[Laws, str]]:
    """Return the sets of laws to compare, with the ways in which modes may share joints."""
    plain = [(laws, "") for laws in sets]
    if seen.modes is None or seen.modes.meet != "common" or not seen.laws:
        return plain
    # Free decays do not allow a separate joint for every mode, because uncoupled modes are
    # identified one at a time, each in a separate band.
    ways = ("first",) if any(test.traits.is_free for test in seen.chosen) else tuple(MEET)
    return [*plain, *((seen.laws, meet) for meet in ways)]


def under(laws: Laws, data: Dataset, meet: str = "") -> Dataset:
    """Return the dataset with other laws; `meet` states how several modes share the joints."""
    modes, held = data.modes, data.held
    if modes is not None and meet:
        modes = modes._replace(meet=meet)
        held = {name: value for name, value in held.items() if name not in OF_JOINT}
    parts = tuple(replace(part, laws=laws, modes=modes) for part in data.parts)
    return replace(data, parts=parts, held=held)


def with_modes_of(one: Candidate, data: Dataset) -> Dataset:
    """Return data with a candidate's signs and shapes of modes, and with the candidate's priors.

    Shapes are fixed only if they were measured.
    """
    apart = {n: x for n, x in data.held.items() if n not in OF_JOINT}
    of_joint = {n: x for n, x in one.fitted.data.held.items() if n in OF_JOINT}
    return replace(data, held=apart | of_joint, stated=one.fitted.data.stated)


def name_of(laws: Laws, meet: str = "") -> str:
    """Return the laws' names; unless `meet` is empty, add the way in which modes share joints."""
    return (" + ".join(laws) or "linear") + MEET.get(meet, "")


def errors_of(best: Fit, data: Dataset) -> dict[str, float]:
    """Return each data group's error at a fit, relative to the group's response."""
    residuals = dataset.residual_by_label(best.residual, data)
    return {n: e for n, e in dataset.error_by_label(residuals, data).items() if np.isfinite(e)}


def posterior(key: Key[Array, ""], one: Candidate) -> tuple[xr.DataTree, Reparametrisation]:
    """Draw a candidate law's posterior with its evidence; also return coordinates near the draws.

    The number of points is limited. If their weights cannot be trusted, the other coordinates are
    tried too.
    """
    best, prior, data = one.fitted.fit, one.fitted.box, one.fitted.data
    parametrisations = {
        "straight": lambda: place_of(best, one),
        "valley": cache(lambda: about_valley(dataset.stacked, prior, data, best)),
    }
    target = Target(dataset.log_likelihood, prior, data)
    request = SamplingRequest("amis", num_samples=NUM_SAMPLES, options={"most_rounds": MOST_ROUNDS})
    chosen, _, evaluations = choose(jax.random.fold_in(key, 2), target, parametrisations)
    tried: list[tuple[xr.DataTree, Reparametrisation, float]] = []
    for name in sorted(parametrisations, key=lambda name: name != chosen):
        if (place := parametrisations[name]()) is None:
            continue
        tree = draw_posterior(key, target, request, place, attrs=attrs(one.laws))
        facts = DrawnPosterior.of(tree)
        evaluations += facts.num_evaluations
        tree.attrs |= {"coordinates": name}
        khat = np.inf if facts.khat is None else facts.khat
        tried.append((tree, place, khat))
        if khat < GOOD_KHAT:
            break
    draws, place, _ = min(tried, key=itemgetter(2))
    draws.attrs |= {"num_evaluations": evaluations}
    parametrisation = about_draws(draws, prior, place)
    return with_derived(jax.random.fold_in(key, 1), draws, data), parametrisation


def likelihood_at(best: Fit, data: Dataset) -> float:
    """Return the log likelihood [nats] at a fit, which is its largest value."""
    theta = {name: np.array([value]) for name, value in best.theta.items()}
    return float(np.sum(at_points(dataset.log_likelihood, theta, data)))


def hopeless(found: Sequence[Candidate], likelihoods: Mapping[str, float]) -> set[str]:
    r"""Return the names of candidate laws that cannot have as much evidence as the best law.

    $$\log Z = \log \int L\,\pi \le \log L_{max}$$

    A candidate is named if this bound lies far below the likelihood of the law with the smallest
    error, and its own error is several times as large. Further points near the fit give no more
    information: they are rough and take longest where a law misses the data most.
    """
    least = min(found, key=lambda candidate: candidate.error)
    below, off = likelihoods[least.name] - FAR_BELOW, FAR_OFF * least.error
    return {
        candidate.name
        for candidate in found
        if likelihoods[candidate.name] < below and candidate.error > off
    }


def about_fit(key: Key[Array, ""], one: Candidate) -> xr.DataTree:
    """Return draws from the Gaussian approximation at the fit of a hopelessly wrong law.

    These are no posterior draws. A draw at which a solve fails is moved to the fit.
    """
    best, prior, data = one.fitted.fit, one.fitted.box, one.fitted.data
    problem = problem_of(dataset.log_likelihood, prior, data, place_of(best, one))
    dims, shape, units = ("chain", "draw"), (4, FEW_DRAWS), attrs(one.laws)
    w = jnp.asarray(generator(key).standard_normal((4 * FEW_DRAWS, len(prior.names))))
    theta = {n: np.append(x, best.theta[n]) for n, x in jax.vmap(problem.theta)(w).items()}
    terms = at_points(dataset.log_likelihood, theta, data)
    chosen = np.where(np.isfinite(terms[:-1].sum(axis=1)), np.arange(len(w)), -1).reshape(shape)
    posterior = xr.Dataset(
        {n: (dims, x[chosen], units.get(n, {})) for n, x in theta.items()},
        {dim: np.arange(size) for dim, size in zip(dims, shape, strict=True)},
    )
    likelihood = xr.Dataset({"terms": ((*dims, "term"), terms[chosen])})
    tree = xr.DataTree.from_dict({"posterior": posterior, "log_likelihood": likelihood})
    return with_derived(jax.random.fold_in(key, 1), tree, data)


def place_of(best: Fit, one: Candidate) -> Reparametrisation:
    """Return sampling coordinates near a fit; one axis follows the least determined direction."""
    prior, optimum = one.fitted.box, (best.theta, best.covariance)
    if best.weak is not None or best.at_bound:
        return along_ridge(*optimum, prior)
    return along_logarithms(*optimum, prior, never_zero(*optimum, prior))


def without_offsets(
    key: Key[Array, ""], seen: Measured, found: Sequence[Candidate], best: Candidate
) -> list[Candidate]:
    """Fit the candidate laws again, with omega_n and zeta equal in all runs.

    The data have the weights of the best law without offsets. The comparison shows how much of the
    softening the offsets of runs replace.
    """
    settings = alike(seen.settings).model_copy(update={"offsets": "none"})
    fitted = best.fitted
    data = under(best.laws, assemble(seen), best.meet)
    # The signs of the modes are kept from the fit with offsets.
    data = replace(data, held=fitted.data.held)
    ready = reweight(key, data, fitted.box, fitted.fit, settings)
    keys = jax.random.split(key, len(found))
    return [again(k, candidate, ready) for k, candidate in zip(keys, found, strict=True)]


def offset_changes(best: Candidate, shared: Candidate) -> dict[str, Any]:
    """Return the parameters and errors of a law, with and without offsets of the runs."""
    pair = best.fitted.fit, shared.fitted.fit
    std = [np.sqrt(np.diag(fit.covariance)) for fit in pair]
    rows = {
        name: {
            "with": float(pair[0].theta[name]),
            "with_sd": float(std[0][i]),
            "without": float(pair[1].theta[name]),
            "without_sd": float(std[1][i]),
        }
        for i, name in enumerate(best.fitted.box.names)
        if name in shared.fitted.box.names
    }
    return {"parameters": rows, "error": [best.error, shared.error]}
