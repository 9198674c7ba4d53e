r"""Quick results for a curved posterior: weighted points instead of a Gaussian at the fit.

Two standard deviations from the fit, along each principal axis of its covariance, a Gaussian
posterior has

$$\tfrac12 \left(|r(\theta)|^2 - |\hat r|^2\right) = 2$$

Where parameters trade off or a threshold is near, the left side is many times larger or smaller.
Then the intervals of a Gaussian are too wide or too narrow, and points are weighted by the
posterior instead.
"""

from collections.abc import Mapping
from contextlib import suppress

import jax
import numpy as np
from jaxtyping import Array, Float, Key
from scipy.special import chdtri

from jbw.errors import ModelError
from jbw.identification.prepare import Fitted
from jbw.inference.fit.costly_fit import rows_of, to_search
from jbw.inference.fit.valley import about_valley
from jbw.inference.generator import generator
from jbw.inference.lanes import at_points
from jbw.inference.posterior.verdict import GOOD_KHAT
from jbw.inference.samplers.amis import WeighedPoints, points
from jbw.inference.space.problem import problem_of
from jbw.inference.space.reparametrisation import along_logarithms, in_logarithms, never_zero
from jbw.observables import dataset
from jbw.observables.dataset import Dataset

Chains = Float[np.ndarray, "chain draw"]
Draws = Float[np.ndarray, " draw"]
DISTANCE = 2.0  # distance of the tested points from the fit, in standard deviations
# limits of the fall of the log likelihood from the fit to the tested points; for a Gaussian
# posterior the fall is 2
LEAST, MOST = 1.0, 4.0
SIZE, MOST_ROUNDS = 256, 12  # number of points in a round of weighting, and number of rounds
# numbers of effective points: above the first one, no further round begins; below the second one,
# the Gaussian approximation is used
ENOUGH, FEWEST = 200.0, 100.0
# probability of a smaller likelihood in a Gaussian posterior below which a draw is excluded, and
# number of draws that are kept in any case
EXCLUDED, KEPT = 1e-5, 100
MOST_KHAT = 1.0  # k-hat above which weights have no finite mean


def is_curved(ready: Fitted) -> bool:
    """Return whether the posterior departs from the fit's Gaussian along any principal axis.

    Points outside the prior box are left out. A point at which the model cannot be solved departs.
    """
    best, prior = ready.fit, ready.box
    place = in_logarithms(
        best.theta, best.covariance, prior, never_zero(best.theta, best.covariance, prior)
    )
    covariance = np.asarray(place.covariance)
    std = np.sqrt(np.diag(covariance))
    variances, directions = np.linalg.eigh(covariance / np.outer(std, std))
    axes = DISTANCE * (std[:, None] * directions * np.sqrt(np.maximum(variances, 0.0))).T
    steps = np.concatenate([np.zeros((1, len(std))), axes, -axes])
    forward = jax.vmap(place.outer.forward)
    theta = np.asarray(forward(jax.device_put(np.asarray(place.start) + steps)))
    lower, upper = np.asarray(prior.lower), np.asarray(prior.upper)
    is_inside = np.all((theta >= lower) & (theta <= upper), axis=1)
    is_inside[0] = True
    unit = np.clip((theta[is_inside] - lower) / (upper - lower), 0.0, 1.0)
    rows = rows_of(dataset.stacked, prior, ready.data)(
        np.stack([np.asarray(to_search(point, prior)) for point in unit])
    )
    half = 0.5 * np.sum(rows**2, axis=1)
    differences = half[1:] - half[0]
    return not bool(np.all((differences > LEAST) & (differences < MOST)))


def weighted_draws(
    key: Key[Array, ""], ready: Fitted, num_chains: int, num_draws: int
) -> tuple[tuple[Chains, dict[str, Chains]], float] | None:
    """Return draws from weighted points, and the effective number of these points.

    The draws are log likelihoods [nats] and parameters by name, (chain, draw). None if no
    coordinates give reliable weights.

    Logarithms are the first coordinates. If their weights are poor, those along the valley of the
    least determined parameter are tried too, and the better are taken.
    """
    best, prior, data = ready.fit, ready.box, ready.data
    optimum = best.theta, best.covariance
    tried: list[WeighedPoints] = []
    for coordinates in (
        lambda: along_logarithms(*optimum, prior, never_zero(*optimum, prior)),
        lambda: about_valley(dataset.stacked, prior, data, best),
    ):
        if (place := coordinates()) is None:
            continue
        problem = problem_of(dataset.log_likelihood, prior, data, place)
        with suppress(ModelError):  # No point can be solved in these coordinates.
            tried.append(points(key, problem, size=SIZE, least=ENOUGH, most_rounds=MOST_ROUNDS))
        if tried and tried[-1].khat < GOOD_KHAT:
            break
    if not tried:
        return None
    found = min(tried, key=lambda points: points.khat)
    effective = float(1 / np.sum(found.weights**2))
    if not (found.khat <= MOST_KHAT and effective >= FEWEST):
        return None
    rng, shape = generator(key), (num_chains, num_draws)
    rows = rng.choice(len(found.weights), shape, p=found.weights / found.weights.sum())
    theta = {name: np.asarray(found.theta[name])[rows] for name in prior.names}
    density = found.terms.sum(axis=1)[rows]
    return (density, theta), effective


def possible_draws(
    key: Key[Array, ""], density: Draws, theta: Mapping[str, Draws], data: Dataset
) -> tuple[Draws, dict[str, Draws]]:
    """Return the draws; for a draw that the data exclude, return one that they do not exclude.

    Beyond a threshold of its law, or along a curved ridge, a Gaussian reaches parameters whose
    likelihood is smaller than that of any of 10^5 draws of a Gaussian posterior; or at which the
    model cannot be solved, so that a single draw would leave a prediction without a median. The
    hundred most likely draws are kept in any case.
    """
    known = at_points(dataset.log_likelihood, theta, data).sum(axis=1)
    known = np.where(np.isfinite(known), known, -np.inf)
    least = known.max() - 0.5 * chdtri(len(theta), EXCLUDED)
    least = min(least, np.sort(known)[-min(KEPT, len(known))])
    good = np.flatnonzero(np.isfinite(known) & (known >= least))
    if len(good) in (0, len(known)):
        return density, dict(theta)
    rows = np.arange(len(known))
    bad = np.setdiff1d(rows, good)
    rows[bad] = generator(key).choice(good, len(bad))
    return density[rows], {name: values[rows] for name, values in theta.items()}
