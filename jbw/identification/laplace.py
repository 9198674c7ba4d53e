r"""The result of a fit alone: a Gaussian approximation in place of posterior draws.

$$w \sim N(0, I), \qquad \theta = T(\hat u + L w), \qquad L L^T = \Sigma$$

T is the coordinate system of the posterior: logarithms for parameters that cannot be zero. Sigma is
the fit's covariance there; there is one for every possible scatter of runs if that is unknown.
Points outside the prior box are omitted, as in the posterior; if few lie inside, the Gaussian is
drawn within the box. A curved posterior differs from this approximation: weighted points replace
the Gaussian there (`curved.py`). No verdict follows in either case.

Reference:
    Tierney and Kadane (1986), J. Am. Stat. Assoc. 81, 82.
"""

from collections.abc import Mapping
from dataclasses import replace
from time import perf_counter
from typing import NamedTuple

import jax
import numpy as np
import xarray as xr
from jaxtyping import Array, Float, Key
from scipy.linalg import block_diag
from scipy.special import softmax

from jbw.identification.accuracy import errors_and_colour
from jbw.identification.assemble import Measured, Report, assemble
from jbw.identification.checks import Checks, seen_hysteresis
from jbw.identification.curved import is_curved, possible_draws, weighted_draws
from jbw.identification.equivalent import effects
from jbw.identification.free_decays import FreeDecays, decays_in
from jbw.identification.gain_units import with_gain_units
from jbw.identification.joint import JointPosterior, law_variables
from jbw.identification.joint_answers import JOINTS, joints_finding, joints_group, joints_words
from jbw.identification.joint_modes import joint_modes
from jbw.identification.one_mode_readings import joint_readings, with_readings
from jbw.identification.prepare import Fitted, prepare
from jbw.identification.procedure import Posteriors
from jbw.identification.run_effects import runs_dataset, runs_sentence
from jbw.identification.size import announced
from jbw.identification.step import attrs
from jbw.identification.widening import ending, widened_by_fit
from jbw.inference.fit.costly_fit import evaluator, from_search, to_search
from jbw.inference.generator import generator, parts_of
from jbw.inference.posterior.finding import Finding
from jbw.inference.posterior.summary import LAPLACE
from jbw.inference.posterior.verdict import bounds_findings
from jbw.inference.samplers.truncated_gaussian import mixture_within
from jbw.inference.space.box import bounds_by_name
from jbw.inference.space.reparametrisation import in_logarithms, never_zero
from jbw.observables import dataset
from jbw.observables.dataset import Dataset, by_label
from jbw.observables.drives import plain
from jbw.observables.observable import OFFSETS
from jbw.report.messages import posterior as messages
from jbw.report.messages import stages

NUM_CHAINS, NUM_DRAWS = 4, 1000  # numbers of chains and of draws, as in a sampled posterior
Points = Float[np.ndarray, "draw parameter"]
SPARE = 8  # factor on the number of points, so that enough of them lie within the bounds
NOTHING = 1e-9  # factor that suppresses offsets between runs
LEAST = 12.0  # inverse variance of a uniform prior, multiplied by the prior's squared width


def fit_alone(
    seen: Measured, *, seed: int, report: Report, start: Mapping[str, float] | None = None
) -> Posteriors:
    """Fit all tests of a campaign; return a Gaussian approximation in place of sampled draws.

    Args:
        seen: The tests of the campaign.
        seed: Random seed.
        report: Function that is called with one sentence before the fit.
        start: Parameters of an earlier fit, from which the fit starts.

    Raises:
        DataError: If no test is left to fit the joint to.
    """
    started, key = perf_counter(), jax.random.key(seed)
    data = assemble(seen)
    announced(report, stages.least_squares, data)
    readings = joint_readings(key, seen)
    keys = parts_of(key, 2)
    ready = prepare(keys, data, seen.settings, readings.known, start=start, quick=True)
    ready = with_readings(ready, readings)
    ready = widened_by_fit(ready, seen.settings.prior) or ready
    ready = replace(ready, wall_s=perf_counter() - started)
    return about_fit(key, seen, ready, weighs=True)


