r"""Tempered sequential Monte Carlo with Hamiltonian moves, for many particles at once in NumPy.

$$p_\beta(\theta) \propto p(\theta)\, e^{\beta \ell(\theta)}, \qquad
  \log \hat Z = \sum_t \log \frac1N \sum_i e^{(\beta_t - \beta_{t-1}) \ell_i}$$

Between temperatures all particles take Hamiltonian trajectories, in coordinates whitened by their
covariance. `jbw.inference.samplers.tempering` uses random walks instead, for a likelihood in JAX.
For forty to a hundred parameters with slopes in closed form, trajectories need a tenth of its
evaluations.

Reference:
    Del Moral, Doucet, Jasra (2006), J. R. Stat. Soc. B 68, 411; Neal (2011), MCMC using
    Hamiltonian dynamics.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jbw.freeform.prior import Particles
from jbw.freeform.sliders import Reals

PARTICLES = 500
# number of moves on the final posterior, after each of which all particles are stored as draws
KEPT = 8
TARGET_ESS = 0.5  # effective fraction of the particles after a change of the temperature
MOVES = 2  # number of trajectories at every temperature
STEPS = 8  # number of steps of each trajectory
JITTER = 0.2  # relative random variation of a step's length
TARGET_ACCEPT = 0.8
GAIN = 0.5  # gain with which the step length is adapted to the fraction of accepted trajectories
FIRST_STEP = 0.3  # length of the first step, in units of the particles' standard deviations
# fraction of the prior's variance that is added, because equal particles have no covariance
NUGGET = 1e-6
MOST_TEMPERATURES = 500
BISECTIONS = 50
IMPOSSIBLE = -1e30  # log likelihood of parameters for which no motion can be computed [nats]
# Limits of positions (in standard deviations of the prior) and of momenta. A diverging trajectory
# ends there and is rejected for its energy.
FARTHEST, FASTEST = 1e3, 1e6

Density = Callable[[Particles], tuple[Reals, Particles]]


class Tempered(NamedTuple):
    """The result of a tempering run.

    Attributes:
        theta: Draws of the posterior.
        log_evidence: Logarithm of the evidence [nats].
        acceptance: Share of accepted trajectories in the last moves.
        temperatures: Number of temperatures.
    """

    theta: Particles
    log_evidence: float
    acceptance: float
    temperatures: int


class _Swarm(NamedTuple):
    """Particles in units of the prior, with log likelihoods and their derivatives."""

    z: Particles
    log_likelihood: Reals
    slopes: Particles

    def __getitem__(self, chosen: np.ndarray) -> "_Swarm":  # pyright: ignore
        return _Swarm(*(values[chosen] for values in tuple(self)))


def temper(
    log_likelihood: Density,
    mean: Reals,
    sd: Reals,
    rng: np.random.Generator,
    num_particles: int = PARTICLES,
) -> Tempered:
    """Draw from a posterior with a Gaussian prior, and return its evidence.

    Args:
        log_likelihood: Function that returns values and slopes at rows of parameters.
        mean: Means of the prior.
        sd: Standard deviations of the prior.
        rng: Random number generator.
        num_particles: Number of particles; eight times as many draws are returned.
    """

    def density(z: Particles) -> _Swarm:
        value, slopes = log_likelihood(mean + sd * z)
        slopes = np.nan_to_num(slopes * sd, posinf=0.0, neginf=0.0)
        return _Swarm(z, np.where(np.isfinite(value), value, IMPOSSIBLE), slopes)

    # Far outside the prior, strengths overflow; such parameters get zero density.
    with np.errstate(all="ignore"):
        return _tempered(density, mean, sd, rng, num_particles)


def _tempered(
    density: Callable[[Particles], "_Swarm"],
    mean: Reals,
    sd: Reals,
    rng: np.random.Generator,
    num_particles: int,
) -> Tempered:
    swarm = density(rng.standard_normal((num_particles, len(mean))))
    beta, log_evidence, size, temperatures, accepted = 0.0, 0.0, FIRST_STEP, 0, 0.0
    while beta < 1.0 and temperatures < MOST_TEMPERATURES:
        rise = _rise(swarm.log_likelihood, 1.0 - beta)
        top = swarm.log_likelihood.max()
        weights = np.exp(rise * (swarm.log_likelihood - top))
        log_evidence += float(np.log(weights.mean()) + rise * top)
        beta, temperatures = min(beta + rise, 1.0), temperatures + 1
        swarm = _resampled(swarm, weights, rng)
        factor = _factor(swarm.z)
        for _ in range(MOVES):
            swarm, accepted = _trajectory(swarm, density, beta, factor, size, rng)
            size = min(size * np.exp(GAIN * (accepted - TARGET_ACCEPT)), 1.0)
    factor, kept = _factor(swarm.z), []
    for _ in range(KEPT):
        swarm, accepted = _trajectory(swarm, density, 1.0, factor, size, rng)
        kept.append(mean + sd * swarm.z)
    return Tempered(np.concatenate(kept), log_evidence, accepted, temperatures)


def _rise(log_likelihood: Reals, most: float) -> float:
    """Return the largest step of the inverse temperature that leaves enough particles effective."""
    above = log_likelihood - log_likelihood.max()

    def share(rise: float) -> float:
        weights = np.exp(rise * above)
        return float(weights.sum() ** 2 / (weights**2).sum() / len(weights))

    if share(most) >= TARGET_ESS:
        return most
    low, high = 0.0, most
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        low, high = (middle, high) if share(middle) > TARGET_ESS else (low, middle)
    return high


def _resampled(swarm: _Swarm, weights: Reals, rng: np.random.Generator) -> _Swarm:
    """Return particles after systematic resampling by their weights."""
    places = (np.arange(len(weights)) + rng.random()) / len(weights)
    chosen = np.searchsorted(np.cumsum(weights) / weights.sum(), places)
    return swarm[np.minimum(chosen, len(weights) - 1)]


def _factor(z: Particles) -> Float[np.ndarray, "parameter parameter"]:
    covariance = np.atleast_2d(np.cov(z.T))
    return np.linalg.cholesky(covariance + NUGGET * np.eye(z.shape[1]))


def _trajectory(
    swarm: _Swarm,
    density: Callable[[Particles], _Swarm],
    beta: float,
    factor: Float[np.ndarray, "parameter parameter"],
    size: float,
    rng: np.random.Generator,
) -> tuple[_Swarm, float]:
    """Move each particle along a Hamiltonian trajectory; also return the accepted fraction."""
    step = size * (1 + JITTER * (2 * rng.random((len(swarm.z), 1)) - 1))

    def force(at: _Swarm) -> Particles:
        return (beta * at.slopes - at.z) @ factor

    def energy(at: _Swarm, momentum: Particles) -> Reals:
        kinetic = np.sum(momentum**2, axis=1)
        return -beta * at.log_likelihood + 0.5 * (np.sum(at.z**2, axis=1) + kinetic)

    momentum, at = rng.standard_normal(swarm.z.shape), swarm
    before = energy(at, momentum)
    momentum = momentum + 0.5 * step * force(at)
    for k in range(STEPS):
        at = density(np.clip(at.z + step * momentum @ factor.T, -FARTHEST, FARTHEST))
        momentum = momentum + (0.5 if k == STEPS - 1 else 1.0) * step * force(at)
        momentum = np.clip(momentum, -FASTEST, FASTEST)
    change = np.nan_to_num(energy(at, momentum) - before, nan=np.inf, posinf=np.inf)
    chance = np.exp(np.minimum(-change, 0.0))
    taken = rng.random(len(chance)) < chance
    moved = _Swarm(*(
        np.where(taken.reshape(-1, *[1] * (new.ndim - 1)), new, old)
        for new, old in zip(at, swarm, strict=True)
    ))  # fmt: skip
    return moved, float(chance.mean())
