"""The order of samplers: the fastest first, the next one if its draws are not sufficient.

Importance sampling from adapted mixtures takes a few evaluations per effective draw, and gives the
evidence. If a posterior is too far from any such mixture, chains are used: elliptical slices around
the draws so far if an evaluation is costly, and otherwise NUTS with the model's gradient.
"""

import logging
from collections.abc import Callable, Mapping
from functools import cache
from typing import NamedTuple

import jax
import numpy as np
import xarray as xr
from jaxtyping import Array, Key

from jbw.inference.posterior.summary import scalars
from jbw.inference.posterior.verdict import ESS, GOOD_KHAT
from jbw.inference.samplers import amis
from jbw.inference.samplers.chunked_run import Keep, Supervision, Until, no_checkpoint
from jbw.inference.samplers.register import sampler_named
from jbw.inference.samplers.rewhitening import by_moments, sample_until
from jbw.inference.samplers.sampling import SamplingRequest, draw_posterior, seconds_of
from jbw.inference.space.box import Box
from jbw.inference.space.problem import Target, problem_of
from jbw.inference.space.reparametrisation import Reparametrisation
from jbw.report.messages import stages as messages
from jbw.results.attributes import DrawnPosterior

under_way = logging.getLogger("jbw.progress")

# Functions that create coordinates for sampling, by name; all but the first may return None.
Places = Mapping[str, Callable[[], Reparametrisation | None]]

LOOKED_AT = 256  # number of trial points to choose coordinates
# No other coordinates are tried if more than this fraction of the trial points is effective.
PLENTY = 1 / 2
TRIAL = 12  # number of rounds after which sampling ends if too few of the points are effective
ROUNDS = 3  # largest number of repetitions of slice sampling if its chains disagree
# Chains can start from the moments of weighted points if this many per dimension are effective.
WORTH = 20.0


class Sizes(NamedTuple):
    """The numbers of chains, draws and warm-up steps; None stands for the sampler's default.

    Attributes:
        num_chains: Number of chains, and of groups of weighted points.
        num_samples: Number of draws of each.
        num_warmup: Number of discarded steps of each chain.
    """

    num_chains: int
    num_samples: int | None = None
    num_warmup: int | None = None


def climb(
    key: Key[Array, ""],
    target: Target,
    parametrisations: Places,
    sizes: Sizes,
    *,
    costly_parametrisations: Places | None = None,
    until: Until | None = None,
    keep: Keep = no_checkpoint,
    attrs: Mapping[str, Mapping[str, str]] | None = None,
) -> xr.DataTree:
    """Draw from a posterior by the first sampler that is sufficient, in suitable coordinates.

    Args:
        key: Random key.
        target: The posterior.
        parametrisations: Functions that create coordinates to choose from, each around a fit, by
            name; called when tried.
        sizes: Amounts to draw.
        costly_parametrisations: Coordinates that cost evaluations to create, tried only if no
            others suffice.
        until: Condition on enough draws, and the time limit; None for the number in `sizes`.
        keep: Function that returns the checkpoint of a stage by its name.
        attrs: Attributes of the parameters, as in `sample`.

    Returns:
        The tree of `sample`; its attributes name the `coordinates` and give the number of all
            evaluations.
    """
    costly = {name: cache(make) for name, make in (costly_parametrisations or {}).items()}
    chosen, place, looks = choose(key, target, {**parametrisations, **costly})
    stages: Places = {
        chosen: lambda: place, **{n: make for n, make in costly.items() if n != chosen}
    }  # fmt: skip
    tried = by_mixtures(key, target, stages, sizes, until=until, keep=keep, attrs=attrs)
    spent = sum(seconds_of(tree) for tree, _ in tried)
    evaluations = looks + sum(DrawnPosterior.of(tree).num_evaluations for tree, _ in tried)
    budget_s = np.inf if until is None else until.budget_s
    tree, _ = tried[-1]
    if is_good(tree, until):
        tree.attrs |= {"num_evaluations": evaluations}
        return tree
    if spent >= budget_s:
        tree.attrs |= {"num_evaluations": evaluations, "budget_spent_s": spent}
        return tree
    under_way.info(messages.CHAINS)
    best, place = max(tried, key=lambda trial: DrawnPosterior.of(trial[0]).ess_weights or 0.0)
    drawn = by_chains(
        jax.random.fold_in(key, len(parametrisations) + len(stages)), target,
        about_draws(best, target.box, place), sizes,
        until=None if until is None else until._replace(budget_s=budget_s - spent),
        keep=keep, attrs=attrs,
    )  # fmt: skip
    facts = DrawnPosterior.of(drawn)
    drawn.attrs |= {
        "coordinates": DrawnPosterior.of(best).coordinates,
        "num_evaluations": evaluations + facts.num_evaluations,
    }
    if facts.budget_spent_s is not None:
        drawn.attrs |= {"budget_spent_s": facts.budget_spent_s + spent}
    return drawn


