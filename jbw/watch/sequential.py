r"""`jbw.updated`: the posterior of an unchanged joint with new free decays, record by record.

The likelihood of each new record updates the draws of a finished run, where a new identification
would repeat the fit and the sampling. This requires that the joint has not changed, which `jbw
watch` checks. The method is iterated batch importance sampling, whose particles take in one record
at a time,

$$w_i \leftarrow w_i\, p(y_r \mid \theta_i, y_{<r}), \qquad
  p(y_r \mid y_{<r}) = \frac{\sum_i w_i\, p(y_r \mid \theta_i, y_{<r})}{\sum_i w_i}$$

When fewer than half of the particles count, by Kish's $(\sum w)^2 / \sum w^2$, they are resampled
systematically and moved by a random walk, with a step shape from their covariance, on the posterior
that includes the record.

Reference: Chopin, Biometrika 89 (2002) 539.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float
from scipy.special import logsumexp

from jbw.campaign.joints import require_one_joint
from jbw.campaign.load import Campaign
from jbw.campaign.tables import force_per_unit
from jbw.errors import ConfigError, DataError
from jbw.identification.assemble import assemble, measured
from jbw.identification.joint import law_variables
from jbw.identification.usable import usable
from jbw.inference.lanes import at_points
from jbw.inference.posterior.summary import evenly_spaced, posterior_draws
from jbw.inference.space.box import require_float64
from jbw.measurement.records import Record, Test, share_clock
from jbw.observables import dataset
from jbw.observables.dataset import Dataset
from jbw.observables.decay import Decays, counting
from jbw.report.messages import watch
from jbw.results.attributes import DrawnPosterior, StoredVariable
from jbw.study.study import Study

ENOUGH = 0.5  # If the effective fraction of the particles is smaller, they are resampled and moved.
NUM_MOVES = 5  # number of moves of each particle after resampling
TARGET_ACCEPT = 0.3  # fraction of proposed moves that should be accepted
LogDensity = Callable[[Float[np.ndarray, "particle d"]], Float[np.ndarray, " particle"]]
NUM_PARTICLES = 1000
# largest sd of the difference between the recomputed log likelihood and the stored one [nats]
SAME = 0.5


class Particles(NamedTuple):
    """The weighted points that represent a posterior.

    Attributes:
        x: Points.
        log_weight: Logarithms of their weights, which add up to one.
        log_density: Log density of each point under the posterior, up to a constant [nats].
    """

    x: Float[np.ndarray, "particle d"]
    log_weight: Float[np.ndarray, " particle"]
    log_density: Float[np.ndarray, " particle"]


class Update(NamedTuple):
    """The posterior after one more record, as particles, with its evidence and diagnostics."""

    particles: Particles
    log_evidence: float  # log p(y_r | y_<r) [nats]
    # effective fraction of the particles by Kish's formula, with the weights of this record
    kish: float
    accepted: float | None  # fraction of accepted moves; None if particles were not moved


def particles_of(x: Float[np.ndarray, "particle d"], log_density: LogDensity) -> Particles:
    """Return the draws of a posterior as particles of equal weight."""
    return Particles(x, np.full(len(x), -np.log(len(x))), log_density(x))


def take_in(rng: np.random.Generator, before: Particles, log_density: LogDensity) -> Update:
    """Update the particles of a posterior with the likelihood of one more record.

    `log_density` is that of the posterior with the record [nats].
    """
    density = log_density(before.x)
    log_weight = before.log_weight + density - before.log_density
    evidence = float(np.asarray(logsumexp(log_weight)))
    log_weight = log_weight - evidence
    weight = np.exp(log_weight)
    kish = float(1 / np.sum(weight**2) / len(weight))
    now, accepted = Particles(before.x, log_weight, density), None
    if kish < ENOUGH:
        shape = np.atleast_2d(np.cov(before.x.T, aweights=weight))
        now, accepted = moved(rng, evenly(rng, now), shape, log_density)
    return Update(now, evidence, kish, accepted)


def evenly(rng: np.random.Generator, particles: Particles) -> Particles:
    """Resample particles systematically, so that all have equal weight."""
    num = len(particles.x)
    ends = np.cumsum(np.exp(particles.log_weight))
    rows = np.searchsorted(ends / ends[-1], (rng.uniform() + np.arange(num)) / num)
    equal = np.full(num, -np.log(num))
    return Particles(particles.x[rows], equal, particles.log_density[rows])


def moved(
    rng: np.random.Generator,
    particles: Particles,
    shape: Float[np.ndarray, "d d"],
    log_density: LogDensity,
) -> tuple[Particles, float]:
    """Move particles by a Metropolis random walk; return them and the accepted fraction."""
    x, density = particles.x, particles.log_density
    root, shares = np.linalg.cholesky(shape), []
    scale = 2.38 / np.sqrt(x.shape[1])
    for _ in range(NUM_MOVES):
        proposed = x + scale * rng.standard_normal(x.shape) @ root.T
        proposed_density = log_density(proposed)
        accepted = np.log(rng.uniform(size=len(x))) < proposed_density - density
        x, density = (
            np.where(accepted[:, None], proposed, x),
            np.where(accepted, proposed_density, density),
        )
        shares.append(np.mean(accepted))
        scale *= np.exp(shares[-1] - TARGET_ACCEPT)
    return Particles(x, particles.log_weight, density), float(np.mean(shares))


def updated(
    study: Study,
    records: Sequence[Record],
    *,
    num_particles: int = NUM_PARTICLES,
    seed: int = 0,
    report: Callable[[str], None] = print,
) -> xr.DataTree:
    """Return the draws of a joint's posterior updated by new free decays, with their evidence.

    As many values of a new record count as are independent, like those of the run. The posterior is
    marginal over the record's initial state, noise and frequency shift.

    Args:
        study: A finished run that was fitted to free decays alone, from `jbw.load_study`.
        records: New records of the same channels, in the order of measurement.
        num_particles: Number of draws to update, evenly spaced among those of the run; fewer where
            it has fewer.
        seed: Seed of the resampling and of the moves.
        report: A function that is called with one sentence per record.

    Returns:
        `posterior`, draws of equal weight with the laws' own parameters and products; and
        `sequential` by record: `log_evidence`, log p(y_r | y_<r) up to
        a constant that no law changes [nats], `kish`, the share of particles that counted, and
        `accepted`, the accepted share of their moves.

    Raises:
        ConfigError: The session is in float32, no record is given, or the run lacks its campaign.
        DataError: The run has tests other than free decays, or its likelihood cannot be rebuilt; or
            a record has other channels, or is shorter than those of the run.

    Examples:
        A fourth impact updates what three determine, a damping ratio of 0.5 / 127.5:

        >>> import jbw; jbw.enable_x64()
        >>> import numpy as np
        >>> t, rng = np.arange(512) / 128.0, np.random.default_rng(0)
        >>> decay, units = np.exp(-0.5 * t) * np.cos(127.5 * t), {"velocity": "m/s"}
        >>> noisy = [decay + 3e-3 * rng.standard_normal(512) for _ in range(4)]
        >>> hits = [jbw.Record(128.0, {"velocity": v}, units, "hit") for v in noisy]
        >>> test = jbw.Test("decay", tuple(hits[:3]), "hammer", band_hz=(15.0, 26.0))
        >>> exact = {"model_error": "none"}
        >>> campaign = jbw.Campaign("beam", None, (test,), settings=exact, laws=())
        >>> study = jbw.identify(campaign, quick=True)
        >>> tree = jbw.updated(study, hits[3:], num_particles=100, report=lambda sentence: None)
        >>> print(f"{tree['posterior']['zeta'].mean().item():.2%}")
        0.39%
    """
    require_float64()
    if study.campaign is None or not records:
        raise ConfigError(
            "An update needs at least one new record and the run's campaign.",
            remedy="Give records of a test in the campaign, and pass the campaign to "
            "jbw.load_study.",
        )
    posterior = posterior_draws(study.posterior)
    stated = {str(n): StoredVariable.of(v).bounds for n, v in posterior.data_vars.items()}
    sampled = {n: posterior[n] for n, bounds in stated.items() if bounds is not None}
    data, part, test = _fitted(study, study.campaign)
    rows = evenly_spaced(posterior, num_particles)
    draws = np.stack([v.values.ravel()[rows] for v in sampled.values()], axis=-1)
    bounds = np.array([stated[name] for name in sampled])
    names = tuple(sampled)
    stored_density = np.ravel(study.posterior["sample_stats"].to_dataset()["lp"].values)[rows]
    now = particles_of(draws, _density_of(data, names, bounds))
    _require_same(now.log_density - stored_density)
    rng, updates = np.random.default_rng(seed), []
    for i, record in enumerate(records):
        data = replace(data, parts=(_with_records(part, test, records[: i + 1]),))
        updates.append(take_in(rng, now, _density_of(data, names, bounds)))
        now = updates[-1].particles
        moved = updates[-1].accepted is not None
        report(watch.particles(record.name or str(i + 1), updates[-1].kish, moved=moved))
    return _tree(
        dict(zip(names, evenly(rng, now).x.T, strict=True)), sampled, data, updates, records
    )


def _fitted(study: Study, campaign: Campaign) -> tuple[Dataset, Decays, Test]:
    """Return a run's data (with only its fitted decays), the decays alone, and their test."""
    require_one_joint(campaign.joints, watch.CARRIED)
    gain = force_per_unit(campaign)
    tests, _, line_fit = usable(campaign.tests, campaign.settings, gain)
    seen = measured(tests, campaign.settings, laws=campaign.laws, gain=gain, line_fit=line_fit)
    data = assemble(seen)
    if campaign.structure is not None and len(campaign.structure.modes) > 1:
        raise DataError(
            "Decays of a run with several modes cannot be added record by record.",
            remedy="Identify the joint again with the new records in its campaign.",
        )
    if seen.decays is None or [part.kinds for part in data.parts] != [Decays.kinds]:
        raise DataError(
            "The run was also fitted to tests other than free decays.",
            why="The posterior of tests other than decays cannot be updated record by record.",
            remedy="Identify the joint again with the new records in its campaign.",
        )
    test, facts = seen.decays.fitted, DrawnPosterior.of(study.tree).decay
    # The run may have used a finer time step, and its likelihood counts only independent samples.
    substeps = facts.substeps or campaign.settings.substeps
    part = Decays.of(test, laws=data.laws, substeps=substeps)
    part = counting(part, facts.worth)
    return replace(data, parts=(part,)), part, test