def about_fit(
    key: Key[Array, ""], seen: Measured, ready: Fitted, *, weighs: bool = False
) -> Posteriors:
    """Return a fit's Gaussian approximation in the same form as a sampled posterior.

    If `weighs`, weighted points replace the Gaussian where the posterior is curved.
    """
    started = perf_counter()
    curved = weighs and is_curved(ready)
    weighted = weighted_draws(key, ready, NUM_CHAINS, NUM_DRAWS) if curved else None
    draws, effective = weighted or (laplace_draws(key, ready), None)
    if curved and weighted is None:
        draws = possible_draws(key, *draws, ready.data)
    tree = with_gain_units(laplace_tree(ready, draws, effective), seen.tests)
    joint = JointPosterior("joint", tree, ready, ready.wall_s + perf_counter() - started)
    in_fit = None if seen.decays is None else decays_in(ready.data)
    # Offsets of runs are drawn for an answer of its own, not for one that a posterior follows.
    runs = runs_dataset(key, joint.draws, ready.box.names, ready.data) if weighs else None
    return Posteriors(joint, checks_of_fit(joint, effective, runs), FreeDecays(in_fit))


def laplace_tree(
    ready: Fitted,
    draws: tuple[np.ndarray, Mapping[str, np.ndarray]],
    effective: float | None,
) -> xr.DataTree:
    """Return draws near a fit, in the groups of a sampler's result.

    The draws represent `effective` weighted points, or the fit's Gaussian approximation if None.
    """
    lp, theta = draws
    meant = messages.LOG_DENSITY if effective is None else messages.LOG_LIKELIHOOD
    low_high, meaning = bounds_by_name(ready.box), attrs(ready.data.laws)
    dims, shape = ("chain", "draw"), (NUM_CHAINS, NUM_DRAWS)
    posterior = xr.Dataset(
        {
            name: (
                dims,
                values.reshape(shape),
                {"lower": low_high[name][0], "upper": low_high[name][1], **meaning.get(name, {})},
            )
            for name, values in theta.items()
        },
        {dim: np.arange(size) for dim, size in zip(dims, shape, strict=True)},
    )
    words = {"units": "1", "long_name": meant}
    tree = xr.DataTree.from_dict(
        {
            "/posterior": posterior.assign(law_variables(posterior, ready.data)),
            "/sample_stats": xr.Dataset({"lp": (dims, lp.reshape(shape), words)}, posterior.coords),
        }
    )
    tree.attrs |= {"sampler": LAPLACE, "num_chains": NUM_CHAINS, "num_samples": NUM_DRAWS}
    return tree


def checks_of_fit(
    joint: JointPosterior, effective: float | None, runs: xr.Dataset | None
) -> Checks:
    """Return the checks of a fit that has no posterior draws: its findings and statements.

    Args:
        joint: Draws near the fit.
        effective: Effective number of weighted points; None for a Gaussian approximation.
        runs: Draws of omega_n and zeta of each run; None without offsets of runs.
    """
    started, ready = perf_counter(), joint.fitted
    modes = joint_modes(joint.draws, ready.data, ready.fit.theta)
    joints = None if modes is None else joints_group(joint.draws, ready.data, modes)
    of_joints = joints_finding(joints)
    sentences = [] if ready.fit.weak is None else [messages.by_fit(ready.fit.weak.text)]
    sentences += [
        messages.at_bound(parameter, side) for parameter, side in ready.fit.at_bound.items()
    ]
    intervals = {"intervals": messages.intervals_of_fit(effective)}
    findings = [
        Finding("not_sampled", "not assessed", intervals, float("nan")),
        *([] if of_joints is None else [of_joints]),
        *doubts_of_fit(joint.draws, ready),
    ]
    sentences += [] if runs is None else [runs_sentence(runs)]
    statements = (*ready.statements, *sentences, *joints_words(joints))
    groups = {JOINTS: joints, "runs": runs}
    groups = {name: group for name, group in groups.items() if group is not None}
    return Checks(tuple(findings), (), statements, groups, perf_counter() - started)


