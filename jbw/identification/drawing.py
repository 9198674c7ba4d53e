"""Draws of the joint posterior by the sampler that suits what was measured."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import jax
import xarray as xr
from jaxtyping import Array, Key

from jbw.identification.step import ATTRS
from jbw.inference.box import Box
from jbw.inference.fitting import Fit
from jbw.inference.keeping import Keep, nowhere
from jbw.inference.logarithms import (
    Inside,
    back_from_logs,
    far_beyond,
    in_logarithms,
    log_box,
    log_start,
    of_logs,
)
from jbw.inference.rewhitening import sample_again
from jbw.inference.ridge import sample_along
from jbw.inference.sampling import sample
from jbw.inference.verdict import Verdict
from jbw.observables.evidence import Evidence, log_likelihood
from jbw.observables.loops import Loops
from jbw.observables.response import Records

ROUNDS = 3  # times that slices are drawn again, where their chains disagree
STUCK = {"frozen_chain", "r_hat"}  # findings of a sampler that does not fit the posterior
DRAWS = {  # of warm-up, and kept of each chain
    "elliptical_slice": (25, 400),
    "importance": (0, 1000),
    "nested": (0, 500),
    "nuts": (300, 1000),
    "quadrature": (0, 1000),
    "random_walk": (1000, 1000),
    "random_walk_paper": (85, 765),
    "tempered_smc": (0, 500),
}


def sample_joint(
    key: Key[Array, ""],
    data: Evidence,
    prior: Box,
    best: Fit,
    settings: Mapping[str, Any],
    keep: Keep = nowhere,
) -> xr.DataTree:
    """Draws in the coordinate whitened by the fit's covariance.

    Where time is stepped through, by elliptical slices about the Laplace approximation, at a few
    evaluations a draw: along the ridge of the fit, from wall to wall of the box, where it leaves a
    direction open or runs into a wall; otherwise along the logarithms of what cannot be zero. Where
    evaluations are cheap, by NUTS along the model's own gradient. Slices whose chains disagree are
    drawn again about their own moments, up to three times.

    Args:
        key: Random key.
        data: What was measured.
        prior: The box.
        best: The fit, with its covariance.
        settings: The campaign's [identify] table.
        keep: Where the chains outlive the process.
    """
    sampler = settings.get("sampler", "auto")
    if sampler == "auto":
        sampler = "elliptical_slice" if steps_through_time(data) else "nuts"
    num_warmup, num_samples = DRAWS[sampler]
    options = {
        "sampler": sampler,
        "num_warmup": settings.get("num_warmup", num_warmup),
        "num_samples": settings.get("num_samples", num_samples),
        "num_chains": settings.get("num_chains", 4),
        "chain_method": "parallel" if jax.device_count() > 1 else "sequential",
        "adapt_mass": True,
        "attrs": ATTRS,
    }
    if sampler != "elliptical_slice":
        about = {"start": best.theta, "covariance": best.covariance, "kept": keep("joint")}
        return sample(key, log_likelihood, prior, data, **about, **options)
    again = partial(
        sample_again, rounds=ROUNDS, keep=lambda i: keep(f"joint_{i}" if i else "joint")
    )
    logs = in_logarithms(best, prior)
    if best.weak is not None or best.at_bound:
        return sample_along(key, log_likelihood, prior, data, best, draw=again, **options)
    start, covariance = log_start(best, prior, logs)
    inner = log_box(prior, logs, best.theta)
    drawn = again(
        key, of_logs(log_likelihood), far_beyond(inner), data,
        start=start, covariance=covariance, log_prior=Inside(inner), **options,
    )  # fmt: skip
    return back_from_logs(drawn, prior, ATTRS)


def steps_through_time(data: Evidence) -> bool:
    """Whether an evaluation steps through time."""
    return any(isinstance(part, Records | Loops) for part in data.parts)


def stuck(posterior: xr.DataTree, found: Verdict) -> list[str]:
    """What to do where elliptical slices do not mix, in words; nothing where they do.

    Args:
        posterior: The draws.
        found: The verdict on them.
    """
    failed = {one.code for one in found.findings if one.status != "ok"}
    if posterior.attrs.get("sampler") != "elliptical_slice" or not failed & STUCK:
        return []
    return [
        "The posterior is too far from the Gaussian about the fit for elliptical slices: "
        'sampler = "nuts" in [identify] follows the gradient of the model, for some hundred times '
        "as many evaluations a draw."
    ]
