"""Draws of the joint posterior by the sampler that suits what was measured."""

import jax
import xarray as xr
from jaxtyping import Array, Key

from jbw.campaign.settings import Identify
from jbw.identification.step import attrs
from jbw.inference.fit.fitting import Fit
from jbw.inference.posterior.verdict import Verdict
from jbw.inference.samplers.checkpointing import Keep, nowhere
from jbw.inference.samplers.register import sampler_named
from jbw.inference.samplers.rewhitening import sample_again
from jbw.inference.samplers.sampling import sample
from jbw.inference.space.box import Box
from jbw.inference.space.reparametrisation import along_logarithms, never_zero
from jbw.inference.space.ridge import along_ridge
from jbw.observables.dataset import Dataset, log_likelihood

ROUNDS = 3  # times that slices are drawn again, where their chains disagree
STUCK = {"frozen_chain", "r_hat"}  # findings of a sampler that does not fit the posterior


def sample_joint(
    key: Key[Array, ""],
    data: Dataset,
    prior: Box,
    best: Fit,
    settings: Identify,
    keep: Keep = nowhere,
    *,
    name: str = "joint",
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
        name: Name of the step.
    """
    meanings = attrs(data.laws)
    sampler = settings.sampler
    if sampler == "auto":
        sampler = "elliptical_slice" if steps_through_time(data) else "nuts"
    num_warmup, num_samples = settings.draws(sampler_named(sampler).draws)
    options = {
        "sampler": sampler,
        "num_warmup": num_warmup,
        "num_samples": num_samples,
        "num_chains": settings.num_chains,
        "chain_method": "parallel" if jax.device_count() > 1 else "sequential",
        "options": {"adapt_mass": True},
        "attrs": meanings,
    }
    if sampler != "elliptical_slice":
        about = {"start": best.theta, "covariance": best.covariance, "kept": keep(name)}
        return sample(key, log_likelihood, prior, data, **about, **options)
    if best.weak is not None or best.at_bound:
        place = along_ridge(best.theta, best.covariance, prior)
    else:
        logs = never_zero(best.theta, best.covariance, prior)
        place = along_logarithms(best.theta, best.covariance, prior, logs)
    return sample_again(
        key, log_likelihood, prior, data, coordinates=place, rounds=ROUNDS,
        keep=lambda i: keep(f"{name}_{i}" if i else name), **options,
    )  # fmt: skip


def steps_through_time(data: Dataset) -> bool:
    """Whether an evaluation steps through time."""
    return any(part.stepped for part in data.parts)


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