def doubts_of_fit(drawn: xr.Dataset, ready: Fitted) -> list[Finding]:
    """Return findings that question a fit: no hysteresis, or a parameter at a prior bound."""
    data = ready.data
    findings = []
    if (added := effects(drawn, data.held, ready.y_peak, data.laws)) is not None:
        _, shown = errors_and_colour(ready.fit, data)
        misses = shown is not None and shown.status != "ok"
        findings.append(seen_hysteresis(added, ready, misses=misses))
    draws = {name: drawn[name].values for name in ready.box.names}
    findings += bounds_findings(draws, ready.box, ending(ready.box, data.laws))
    return [finding for finding in findings if finding is not None and finding.status != "ok"]


class Gaussian(NamedTuple):
    """One Gaussian component of the posterior near a fit, with its weight."""

    share: float
    mean: Float[np.ndarray, " parameter"]  # mean, relative to the fit
    covariance: Float[np.ndarray, "parameter parameter"]


def laplace_draws(
    key: Key[Array, ""], ready: Fitted
) -> tuple[Float[np.ndarray, " draw"], dict[str, Float[np.ndarray, " draw"]]]:
    """Draw from a fit's Gaussian within the bounds; return log densities and parameters.

    The first draw is the fit. If too few points lie within the box, as near a fit at a bound, the
    Gaussian is drawn within it. Parameters are not moved singly, because they are correlated.
    """
    best, prior, rng = ready.fit, ready.box, generator(key)
    count = NUM_CHAINS * NUM_DRAWS
    gaussians = gaussians_about(ready)
    member = rng.choice(len(gaussians), SPARE * count, p=[gaussian.share for gaussian in gaussians])
    white = rng.standard_normal((SPARE * count, len(prior.names)))
    white[0] = 0.0
    apart = np.empty_like(white)
    for number in np.unique(member):
        _, mean, covariance = gaussians[number]
        is_member = member == number
        apart[is_member] = mean + white[is_member] @ np.linalg.cholesky(covariance).T
    apart[0] = 0.0
    names = never_zero(best.theta, best.covariance, prior)
    place = in_logarithms(best.theta, best.covariance, prior, names)
    scale = np.array([best.theta[name] if name in names else 1.0 for name in prior.names])

    def parameters(apart: Points) -> Points:
        at = jax.device_put(np.asarray(place.start) + apart / scale)
        return np.asarray(jax.vmap(place.outer.forward)(at))

    theta = parameters(apart)
    lower, upper = np.asarray(prior.lower), np.asarray(prior.upper)
    is_inside = np.all((theta >= lower) & (theta <= upper), axis=1)
    is_inside[0] = True
    chosen = np.flatnonzero(is_inside)[:count]
    if len(chosen) < count:
        edges = np.stack([np.asarray(place.lower), np.asarray(place.upper)])
        low, high = scale * (edges - np.asarray(place.start))
        apart, white = mixture_within(rng, gaussians, member, low, high)
        apart[0] = white[0] = 0.0
        chosen = np.arange(count)
        theta = parameters(apart[chosen])
    inside = np.clip(theta[chosen], lower, upper)  # Rounding may move the fit outside the bounds.
    log_density = -0.5 * np.sum(white[chosen] ** 2, axis=1)
    return log_density, {name: inside[:, i] for i, name in enumerate(prior.names)}


