"""Drawing again about the moments of the draws, where those about a fit did not agree.

A fit knows the posterior about its optimum. Where that is no normal distribution, slices about the
fit's covariance crawl; the draws that they leave know better where the posterior lies.
"""

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float, Key

from jbw.inference.posterior.summary import diagnose, scalars
from jbw.inference.samplers.chunked_run import Kept
from jbw.inference.samplers.sampling import sample
from jbw.inference.space.box import Box
from jbw.inference.space.problem import LogLikelihood
from jbw.inference.space.reparametrisation import Reparametrisation

AGREED = 1.05  # R-hat of the worst parameter, above which the draws say where to draw again
WIDER = 1.3  # times the covariance of draws that have not seen all
INSIDE = 1e-9  # of the box's width, from its bounds


def sample_again(
    key: Key[Array, ""],
    log_likelihood: LogLikelihood,
    box: Box,
    data: Any,
    *,
    coordinates: Reparametrisation,
    rounds: int,
    keep: Callable[[int], Kept | None] = lambda round_: None,
    **options: Any,
) -> xr.DataTree:
    """Sample, and where chains disagree, sample again about the draws' own mean and covariance.

    Args:
        key: Random key.
        log_likelihood: As of `sample`.
        box: Prior bounds.
        data: What the log likelihood takes.
        coordinates: What to sample in, with the optimum of a fit and its Laplace covariance.
        rounds: Times to sample again at most.
        keep: Number of the round to where its chains outlive the process.
        options: Further ones of `sample`.

    Returns:
        The draws of the last round alone; its attributes count the evaluations of all, and
        `rewhitened` the rounds after the first.
    """
    spent = 0
    for round_ in range(rounds + 1):
        tree = sample(
            key if round_ == 0 else jax.random.fold_in(key, round_), log_likelihood, box, data,
            coordinates=coordinates, kept=keep(round_), **options,
        )  # fmt: skip
        spent += tree.attrs["num_evaluations"]
        draws = scalars(tree)
        tree.attrs |= {"num_evaluations": spent, "rewhitened": round_}
        if round_ == rounds or agree(draws):
            break
        coordinates = by_moments(draws, box, coordinates)
    return tree


def agree(draws: Mapping[str, Float[np.ndarray, "chain draw"]]) -> bool:
    """Whether chains agree well enough to go on with their draws; one chain always does."""
    if len(next(iter(draws.values()))) < 2:
        return True
    return all(diagnose(values)["r_hat"] < AGREED for values in draws.values())


def by_moments(
    draws: Mapping[str, Float[np.ndarray, "chain draw"]], box: Box, place: Reparametrisation
) -> Reparametrisation:
    """Coordinates about the mean and the widened covariance of the second half of all chains."""
    half = next(iter(draws.values())).shape[1] // 2
    theta = np.stack([draws[name][:, half:].ravel() for name in box.names], axis=-1)
    u = np.asarray(jax.vmap(place.outer.inverse)(jnp.asarray(theta)))
    lower, upper = np.asarray(place.lower), np.asarray(place.upper)
    margin = INSIDE * (upper - lower)
    mean = np.clip(u.mean(axis=0), lower + margin, upper - margin)
    covariance = WIDER * np.atleast_2d(np.cov(u, rowvar=False))
    return place._replace(start=mean, covariance=covariance)
