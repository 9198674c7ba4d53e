"""A ladder of samplers: the cheapest first, each judged by itself, the next where it does not do.

Importance sampling from adapted mixtures takes a few evaluations an effective draw, and gives the
evidence. A posterior that is too far from any such mixture is left to chains: slices about the
draws so far where an evaluation is costly, and otherwise NUTS along the model's own gradient.
"""

import logging
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import jax
import numpy as np
import xarray as xr
from jaxtyping import Array, Key

from jbw.inference.posterior.summary import scalars
from jbw.inference.posterior.verdict import ESS, GOOD_KHAT
from jbw.inference.samplers import amis
from jbw.inference.samplers.chunked_run import Kept, Until
from jbw.inference.samplers.register import sampler_named
from jbw.inference.samplers.rewhitening import Enough, by_moments, sample_until
from jbw.inference.samplers.sampling import sample
from jbw.inference.space.box import Box
from jbw.inference.space.problem import LogLikelihood, problem_of
from jbw.inference.space.reparametrisation import Reparametrisation

under_way = logging.getLogger("jbw.progress")

# Makers of coordinates by name, which give None where there are none; the first always has some.
Places = Mapping[str, Callable[[], Reparametrisation | None]]

LOOKED_AT = 256  # points that coordinates are chosen by
PLENTY = 1 / 2  # of these, from which no other coordinates are looked at
TRIAL = 12  # rounds after which weights worth less than the draws asked for are given up
ROUNDS = 3  # times that slices are drawn again, where their chains disagree
WORTH = 20.0  # effective points a dimension, from which their moments are worth going on from


def climb(
    key: Key[Array, ""],
    log_likelihood: LogLikelihood,
    box: Box,
    data: Any,
    *,
    places: Places,
    further: Places | None = None,
    is_costly: bool,
    num_chains: int,
    num_samples: int | None,
    num_warmup: int | None = None,
    enough: Enough | None,
    budget_s: float,
    keep: Callable[[str], Kept | None],
    attrs: Mapping[str, Mapping[str, str]] | None = None,
) -> xr.DataTree:
    """Draw from a posterior by the first rung that can, in the coordinates that suit it best.

    Args:
        key: Random key.
        log_likelihood: As `sample` takes it, with `box` and `data`.
        box: Prior bounds.
        data: What the likelihood takes.
        places: Coordinates to choose from, each about a fit, by name; made when looked at.
        further: Those that cost evaluations to make, looked at or tried where the others do not do.
        is_costly: Whether an evaluation steps through time.
        num_chains: Chains, and groups of weighed points.
        num_samples: Draws kept of each; the sampler's own when None.
        num_warmup: Steps of each chain that are discarded; the sampler's own when None.
        enough: Whether draws by name, (chain, draw), are; None for as many as told.
        budget_s: Time to draw until they are [s].
        keep: By the name of a rung, where its draws outlive the process.
        attrs: As `sample` takes them.

    Returns:
        The tree of `sample`; its attributes name the `coordinates`, and count all evaluations.
    """
    further = {name: cache(make) for name, make in (further or {}).items()}
    name, place, evaluations = choose(key, log_likelihood, box, data, {**places, **further})
    budget, spent = np.inf if enough is None else budget_s, 0.0
    shared = {"num_chains": num_chains, "attrs": attrs}
    rungs: Places = {name: lambda: place, **{n: make for n, make in further.items() if n != name}}
    tried: list[tuple[xr.DataTree, Reparametrisation]] = []
    for other, make in rungs.items():
        is_last = len(tried) == len(rungs) - 1
        # Where there are no others, those that were given up are gone on with.
        if (made := make()) is not None:
            name, place = other, made
        tree = sample(
            key, log_likelihood, box, data, sampler="amis",
            coordinates=place, num_samples=num_samples or sampler_named("amis").draws[1],
            kept=keep(f"{other}_amis" if tried else "amis"),
            until=None if enough is None else Until(enough, budget - spent),
            options={} if is_last else {"trial": TRIAL, "least": ESS}, **shared,
        )  # fmt: skip
        spent += tree["timing"].attrs["wall_s"]
        evaluations += tree.attrs["num_evaluations"]
        tree.attrs |= {"coordinates": name, "num_evaluations": evaluations}
        tried.append((tree, place))
        if is_good(tree, enough):
            return tree
        if spent >= budget:
            tree.attrs["budget_spent_s"] = spent
            return tree
    under_way.info("chains about the draws so far")
    best, place = max(tried, key=lambda each: each[0].attrs["ess_weights"])
    about = about_draws(best, box, place)
    sampler = sampler_named("elliptical_slice" if is_costly else "nuts")
    own = sampler.draws if is_costly else sampler.cheap_draws
    found = sample_until(
        jax.random.fold_in(key, len(places) + len(rungs)), log_likelihood, box, data,
        coordinates=about, sampler=sampler.name, rounds=ROUNDS if is_costly else 0, enough=enough,
        num_warmup=own[0] if num_warmup is None else num_warmup, num_samples=num_samples or own[1],
        budget_s=budget - spent, keep=lambda i: keep(f"{sampler.name}_{i}" if i else sampler.name),
        chain_method="parallel" if jax.device_count() > 1 else "sequential",
        options={"adapt_mass": True}, **shared,
    )  # fmt: skip
    evaluations += found.attrs["num_evaluations"]
    found.attrs |= {"coordinates": best.attrs["coordinates"], "num_evaluations": evaluations}
    if "budget_spent_s" in found.attrs:
        found.attrs["budget_spent_s"] += spent
    return found


def is_good(tree: xr.DataTree, enough: Enough | None) -> bool:
    """Whether weights can be trusted, and their draws are enough."""
    if not (tree.attrs["khat"] < GOOD_KHAT and tree.attrs["ess_weights"] >= ESS):
        return False
    return enough is None or enough(scalars(tree))


def about_draws(tree: xr.DataTree, box: Box, place: Reparametrisation) -> Reparametrisation:
    """Coordinates about the moments of weighed draws; as they were where these are worth little."""
    enough = tree.attrs["ess_weights"] >= WORTH * len(box.names)
    return by_moments(scalars(tree), box, place) if enough else place


def choose(
    key: Key[Array, ""],
    log_likelihood: LogLikelihood,
    box: Box,
    data: Any,
    places: Places,
) -> tuple[str, Reparametrisation, int]:
    """The coordinates in which points about the fit are worth most, and how many were looked at.

    Where a plenty of the points count, no others are looked at. Those that cost evaluations to make
    stand last: about a bent valley weights may look good that know only a part of it.
    """
    worth: dict[str, float] = {}
    made: dict[str, Reparametrisation] = {}
    for i, (name, make) in enumerate(places.items()):
        if max(worth.values(), default=0.0) > PLENTY * LOOKED_AT:
            break
        under_way.info("%d points in the coordinates %s", LOOKED_AT, name)
        if (place := make()) is not None:
            problem = problem_of(log_likelihood, box, data, place)
            made[name] = place
            worth[name] = amis.look(jax.random.fold_in(key, i), problem, LOOKED_AT)
    best = max(worth, key=lambda name: worth[name])
    return best, made[best], LOOKED_AT * len(worth)