def gaussians_about(ready: Fitted) -> list[Gaussian]:
    r"""Return the Gaussian at a fit; with run offsets, one per grid value of the offsets' sd.

    $$r(\theta, b) = \hat r + J\,\delta + J_o\,b, \quad b \sim N(0, C_k), \quad
      P_k = J^T J - J^T J_o\,(J_o^T J_o + C_k^{-1})^{-1} J_o^T J$$

    $J_o$ are the derivatives by omega_n and zeta of each run alone. Three runs determine their
    scatter to a factor of two, so the mean over runs has the tails of Student's t distribution. A
    single Gaussian at the fitted scatter is half as wide as the posterior.
    """
    best, prior, data = ready.fit, ready.box, ready.data
    columns = [[i for i, n in enumerate(prior.names) if plain(n) == name] for name in OFFSETS]
    if not (data.has_offsets and all(columns)):
        return [Gaussian(1.0, np.zeros(len(prior.names)), best.covariance)]
    # With suppressed offsets, the program of the fit computes the residuals without run offsets.
    bare = replace(data, scatter=jax.device_put(NOTHING * np.asarray(data.scatter)))
    part = evaluator(dataset.stacked, prior, bare)
    width = np.asarray(prior.upper) - np.asarray(prior.lower)
    s = np.asarray(to_search(np.asarray(best.x), prior))
    slope = from_search(s, prior)[1]
    rows, jacobian = by_label(part(s, 0), bare), by_label(part(s, 1) / slope / width, bare)
    groups = [
        (label, data.shared_runs.index(run) if not observable.own_shifts else -1)
        for observable in data.parts
        for label, run in zip(observable.groups.labels, observable.groups.runs, strict=True)
    ]
    size, num_offsets = len(prior.names), len(OFFSETS)
    num_runs = len(data.shared_runs)
    precision, pull = np.diag(LEAST / width**2), np.zeros(size)
    of_runs, pull_of_runs = (
        np.zeros((num_runs, num_offsets, num_offsets)),
        np.zeros((num_runs, num_offsets)),
    )
    between = np.zeros((num_runs, size, num_offsets))
    for label, run in groups:
        slopes, residual = jacobian[label], rows[label]
        precision += slopes.T @ slopes
        pull -= slopes.T @ residual
        if run >= 0:
            along = np.stack([slopes[:, indices].sum(axis=1) for indices in columns], axis=1)
            of_runs[run] += along.T @ along
            pull_of_runs[run] -= along.T @ residual
            between[run] += slopes.T @ along
    w = block_diag(*of_runs)
    b, h = np.concatenate([*between], axis=1), pull_of_runs.ravel()
    components = []
    for scatter in np.asarray(data.scatters):
        c = _covariance_of_offsets(scatter, data)
        inside = np.eye(len(c)) + w @ c
        gained = c @ np.linalg.inv(inside)
        marginal_precision, towards = precision - b @ gained @ b.T, pull - b @ gained @ h
        covariance = np.linalg.inv(0.5 * (marginal_precision + marginal_precision.T))
        mean = covariance @ towards
        log_share = 0.5 * (towards @ mean + h @ gained @ h)
        log_share -= 0.5 * (np.linalg.slogdet(inside)[1] + np.linalg.slogdet(marginal_precision)[1])
        components.append((log_share, mean, covariance))
    shares = softmax([share for share, *_ in components])
    return [
        Gaussian(float(p), *component[1:]) for p, component in zip(shares, components, strict=True)
    ]


def _covariance_of_offsets(
    scatter: Float[np.ndarray, " level_own"], data: Dataset
) -> Float[np.ndarray, "run_own run_own"]:
    """Return the prior covariance of all offsets; runs of one assembly share a component."""
    num_offsets, num_runs = len(OFFSETS), len(data.shared_runs)
    run_covariance = np.kron(np.eye(num_runs), np.diag(scatter[:num_offsets] ** 2))
    if len(scatter) == num_offsets:
        return run_covariance
    of_run = dict(zip(dict.fromkeys(data.runs), data.levels[1], strict=True))
    numbers = np.array([of_run[run] for run in data.shared_runs])
    return run_covariance + np.kron(
        numbers[:, None] == numbers, np.diag(scatter[num_offsets:] ** 2)
    )
