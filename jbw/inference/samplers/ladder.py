"""The sampling strategy: the cheapest sampler first, the next where its draws do not suffice.

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
from jbw.report.messages import stages

under_way = logging.getLogger("jbw.progress")

# Functions that make coordinates, by name; all but the first may give None.
Places = Mapping[str, Callable[[], Reparametrisation | None]]

LOOKED_AT = 256  # points by which coordinates are chosen
PLENTY = 1 / 2  # share of these, effective, above which no other coordinates are tried
TRIAL = 12  # rounds after which weights of too few effective draws are given up
ROUNDS = 3  # times that slices are sampled again, where their chains disagree
WORTH = 20.0  # effective points a dimension above which chains start about their moments


def climb(
    key: Key[Array, ""],
    log_likelihood: LogLikelihood,
    box: Box,
    data: Any,
    *,
    parametrisations: Places,
    costly_parametrisations: Places | None = None,
    is_costly: bool,
    num_chains: int,
    num_samples: int | None,
    num_warmup: int | None = None,
    enough: Enough | None,
    budget_s: float,
    keep: Callable[[str], Kept | None],
    attrs: Mapping[str, Mapping[str, str]] | None = None,
) -> xr.DataTree:
    """Draw from a posterior by the first sampler that suffices, in the most effective coordinates.

    Args:
        key: Random key.
        log_likelihood: As `sample` takes it, with `box` and `data`.
        box: Prior bounds.
        data: What the likelihood takes.
        parametrisations: Coordinates to choose from, each about a fit, by name; made when tried.
        costly_parametrisations: Those that cost evaluations to make, tried where no other
            suffices.
        is_costly: Whether an evaluation steps through time.
        num_chains: Chains, and groups of weighed points.
        num_samples: Draws kept of each; the sampler's own when None.
        num_warmup: Steps of each chain that are discarded; the sampler's own when None.
        enough: Whether draws by name, (chain, draw), are enough; None for `num_samples` of them.
        budget_s: Time to draw until they are [s].
        keep: Checkpoint of a stage by its name; None for none.
        attrs: As `sample` takes them.

    Returns:
        The tree of `sample`; its attributes name the `coordinates`, and count all evaluations.
    """
    costly = {name: cache(make) for name, make in (costly_parametrisations or {}).items()}
    name, place, evaluations = choose(
        key, log_likelihood, box, data, {**parametrisations, **costly}
    )
    budget, spent = np.inf if enough is None else budget_s, 0.0
    shared = {"num_chains": num_chains, "attrs": attrs}
    rungs: Places = {name: lambda: place, **{n: make for n, make in costly.items() if n != name}}
    tried: list[tuple[xr.DataTree, Reparametrisation]] = []
    for other, make in rungs.items():
        is_last = len(tried) == len(rungs) - 1
        # Where there are no such coordinates, those of the stage before are used again.
        if (parametrisation := make()) is not None:
            name, place = other, parametrisation
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
    under_way.info(stages.CHAINS)
    best, place = max(tried, key=lambda trial: trial[0].attrs["ess_weights"])
    coordinates = about_draws(best, box, place)
    sampler = sampler_named("elliptical_slice" if is_costly else "nuts")
    steps = sampler.draws if is_costly else sampler.cheap_draws
    drawn = sample_until(
        jax.random.fold_in(key, len(parametrisations) + len(rungs)), log_likelihood, box, data,
        coordinates=coordinates, sampler=sampler.name, rounds=ROUNDS if is_costly else 0,
        num_warmup=steps[0] if num_warmup is None else num_warmup,
        num_samples=num_samples or steps[1], enough=enough,
        budget_s=budget - spent, keep=lambda i: keep(f"{sampler.name}_{i}" if i else sampler.name),
        chain_method="parallel" if jax.device_count() > 1 else "sequential",
        options={"adapt_mass": True}, **shared,
    )  # fmt: skip
    evaluations += drawn.attrs["num_evaluations"]
    drawn.attrs |= {"coordinates": best.attrs["coordinates"], "num_evaluations": evaluations}
    if "budget_spent_s" in drawn.attrs:
        drawn.attrs["budget_spent_s"] += spent
    return drawn


def is_good(tree: xr.DataTree, enough: Enough | None) -> bool:
    """Whether weights can be trusted, and their draws are enough."""
    if not (tree.attrs["khat"] < GOOD_KHAT and tree.attrs["ess_weights"] >= ESS):
        return False
    return enough is None or enough(scalars(tree))


def about_draws(tree: xr.DataTree, box: Box, place: Reparametrisation) -> Reparametrisation:
    """Coordinates about the moments of weighted draws; unchanged where few are effective."""
    enough = tree.attrs["ess_weights"] >= WORTH * len(box.names)
    return by_moments(scalars(tree), box, place) if enough else place


def choose(
    key: Key[Array, ""],
    log_likelihood: LogLikelihood,
    box: Box,
    data: Any,
    parametrisations: Places,
) -> tuple[str, Reparametrisation, int]:
    """The coordinates with the most effective points about the fit, and how many points were drawn.

    Where a plenty of the points count, no others are looked at. Those that cost evaluations to make
    stand last: about a bent valley weights may look good that know only a part of it.
    """
    worth: dict[str, float] = {}
    built: dict[str, Reparametrisation] = {}
    for i, (name, make) in enumerate(parametrisations.items()):
        if max(worth.values(), default=0.0) > PLENTY * LOOKED_AT:
            break
        under_way.info(stages.points(LOOKED_AT, name))
        if (place := make()) is not None:
            problem = problem_of(log_likelihood, box, data, place)
            built[name] = place
            worth[name] = amis.look(jax.random.fold_in(key, i), problem, LOOKED_AT)
    best = max(worth, key=lambda name: worth[name])
    return best, built[best], LOOKED_AT * len(worth)
