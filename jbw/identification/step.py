"""The common form of the posteriors of all steps: draws, verdict, fit and sentences."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import xarray as xr

from jbw.campaign.settings import MOST_MODES
from jbw.inference.fit.fitting import Fit
from jbw.inference.posterior.finding import Finding, Verdict, judge
from jbw.inference.posterior.summary import posterior_draws
from jbw.inference.space.box import Box
from jbw.oscillator.laws import quantities_of, vocabulary
from jbw.oscillator.modes.parameters import own_quantities
from jbw.quantities import (
    LINEAR,
    MODAL,
    RESIDUAL_TERMS,
    attrs_of,
    joints_of,
    motion_factor,
)
from jbw.report.messages import posterior as messages


def attrs(laws: tuple[str, ...] = ()) -> dict[str, dict[str, str]]:
    """Return the units, symbol and meaning of every variable of a posterior, by name."""
    factors = (motion_factor(i, j) for j in joints_of(laws) for i in range(1, MOST_MODES + 1))
    return attrs_of(
        [
            *LINEAR,
            *RESIDUAL_TERMS,
            *MODAL,
            *vocabulary().values(),
            *quantities_of(laws),
            *own_quantities(laws),
            *factors,
        ]
    )


@dataclass(frozen=True)
class Step:
    """One posterior of the procedure, with its verdict."""

    name: str  # name in the results, such as "third_order_nuts"
    posterior: xr.DataTree  # the groups of the sampler's result
    verdict: Verdict  # result of the checks: whether the posterior can be trusted
    fit: Fit  # the least-squares fit from which the sampler started
    box: Box  # prior bounds of the parameters
    statements: tuple[str, ...]  # sentences on what the posterior determines
    held: dict[str, float]  # parameters that were fixed
    wall_s: float  # time taken, including compilation


def means_of(tree: xr.DataTree) -> dict[str, float]:
    """Return the posterior means of all variables by name."""
    group = posterior_draws(tree)
    return {str(name): float(draws.mean()) for name, draws in group.data_vars.items()}


def finished(
    name: str,
    posterior: xr.DataTree,
    box: Box,
    fit: Fit,
    started: float,
    *,
    findings: Iterable[Finding],
    statements: Iterable[str] = (),
    held: Mapping[str, Any] | None = None,
) -> Step:
    """Return a posterior with its judged findings, fit and prior, in the form of a result.

    `started` is the value of `perf_counter()` at the start of the step.
    """
    return Step(
        name,
        posterior,
        judge(findings),
        fit,
        box,
        (*statements, *fit_sentences(fit)),
        {name: float(value) for name, value in (held or {}).items()},
        perf_counter() - started,
    )


def fit_sentences(fit: Fit) -> list[str]:
    """Return sentences on a fit's undetermined direction, and its parameters at bounds."""
    open_direction = [] if fit.weak is None else [messages.by_initial_fit(fit.weak.text)]
    bounds = [messages.at_bound(parameter, side) for parameter, side in fit.at_bound.items()]
    return [*open_direction, *bounds]
