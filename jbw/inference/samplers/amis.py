r"""Adaptive multiple importance sampling: mixtures are refitted to all weighted points.

$$w_i = \frac{p(D | \theta_i)\,\pi(x_i)}{\frac1n \sum_r n_r\,q_r(x_i)}, \qquad
\hat Z = \frac1n \sum_i w_i$$

Each round takes n_r of all n points from a mixture fitted to the earlier points, and every point is
weighted against the mixtures of all rounds, so that no point is lost. The first rounds, whose
mixtures are still rough, are small. The points of a round are independent, and are evaluated in
parallel on all processor cores.

A mixture is high where the points lie to which it was fitted, so it would reduce their weights. So
there are two halves, the points of even and of odd number, each with separate mixtures that are
fitted to the points of the other half.

Reference:
    Cornuet, Marin, Mira and Robert (2012), Scandinavian Journal of Statistics 39, 798; for the
    smoothed weights, Vehtari et al. (2024), JMLR 25, 72; for those cut to fit mixtures, Ionides
    (2008), Journal of Computational and Graphical Statistics 17, 295.
"""

from dataclasses import replace
from functools import partial
from time import perf_counter
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Key
from scipy.optimize import bisect
from scipy.special import logsumexp, softmax

from jbw.inference.generator import generator, words_of
from jbw.inference.lanes import at_points
from jbw.inference.posterior.verdict import ESS, GOOD_KHAT
from jbw.inference.samplers import mixtures
from jbw.inference.samplers.chains import Draws
from jbw.inference.samplers.chunked_run import (
    Kept,
    Progress,
    SoFar,
    Until,
    fingerprint,
    kept_arrays,
)  # fmt: skip
from jbw.inference.samplers.evidence import require_possible
from jbw.inference.samplers.importance import SMALLEST
from jbw.inference.samplers.mixtures import Mixture, Points, Weights
from jbw.inference.samplers.weighed_points import (
    Pair,
    Past,
    SmoothedWeights,
    as_arrays,
    relative,
    resumed,
    weighed,
)
from jbw.inference.space.problem import Problem, log_prior

LEAST = 10.0  # smallest effective number of points per dimension with which a mixture is fitted
# effective number of draws for the ends of 99 % intervals: ten draws lie beyond each end
ENDS = 2000.0
# Sampling continues up to `ENDS` if an effective draw costs no more than this many points.
CHEAP = 4.0
PATIENCE = 10  # number of rounds after which a k-hat just below the limit is accepted
SMALL, SHARE = 8, 4  # number of smaller rounds at the beginning, and the divisor of their size
SURE_KHAT = 0.5  # k-hat below which weights have a finite variance


class Options(NamedTuple):
    """The options of AMIS: numbers of draws and points, and limits for a stop without success.

    Attributes:
        num_samples: Number of draws of each group.
        num_chains: Number of groups.
        num_points: Number of points of a later round.
        most_rounds: Largest number of rounds.
        trial: Number of rounds after which sampling stops if there are fewer than `least` effective
            draws.
        least: Least number of effective draws after `trial` rounds.
    """

    num_samples: int = 1000
    num_chains: int = 4
    num_points: int = 1024
    most_rounds: int = 64
    trial: int = 32
    least: float = 32.0


def gather(
    key: Key[Any, ""],
    problem: Problem,
    options: Options,
    progress: Progress | None = None,
    checkpoint: Kept | None = None,
    until: Until | None = None,
) -> tuple[Draws, Float[np.ndarray, "chain draw term"], float]:
    """Sample in rounds; return equally weighted draws, their likelihoods and the time spent [s].

    Rounds follow until the weights are good and their draws are enough, or there is no prospect of
    that, or rounds or time run out. Rounds of a checkpoint are continued.
    """
    began, seed = perf_counter(), words_of(key)
    mark = "" if checkpoint is None else fingerprint((key, problem), problem, gather, options)
    past, before = resumed(kept_arrays(checkpoint, mark))
    watching = [
        listener
        for listener in (progress, None if checkpoint is None else checkpoint.grown)
        if listener is not None
    ]
    while True:
        if past is not None:
            spent, smoothed = before + perf_counter() - began, weighed(past)
            drawn = _draws(np.random.default_rng(seed), past, smoothed, problem, options)
            last = _is_over(past, smoothed, drawn[0], options, until, spent)
            if checkpoint is not None and (last or checkpoint.due()):
                checkpoint.save(as_arrays(past, spent, mark), last=last)
            for tell in watching:
                count, most, theta = len(past.rounds), options.most_rounds, drawn[0].theta
                tell(SoFar(count, most, theta, None, None, in_rounds=True))
            if last:
                return *drawn, before
        count = 0 if past is None else len(past.rounds)
        size = options.num_points // (SHARE if count < SMALL else 1)
        past = _grown(np.random.default_rng([*seed, count]), past, problem, size)


