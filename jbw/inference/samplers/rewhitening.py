"""Repeated sampling around the draws so far, if chains that start at a fit disagree.

A fit describes the posterior near its optimum. If the posterior is far from normal, slices with the
fit's covariance move slowly, but their draws show better where the posterior lies.
"""

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float, Key

from jbw.inference.posterior.summary import diagnose, scalars
from jbw.inference.posterior.verdict import GOOD_KHAT
from jbw.inference.samplers.chunked_run import Kept, Supervision, Until
from jbw.inference.samplers.sampling import SamplingRequest, draw_posterior, seconds_of
from jbw.inference.space.box import Box
from jbw.inference.space.problem import Target
from jbw.inference.space.reparametrisation import Reparametrisation
from jbw.results.attributes import DrawnPosterior

AGREED = 1.05  # Sampling is repeated if the largest R-hat of all parameters exceeds this.
# factor by which the draws' covariance is widened, since they may not cover the posterior yet
WIDER = 1.3
# smallest distance of the coordinates' centre from the bounds, relative to the prior's width
INSIDE = 1e-9


def sample_until(
    key: Key[Array, ""],
    target: Target,
    request: SamplingRequest,
    *,
    coordinates: Reparametrisation,
    rounds: int,
    until: Until | None = None,
    keep: Callable[[int], Kept | None] = lambda round_: None,
    attrs: Mapping[str, Mapping[str, str]] | None = None,
) -> xr.DataTree:
    """Sample until there are enough draws; if chains disagree, restart from their moments.

    Chains continue with the number of draws doubled each time. A sampler that draws everything at
    once draws again, twice as many, unless k-hat shows that more draws would be no better.

    `rounds` is the largest number of rounds around the draws' own moments. `until` states when
    draws are enough, and limits the time beyond the first draws; None for the requested number.
    `keep` returns the checkpoint of a round by its number; `attrs` is as in `sample`. The draws are
    those of the last round alone. Attributes give the number of all evaluations, the rounds after
    the first as `rewhitened`, and `budget_spent_s` if the time ran out before enough draws.
    """
    evaluations, spent, round_ = 0, 0.0, 0
    budget_s = np.inf if until is None else until.budget_s
    while True:
        last = round_ >= rounds

        def stop(draws: dict[str, Any], last: bool = last) -> bool:
            return until is None or until.enough(draws) or not (last or agree(draws))

        tree = draw_posterior(
            key if round_ == 0 else jax.random.fold_in(key, round_),
            target, request, coordinates, attrs=attrs,
            supervision=Supervision(kept=keep(round_), until=Until(stop, budget_s - spent)),
        )  # fmt: skip
        facts = DrawnPosterior.of(tree)
        evaluations += facts.num_evaluations
        spent += seconds_of(tree)
        tree.attrs |= {"num_evaluations": evaluations, "rewhitened": round_}
        draws = scalars(tree)
        done = agree(draws) if until is None else until.enough(draws)
        if done or spent >= budget_s:
            break
        if not (last or agree(draws)):
            coordinates = by_moments(draws, target.box, coordinates)
        # A sampler that works in rounds has already taken more draws until there were enough.
        elif until is None or "rounds" in tree.attrs:
            break
        elif facts.khat is not None and facts.khat >= GOOD_KHAT:
            break
        else:
            request = request._replace(num_samples=2 * facts.num_samples)
        round_ += 1
    if not done and spent >= budget_s:
        tree.attrs |= {"budget_spent_s": spent}
    return tree


def agree(draws: Mapping[str, Float[np.ndarray, "chain draw"]]) -> bool:
    """Return whether chains agree well enough to continue; a single chain always does."""
    if len(next(iter(draws.values()))) < 2:
        return True
    return all(diagnose(values)["r_hat"] < AGREED for values in draws.values())


def by_moments(
    draws: Mapping[str, Float[np.ndarray, "chain draw"]], box: Box, place: Reparametrisation
) -> Reparametrisation:
    """Return coordinates from the mean and widened covariance of the chains' second halves."""
    half = next(iter(draws.values())).shape[1] // 2
    theta = np.stack([draws[name][:, half:].ravel() for name in box.names], axis=-1)
    u = np.asarray(jax.vmap(place.outer.inverse)(jnp.asarray(theta)))
    lower, upper = np.asarray(place.lower), np.asarray(place.upper)
    margin = INSIDE * (upper - lower)
    mean = np.clip(u.mean(axis=0), lower + margin, upper - margin)
    covariance = WIDER * np.atleast_2d(np.cov(u, rowvar=False))
    return place._replace(start=mean, covariance=covariance)