def by_mixtures(
    key: Key[Array, ""],
    target: Target,
    stages: Places,
    sizes: Sizes,
    *,
    until: Until | None = None,
    keep: Keep = no_checkpoint,
    attrs: Mapping[str, Mapping[str, str]] | None = None,
) -> list[tuple[xr.DataTree, Reparametrisation]]:
    """Draw by adaptive importance sampling; try one set of coordinates after another."""
    tried: list[tuple[xr.DataTree, Reparametrisation]] = []
    remaining = until
    request = SamplingRequest(
        "amis",
        num_samples=sizes.num_samples or sampler_named("amis").draws[1],
        num_chains=sizes.num_chains,
    )
    for stage, make in stages.items():
        is_last = len(tried) == len(stages) - 1
        # If these coordinates do not exist, continue with the previous ones.
        if (parametrisation := make()) is not None:
            name, place = stage, parametrisation
        options = {} if is_last else {"trial": TRIAL, "least": ESS}
        kept = keep(f"{stage}_amis" if tried else "amis")
        tree = draw_posterior(
            key, target, request._replace(options=options), place,
            supervision=Supervision(kept=kept, until=remaining), attrs=attrs,
        )  # fmt: skip
        tree.attrs |= {"coordinates": name}
        tried.append((tree, place))
        if remaining is not None:
            remaining = remaining._replace(budget_s=remaining.budget_s - seconds_of(tree))
        if is_good(tree, until) or (remaining is not None and remaining.budget_s <= 0):
            break
    return tried


def by_chains(
    key: Key[Array, ""],
    target: Target,
    coordinates: Reparametrisation,
    sizes: Sizes,
    *,
    until: Until | None = None,
    keep: Keep = no_checkpoint,
    attrs: Mapping[str, Mapping[str, str]] | None = None,
) -> xr.DataTree:
    """Draw by Markov chains: slice sampling for costly models, else a gradient-based sampler."""
    sampler = sampler_named("elliptical_slice" if target.is_costly else "nuts")
    num_warmup, num_samples = sampler.draws if target.is_costly else sampler.cheap_draws
    request = SamplingRequest(
        sampler.name,
        num_warmup=num_warmup if sizes.num_warmup is None else sizes.num_warmup,
        num_samples=sizes.num_samples or num_samples,
        num_chains=sizes.num_chains,
        chain_method="parallel" if jax.device_count() > 1 else "sequential",
        options={"adapt_mass": True},
    )
    return sample_until(
        key, target, request, coordinates=coordinates, rounds=ROUNDS if target.is_costly else 0,
        until=until, keep=lambda i: keep(f"{sampler.name}_{i}" if i else sampler.name),
        attrs=attrs,
    )  # fmt: skip


def is_good(tree: xr.DataTree, until: Until | None) -> bool:
    """Return whether importance weights are reliable and give enough draws."""
    facts = DrawnPosterior.of(tree)
    if facts.khat is None or facts.ess_weights is None:
        return False
    if not (facts.khat < GOOD_KHAT and facts.ess_weights >= ESS):
        return False
    return until is None or until.enough(scalars(tree))


def about_draws(tree: xr.DataTree, box: Box, place: Reparametrisation) -> Reparametrisation:
    """Return coordinates from moments of weighted draws; `place` if too few draws are effective."""
    enough = (DrawnPosterior.of(tree).ess_weights or 0.0) >= WORTH * len(box.names)
    return by_moments(scalars(tree), box, place) if enough else place


def choose(
    key: Key[Array, ""],
    target: Target,
    parametrisations: Places,
) -> tuple[str, Reparametrisation, int]:
    """Return the coordinates with the most effective trial points, and the number of these points.

    If many of the points are effective, no other coordinates are tried. Coordinates that cost
    evaluations come last. Near a curved valley, good-looking weights may cover only a part of it.
    """
    worth: dict[str, float] = {}
    built: dict[str, Reparametrisation] = {}
    for i, (name, make) in enumerate(parametrisations.items()):
        if max(worth.values(), default=0.0) > PLENTY * LOOKED_AT:
            break
        under_way.info(messages.points(LOOKED_AT, name))
        if (place := make()) is not None:
            problem = problem_of(target.log_likelihood, target.box, target.data, place)
            built[name] = place
            worth[name] = amis.look(jax.random.fold_in(key, i), problem, LOOKED_AT)
    best = max(worth, key=lambda name: worth[name])
    return best, built[best], LOOKED_AT * len(worth)