def look(key: Key[Any, ""], problem: Problem, num_points: int) -> float:
    """Return the effective number of draws in `num_points` trial points around the fit."""
    return weighed(_grown(generator(key), None, problem, num_points)).effective


class WeighedPoints(NamedTuple):
    """Points in parameter space, weighted so that they represent a posterior.

    Attributes:
        theta: Parameters by name.
        terms: Terms of the log likelihood [nats].
        weights: Smoothed weights with sum one.
        khat: k-hat of the weights; good below 0.7.
        log_evidence: Logarithm of the mean weight [nats].
    """

    theta: dict[str, Any]
    terms: Float[np.ndarray, "point term"]
    weights: Float[np.ndarray, " point"]
    khat: float
    log_evidence: float


def points(
    key: Key[Any, ""], problem: Problem, *, size: int, least: float, most_rounds: int
) -> WeighedPoints:
    """Draw weighted points of a posterior in rounds, until enough of them are effective."""
    seed = words_of(key)
    past = _grown(np.random.default_rng([*seed, 0]), None, problem, size)
    smoothed = weighed(past)
    for count in range(1, most_rounds):
        if smoothed.khat < GOOD_KHAT and smoothed.effective >= least:
            break
        past = _grown(np.random.default_rng([*seed, count]), past, problem, size)
        smoothed = weighed(past)
    theta, _ = placed(problem, past.w)
    log_evidence = float(logsumexp(past.log_weight) - np.log(len(past.w)))
    return WeighedPoints(theta, past.terms, smoothed.weights, smoothed.khat, log_evidence)


def _is_over(
    past: Past,
    smoothed: SmoothedWeights,
    drawn: Draws,
    options: Options,
    until: Until | None,
    spent: float,
) -> bool:
    """Return whether sampling ends: enough draws, no prospect of enough, or no time left."""
    count = len(past.rounds)
    if count >= options.most_rounds or (until is not None and spent >= until.budget_s):
        return True
    if count >= options.trial and smoothed.effective < options.least:
        return True
    # A k-hat just below the limit may be chance; stopping at once would select such cases.
    limit = SURE_KHAT if count < PATIENCE else GOOD_KHAT
    if not (smoothed.khat < limit and smoothed.effective >= ESS):
        return False
    if smoothed.effective < ENDS and len(past.w) <= CHEAP * smoothed.effective:
        return False
    return until is None or until.enough(drawn.theta)


