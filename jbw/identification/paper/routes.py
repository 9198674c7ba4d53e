"""Comparison of the sequential steps of Teloli et al. with the joint posterior."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from jbw.identification.linear_step import NAMES, LinearStep
from jbw.identification.procedure import Posteriors
from jbw.identification.step import Step
from jbw.inference.posterior.summary import posterior_draws
from jbw.report.messages import paper_steps as messages
from jbw.results.run import StoredMoments, StoredRoutes

CUT = {"third_order_nuts": ("zeta", "alpha", "delta"), "opening_nuts": ("gamma",)}
FAR = 10.0  # The size of a difference is not stated if it exceeds this many standard deviations.
PRODUCTS = {"alpha_delta": "delta", "alpha_gamma": "gamma"}
Moments = dict[str, tuple[float, float]]


def compare_routes(linear: LinearStep | None, posteriors: Posteriors) -> dict[str, Any]:
    """Compare all parameters between the steps of Teloli et al. and the joint posterior.

    The result contains the mean and sd by either route; `sd_ratio`, the joint posterior's sd over
    the cut's; `difference`, cut minus joint in sds of the joint; statements and wall times. It is
    empty if the steps of Teloli et al. (the cut) were not performed.

    Reference:
        Section 3, Steps 2-4, against all parameters set to update.
    """
    steps, joint = posteriors.paper.steps, posteriors.joint
    if not CUT.keys() & steps.keys():
        return {}
    cut, both = _cut(linear, steps), _moments(joint.draws, joint.held)
    rows = {name: _row(cut[name], both[name]) for name in cut if name in both}
    wall_of_cut = sum(steps[name].wall_s for name in CUT if name in steps)
    wall_of_joint = joint.wall_s + posteriors.checks.wall_s
    last = messages.wall_time(wall_of_cut, wall_of_joint)
    return {
        "parameters": {name: row.plain() for name, row in rows.items()},
        "statements": [*_statements(rows, steps), last],
        "wall_time_s": {"cut": round(wall_of_cut, 2), "joint": round(wall_of_joint, 2)},
    }


def _cut(linear: LinearStep | None, steps: Mapping[str, Step]) -> Moments:
    """Return mean and sd of each parameter from the sequential step that identifies it."""
    moments: Moments = {}
    if linear is not None:
        mean, variance = linear.pooled.mean, np.diag(linear.pooled.covariance)
        pairs = zip(mean.tolist(), np.sqrt(variance).tolist(), strict=True)
        moments = dict(zip(NAMES, pairs, strict=True))
    for name, names in CUT.items():
        if name not in steps:
            continue
        draws = _moments(posterior_draws(steps[name].posterior), steps[name].held)
        # A step that determines a parameter also determines its product with alpha, which the step
        # fixes or draws.
        names = {*names, *(p for p, factor in PRODUCTS.items() if factor in names)}
        moments |= {parameter: draws[parameter] for parameter in draws if parameter in names}
    return moments


def _moments(posterior: xr.Dataset, held: Mapping[str, float]) -> Moments:
    """Return mean and sd of a posterior's parameters and of their products with alpha."""
    draws = {str(n): np.ravel(v.values) for n, v in posterior.data_vars.items() if v.ndim == 2}
    alpha = draws.get("alpha", held.get("alpha"))
    for product, factor in PRODUCTS.items():
        if factor in draws and alpha is not None:
            draws[product] = alpha * draws[factor]
    return {name: (float(x.mean()), float(x.std(ddof=1))) for name, x in draws.items()}


def _row(cut: tuple[float, float], joint: tuple[float, float]) -> StoredRoutes:
    return StoredRoutes(
        cut=StoredMoments(mean=cut[0], sd=cut[1]), joint=StoredMoments(mean=joint[0], sd=joint[1]),
        sd_ratio=joint[1] / cut[1] if cut[1] > 0 else None,
        difference=(cut[0] - joint[0]) / joint[1] if joint[1] > 0 else None,
    )  # fmt: skip


def _statements(rows: Mapping[str, StoredRoutes], steps: Mapping[str, Step]) -> list[str]:
    """Return the sentences that compare the sequential steps with the joint posterior."""
    sentences = []
    held = steps["opening_nuts"].held if "opening_nuts" in steps else {}
    gamma = rows.get("gamma")
    if gamma is not None and held:
        names = ", ".join(name for name in held if name != "gain")
        times = "unlike" if gamma.sd_ratio is None else f"{gamma.sd_ratio:.2g} times"
        away = abs(gamma.difference or 0.0)
        far = f"{away:.2g}" if away < FAR else f"more than {FAR:g}"
        sentences.append(messages.held_parameters(names, times, far))
    apart = [name for name, row in rows.items() if abs(row.difference or 0.0) > 2.576]
    if apart:
        sentences.append(messages.outside_interval(apart))
    return sentences
