r"""Leave one run out: does every level tell of the same joint?

Where the law of the joint is wrong, or runs shift, each level asks for parameters of its own, and
the fit of all is a compromise with a narrow interval. So the fit is repeated without each run, and
its change compared with what chance allows,

$$z = \frac{\hat\theta_{-r} - \hat\theta}{\sqrt{\sigma_{-r}^2 - \sigma^2}}, \qquad
  |\hat\theta_{-r} - \hat\theta| \le \sigma_{-r} \sqrt{\chi^2_{-r}(\hat\theta) -
  \chi^2_{-r}(\hat\theta_{-r})}$$

A change counts for no more than what the other runs gain by it: along a bent direction that none of
them determines, a fit moves far for nothing.
"""

import logging
from collections.abc import Mapping, Sequence
from functools import reduce

import numpy as np
import xarray as xr

from jbw.identification.accuracy import another_law
from jbw.identification.prepare import refit
from jbw.identification.run_effects import own_frequency_alone
from jbw.inference.fit.costly_fit import residual_at
from jbw.inference.fit.fitting import Fit
from jbw.inference.posterior.finding import Finding, checked
from jbw.inference.space.box import Box
from jbw.observables.dataset import (
    Dataset,
    left_by_label,
    silenced,
    size_by_label,
    stacked,
    without,
)
from jbw.report.messages import residuals as messages
from jbw.report.messages import stages

under_way = logging.getLogger("jbw.progress")
FitsWithout = Mapping[tuple[str, ...], Fit]  # by the runs that are left out
MOVES = 4.0  # standard deviations of the change: beyond, the runs contradict each other
# Times its standard deviation by all tests: a parameter that rests on what is left out.
WIDER = 5.0
LEAST_GAIN = 0.01  # of the variance: what a run must add for its absence to be judged


def fits_without_each_run(best: Fit, prior: Box, data: Dataset) -> FitsWithout:
    """Fit again without each run of records, harmonics or loops in turn; nothing of fewer than two.

    Free decays are left out where there is nothing else, the strongest third of them together, the
    weakest, and those between: a record beside one like it says nothing of other amplitudes.
    """
    decays_alone = all(part.own_shifts for part in data.parts)
    parts = [part for part in data.parts if part.sizes() and (decays_alone or not part.own_shifts)]
    runs = tuple(dict.fromkeys(run for part in parts for run in part.runs))
    groups = _thirds(data) if decays_alone else [(run,) for run in runs]
    if len(groups) < 2:
        return {}
    excluded = silenced if decays_alone else without
    fits: dict[tuple[str, ...], Fit] = {}
    for place, group in enumerate(groups, start=1):
        under_way.info(stages.WITHOUT_RUN, place, len(groups))
        rest = reduce(lambda remaining, run: excluded(run, remaining), group, data)
        fits[group] = refit(best, prior, rest)
    return fits


def _thirds(data: Dataset) -> list[tuple[str, ...]]:
    """Names of the records of free decays, from the weakest third to the strongest."""
    sizes = {run: y for part in data.parts for run, y in part.begins_at(1.0).items()}
    order = sorted(sizes, key=lambda run: sizes[run])
    parts = np.array_split(np.arange(len(order)), min(len(order), 3))
    return [tuple(order[i] for i in part) for part in parts]