def _with_records(part: Decays, test: Test, records: Sequence[Record]) -> Decays:
    """Return a run's fitted decays extended by new records of the same test."""
    response, fs = test.records[0].response, test.records[0].fs
    for record in records:
        if response not in record.channels or not share_clock(record.fs, fs):
            raise DataError(
                f"`{record.name}` lacks the channel or the sampling rate of the run's records: "
                f"{response} at {fs:g} Hz.",
                remedy="Give records that were measured in the same way as the records of the run.",
            )
    every = replace(test, records=(*test.records, *records))
    longer = Decays.of(every, laws=part.laws, substeps=part.substeps)
    return counting(longer, float(part.fraction))


def _density_of(
    data: Dataset, names: Sequence[str], bounds: Float[np.ndarray, "parameter two"]
) -> LogDensity:
    """Return a function that computes a run's log posterior density at given parameter values."""

    def log_posterior(x: Float[np.ndarray, "particle d"]) -> Float[np.ndarray, " particle"]:
        inside = np.all((x >= bounds[:, 0]) & (x <= bounds[:, 1]), axis=1)
        points = dict(zip(names, np.clip(x, *bounds.T).T, strict=True))
        terms = at_points(dataset.log_likelihood, points, data).sum(axis=1)
        return np.where(inside & np.isfinite(terms), terms, -np.inf)

    return log_posterior


