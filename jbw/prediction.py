"""Draws of the posterior carried through the model to the records of a test, as 99 % bands."""

from collections.abc import Mapping
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float
from numpy.typing import NDArray

from jbw.measurement.records import Record
from jbw.observables.joint import JOINT
from jbw.observables.response import response_to

QUANTILES = (0.005, 0.5, 0.995)
Draws = dict[str, NDArray[np.float64]]


def thin(posterior: xr.Dataset, num_draws: int, held: Mapping[str, float] | None = None) -> Draws:
    """Evenly spaced draws over all chains, with what was held beside them.

    Args:
        posterior: Posterior group with dimensions (chain, draw).
        num_draws: Draws to keep at most.
        held: Parameters that were not updated, the same in every draw.

    Returns:
        Each parameter of the joint, and `gain`, to its draws.
    """
    total = posterior.sizes["chain"] * posterior.sizes["draw"]
    keep = np.unique(np.linspace(0, total - 1, min(num_draws, total)).round().astype(int))
    fixed = {name: np.full(len(keep), float(value)) for name, value in (held or {}).items()}
    names = [name for name in (*JOINT, "gain") if name in posterior]
    return {**fixed, **{name: posterior[name].values.ravel()[keep] for name in names}}


@partial(jax.jit, static_argnames=("fs", "response", "substeps"))
def _respond(
    draws: Mapping[str, Array],
    source: Float[Array, " time"],
    fs: float,
    response: str,
    substeps: int,
) -> Float[Array, "draw time"]:
    def one(theta: Mapping[str, Array]) -> Float[Array, " time"]:
        return response_to(theta, source, fs, response=response, substeps=substeps)

    return jax.lax.map(one, dict(draws), batch_size=8)


def predict_record(draws: Draws, record: Record, *, substeps: int = 2) -> NDArray[np.float64]:
    """Response of every draw to the measured input of a record, from rest.

    Args:
        draws: Parameters of the joint and gain, one value a draw.
        record: The record whose input to use.
        substeps: Steps of the solver between samples.

    Returns:
        Responses of shape (draw, time), in the unit of the measured response.
    """
    theta = {name: jnp.asarray(values) for name, values in draws.items()}
    source = jnp.asarray(record.channels[record.source])
    return np.asarray(_respond(theta, source, record.fs, record.response, substeps))


def band(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Quantiles 0.5 %, 50 % and 99.5 % along the first axis: a 99 % band about its median."""
    return np.quantile(values, QUANTILES, axis=0)