def leave_one_out(
    best: Fit, prior: Box, data: Dataset, without_each: FitsWithout
) -> xr.Dataset | None:
    """What the fits without each run, those of `fits_without_each_run`, say of the runs.

    `z` is NaN where a run adds nothing, `error` is that of a run as the fit without it predicts it.
    Two runs must be left, so that no fit is of one level alone: None with fewer than two such runs,
    three runs in all, or of free decays alone.
    """
    decays_alone = all(part.own_shifts for part in data.parts)
    if decays_alone or len(without_each) < 2 or len(set(data.runs)) < 3:
        return None
    runs, fits = [run for (run,) in without_each], list(without_each.values())
    others = [without(run, data) for run in runs]
    pairs = zip(fits, others, strict=True)
    growth = np.array([_gained(best, fit, prior, rest) for fit, rest in pairs])
    estimate = np.array([list(fit.theta.values()) for fit in fits])
    std = np.array([np.sqrt(np.diag(fit.covariance)) for fit in fits])
    variance = np.diag(best.covariance)
    gained = std**2 - variance
    is_gained = gained > LEAST_GAIN * variance
    change = estimate - np.array(list(best.theta.values()))
    most = np.sqrt(growth)[:, None] * std
    z = np.clip(change, -most, most) / np.sqrt(np.where(is_gained, gained, np.nan))
    error = [_error(run, fit, prior, data) for run, fit in zip(runs, fits, strict=True)]
    fitted = [_error(run, best, prior, data) for run in runs]
    dims = ("run", "parameter")
    return xr.Dataset(
        {
            "estimate": (dims, estimate, {"long_name": "optimum without the run"}),
            "std": (dims, std, {"long_name": "its standard deviation"}),
            "error": (
                "run",
                error,
                {
                    "units": "1",
                    "long_name": "error without the run",
                    "own_frequency": int(data.has_offsets),
                },
            ),
            "fitted": ("run", fitted, {"units": "1", "long_name": "error with it"}),
            "z": (dims, z, {"units": "1", "long_name": messages.Z_SCORE}),
            "wider": (
                dims,
                std / np.sqrt(variance),
                {"units": "1", "long_name": messages.WIDER_WITHOUT},
            ),
        },
        {"run": list(runs), "parameter": list(best.theta)},
    )


def _gained(best: Fit, without_it: Fit, prior: Box, rest: Dataset) -> float:
    """Chi-square that the other runs gain by their own fit."""
    before = float(np.sum(residual_at(stacked, best.x, prior, rest) ** 2))
    return max(before - 2 * without_it.cost, 0.0)


def _error(run: str, without_it: Fit, prior: Box, data: Dataset) -> float:
    """Error of a run at a fit that does not know it; its natural frequency is its own.

    Its damping ratio is not, which the law has to tell.
    """
    scored = own_frequency_alone(data)
    residuals = left_by_label(residual_at(stacked, without_it.x, prior, scored), scored)
    sizes = size_by_label(data)
    labels = [label for label, name in zip(data.labels, data.runs, strict=True) if name == run]
    sized = [label for label in labels if label in sizes]  # a line fit of the run has no size
    missed = np.linalg.norm(np.concatenate([residuals[label] for label in sized]))
    return float(missed / np.linalg.norm([sizes[label] for label in sized]))


def left_out_sentence(left_out: xr.Dataset) -> str:
    """How well each run is predicted by the others, in words."""
    errors = [f"{error.run.item()} {100 * error.item():.2g} %" for error in left_out["error"]]
    proviso = messages.WITH_FREQUENCY * left_out["error"].attrs.get("own_frequency", 0)
    return messages.each_session(proviso, errors, identified_alone(left_out["wider"]))


def identified_alone(wider: xr.DataArray) -> dict[str, list[str]]:
    """Parameters that only the tests left out identify, by what was left out.

    `wider` holds their standard deviations without it over those with it.
    """
    left_out, parameters = (wider[str(dim)].values.tolist() for dim in wider.dims)
    return {
        name: [parameter for parameter, x in zip(parameters, row, strict=True) if not x < WIDER]
        for name, row in zip(left_out, wider.values, strict=True)
    }


def consistency_finding(left_out: xr.Dataset, laws: Sequence[str] = ()) -> Finding:
    """Whether the runs tell of one joint; its number is the largest |z|."""
    size = abs(left_out["z"])
    if size.isnull().all():
        return Finding("leave_one_out", "ok", {}, float("nan"), entry="leave_one_out.none")
    worst = size[size.argmax(...)]
    values = {
        "test": worst.run.item(), "name": worst.parameter.item(), "moves": worst.item(),
        "limit": MOVES,
    }  # fmt: skip
    remedy = {"another_law": another_law(laws)}
    return checked("leave_one_out", worst.item() < MOVES, values, worst.item(), remedy)
