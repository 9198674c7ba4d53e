r"""Iterated batch importance sampling: particles of a posterior that take in one record more.

$$w_i \leftarrow w_i\, p(y_r \mid \theta_i, y_{<r}), \qquad
  p(y_r \mid y_{<r}) = \frac{\sum_i w_i\, p(y_r \mid \theta_i, y_{<r})}{\sum_i w_i}$$

Where fewer than half of them count, by Kish's $(\sum w)^2 / \sum w^2$, they are drawn again by
systematic resampling and move by a random walk, shaped by their covariance, on the posterior that
has the record in it.

Reference: Chopin, Biometrika 89 (2002) 539.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp

ENOUGH = 0.5  # share of particles that count, below which they are drawn again and moved
NUM_MOVES = 5  # of each particle then
TARGET_ACCEPT = 0.3  # of the moves
LogDensity = Callable[[Float[np.ndarray, "particle d"]], Float[np.ndarray, " particle"]]


class Particles(NamedTuple):
    """A posterior as weighted points.

    Attributes:
        x: Points.
        log_weight: Logarithms of their weights, which add up to one.
        log_density: Of each under the posterior that they stand for, up to a constant [nats].
    """

    x: Float[np.ndarray, "particle d"]
    log_weight: Float[np.ndarray, " particle"]
    log_density: Float[np.ndarray, " particle"]


class Update(NamedTuple):
    """What a record has made of particles."""

    particles: Particles
    log_evidence: float  # log p(y_r | y_<r) [nats]
    kish: float  # share of them that counted with the record's weights
    accepted: float | None  # share of the moves; None where there were none


def particles_of(x: Float[np.ndarray, "particle d"], log_density: LogDensity) -> Particles:
    """Draws of a posterior, all of one weight."""
    return Particles(x, np.full(len(x), -np.log(len(x))), log_density(x))


def take_in(rng: np.random.Generator, before: Particles, log_density: LogDensity) -> Update:
    """Particles with one record more; `log_density` is that of the posterior with it in [nats]."""
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
    """Particles of one weight: each comes as often as its weight says, give or take one."""
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
    """Particles after moves of a random walk by Metropolis, and the share that was accepted."""
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