def _require_same(strays: Float[np.ndarray, " particle"]) -> None:
    """Raise an error if the recomputed log likelihood differs from the run's stored one."""
    sd = float(np.std(strays))
    if not sd < SAME:
        raise DataError(
            "The likelihood of the run's draws cannot be reproduced: the recomputed values differ "
            f"by {sd:.2g} nats.",
            why="There are two possible causes: the run is a quick run, whose draws come from a "
            "Gaussian approximation; or the campaign now states other weights or solver steps.",
            remedy="Identify the joint again with the new records in its campaign.",
        )


def _tree(
    draws: dict[str, Float[np.ndarray, " draw"]],
    sampled: dict[str, xr.DataArray],
    data: Dataset,
    updates: Sequence[Update],
    records: Sequence[Record],
) -> xr.DataTree:
    """Return a data tree with the updated draws as one chain, and the evidence of each record."""
    posterior = xr.Dataset(
        {n: (("chain", "draw"), x[None], sampled[n].attrs) for n, x in draws.items()}
    )
    posterior = posterior.assign(law_variables(posterior, data))
    accepted = [np.nan if update.accepted is None else update.accepted for update in updates]
    sequential = xr.Dataset(
        {
            "log_evidence": (
                "record",
                [update.log_evidence for update in updates],
                {"units": "nat"},
            ),
            "kish": ("record", [update.kish for update in updates], {"units": "1"}),
            "accepted": ("record", accepted, {"units": "1"}),
        },
        {"record": [record.name or str(i + 1) for i, record in enumerate(records)]},
    )
    return xr.DataTree.from_dict({"/posterior": posterior, "/sequential": sequential})
