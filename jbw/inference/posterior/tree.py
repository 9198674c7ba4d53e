"""The posterior's one container: draws, statistics and likelihoods as an ArviZ DataTree."""

from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from jbw.inference.space.box import Box

VERSIONED = ("jax", "jaxlib", "numpyro", "numpy")


def looked_at(stats: Mapping[str, Any], num_warmup: int) -> int:
    """Evaluations of the log likelihood by all chains, as many a draw in the warm-up as after."""
    like = next(iter(stats.values()))
    each = np.mean(stats["n_steps"]) if "n_steps" in stats else 1.0
    return round(float(each) * like.shape[0] * (num_warmup + like.shape[1]))


def posterior_tree(
    theta: Mapping[str, Any],
    stats: Mapping[str, Any],
    terms: NDArray[np.float64],
    log_prior: NDArray[np.float64],
    box: Box,
    *,
    attrs: Mapping[str, Mapping[str, str]],
    facts: Mapping[str, Any],
    wall_time: float,
    groups: Mapping[str, Mapping[str, Any]] | None = None,
) -> xr.DataTree:
    """Gather what a run left.

    Args:
        theta: Draws by name, each (chain, draw), in the parameters' units.
        stats: The sampler's statistics by name, each (chain, draw).
        terms: Independent terms of the log likelihood [nats], (chain, draw, term).
        log_prior: Log prior density of theta [nats], (chain, draw), box included.
        box: Prior bounds, written beside each parameter.
        attrs: `units` and `long_name` by parameter.
        facts: What made the draws: sampler, seed, settings.
        wall_time: Duration of the run [s]; kept apart, for it differs between equal runs.
        groups: Further groups: name to variable to (dimensions, values).

    Returns:
        Groups posterior, sample_stats, log_likelihood, log_prior and timing.
    """
    dims = ("chain", "draw")
    lp = np.sum(terms, axis=-1) + log_prior
    bounds = {
        name: {"lower": float(box.lower[i]), "upper": float(box.upper[i])}
        for i, name in enumerate(box.names)
    }
    drawn = {
        "posterior": {
            name: xr.Variable(dims, theta[name], {**bounds[name], **attrs.get(name, {})})
            for name in box.names
        },
        "sample_stats": {
            name: xr.Variable(dims, values) for name, values in {**stats, "lp": lp}.items()
        },
        "log_likelihood": {"terms": xr.Variable((*dims, "term"), terms)},
        "log_prior": {"log_prior": xr.Variable(dims, log_prior)},
    }
    coords = {dim: np.arange(size) for dim, size in zip(dims, lp.shape, strict=True)}
    coords_of_terms = {**coords, "term": np.arange(terms.shape[-1])}
    datasets = {
        name: xr.Dataset(variables, coords_of_terms if name == "log_likelihood" else coords)
        for name, variables in drawn.items()
    }
    for group, content in (groups or {}).items():
        datasets[group] = xr.Dataset(dict(content))
    tree = xr.DataTree.from_dict({**datasets, "timing": xr.Dataset(attrs={"wall_s": wall_time})})
    tree.attrs.update(facts)
    tree.attrs.update({f"version_{name}": version(name) for name in VERSIONED})
    return tree