def _grown(rng: np.random.Generator, past: Past | None, problem: Problem, num_points: int) -> Past:
    """Draw one more round of points from refitted mixtures; return the points of all rounds."""
    first = mixtures.standard(len(problem.box.names))
    pair = (first, first) if past is None else _next_pair(rng, past)
    half_size = max(num_points // 2, 1)
    halves = [mixtures.draw(rng, mixture, half_size) for mixture in pair]
    w = np.stack(halves, axis=1).reshape(-1, halves[0].shape[1])
    theta, prior = placed(problem, w)
    terms = at_points(problem.log_likelihood, theta, problem.data)
    terms = terms.reshape(len(w), -1)
    likelihood = terms.sum(axis=1)
    density = np.where(np.isfinite(likelihood), likelihood + prior, -np.inf)
    mixed = np.log(half_size) + _log_density(pair, w)
    if past is None:
        require_possible(bool(np.any(np.isfinite(density))))
        return Past(w, terms, density, mixed, np.array([half_size]), (pair,))
    for size, past_pair in zip(past.sizes, past.rounds, strict=True):
        mixed = np.logaddexp(mixed, np.log(size) + _log_density(past_pair, w))
    earlier = np.logaddexp(past.log_mixed, np.log(half_size) + _log_density(pair, past.w))
    return Past(
        np.concatenate([past.w, w]),
        np.concatenate([past.terms, terms]),
        np.concatenate([past.log_density, density]),
        np.concatenate([earlier, mixed]),
        np.append(past.sizes, half_size),
        (*past.rounds, pair),
    )


def placed(
    problem: Problem, w: Float[np.ndarray, "point parameter"]
) -> tuple[dict[str, Any], Float[np.ndarray, " point"]]:
    """Return the parameters by name, and the log prior density, at normalised points."""
    return jax.tree.map(np.asarray, _placed(replace(problem, data=None), jax.device_put(w)))


@eqx.filter_jit
def _placed(problem: Problem, w: Float[Array, "point parameter"]) -> tuple[dict[str, Any], Any]:
    """Return the parameters and the log prior density at normalised points (compiled)."""
    prior = partial(log_prior, problem, problem.coordinate)
    return jax.vmap(problem.theta)(w), jax.vmap(prior)(w)


def _log_density(pair: Pair, w: Points) -> Weights:
    """Return the log density of each point under the mixture from which it was drawn."""
    halves = [mixtures.log_density(mixture, w[i::2]) for i, mixture in enumerate(pair)]
    return np.stack(halves, axis=1).ravel()


def _next_pair(rng: np.random.Generator, past: Past) -> Pair:
    """Fit a mixture to each half of the points, from which the other half is drawn next."""
    raw = relative(past.log_weight)
    others = [slice(1 - i, None, 2) for i in range(2)]
    others = [half if np.any(raw[half] > SMALLEST) else slice(None) for half in others]
    first, second = (_next_mixture(rng, past.w[half], raw[half]) for half in others)
    return first, second


def _next_mixture(rng: np.random.Generator, w: Points, log_weight: Weights) -> Mixture:
    """Fit a mixture to weighted points; limit weights if a few dominate.

    No weight exceeds the mean times the root of the number of points (Ionides 2008): otherwise one
    point far out would spoil the mixture.
    """
    most = logsumexp(log_weight) - 0.5 * np.log(len(log_weight))
    raw = relative(np.minimum(log_weight, most))
    least = min(LEAST * w.shape[1], 0.5 * np.sum(raw > SMALLEST))

    def lacking(power: float) -> float:
        return np.log(least) + logsumexp(2 * power * raw) - 2 * logsumexp(power * raw)

    power = 1.0 if lacking(1.0) <= 0 else float(np.asarray(bisect(lacking, 0.0, 1.0)))
    weights = softmax(power * raw)
    return mixtures.widened(mixtures.refitted(rng, w, weights), w, weights)


def _draws(
    rng: np.random.Generator,
    past: Past,
    smoothed: SmoothedWeights,
    problem: Problem,
    options: Options,
) -> tuple[Draws, Float[np.ndarray, "chain draw term"]]:
    """Draw points of equal weight by stratified resampling, separately for each group of draws.

    Points of all rounds are shuffled, so that the parts of a group differ by chance alone. Copies
    of a point are adjacent, so an effective size from autocorrelation counts them as one.
    """
    rows, order = [], rng.permutation(len(past.w))
    for group in range(options.num_chains):
        group_rows = order[group :: options.num_chains]
        ends = np.cumsum(smoothed.weights[group_rows])
        levels = (np.arange(options.num_samples) + rng.random(options.num_samples)) * ends[-1]
        which = np.searchsorted(ends, levels / options.num_samples)
        rows.append(group_rows[np.minimum(which, len(group_rows) - 1)])
    chosen = np.stack(rows)
    theta, _ = placed(problem, past.w[chosen.ravel()])
    log_weight, count = past.log_weight, len(past.w)
    facts = {
        "log_evidence": float(logsumexp(log_weight) - np.log(count)),
        "log_evidence_error": float(np.sqrt(max(1 / smoothed.effective - 1 / count, 0.0))),
        "khat": smoothed.khat,
        "ess_weights": smoothed.effective,
        "num_evaluations": count,
        "rounds": len(past.rounds),
    }
    by_name = {name: values.reshape(chosen.shape) for name, values in theta.items()}
    stats: dict[str, Any] = {"log_weight": log_weight[chosen]}
    return Draws(by_name, stats, True, True, facts), past.terms[chosen]
