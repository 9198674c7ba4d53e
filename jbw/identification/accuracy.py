"""What the verdict on Step 4 needs beside the chains: the solver's error, coloured residuals."""

from collections.abc import Mapping
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float

from jbw.identification.opening import OpeningData, log_likelihood
from jbw.inference.verdict import Finding
from jbw.observables import response

SHIFT = 0.1  # of a posterior standard deviation: what the solver may move a posterior mean
COLOURED = 0.2  # lag-one correlation above which intervals are noticeably too narrow
NUM_DRAWS = 32


def solver_finding(posterior: xr.Dataset, data: OpeningData) -> Finding:
    r"""Whether the solver's step could have moved the posterior.

    Halving the step changes the log likelihood by $\Delta\ell(\theta)$ and so a posterior mean by
    $\mathrm{Cov}(\theta, \Delta\ell)$, at most $\mathrm{sd}(\Delta\ell)$ standard deviations.

    Args:
        posterior: Draws of the parameters that were updated.
        data: The data of Step 4.

    Returns:
        A finding whose number is sd(Delta l) over draws.
    """
    finer = eqx.tree_at(
        lambda d: d.records,
        data,
        replace(data.records, substeps=2 * data.records.substeps),
    )
    theta = _thinned(posterior)
    change = np.asarray(_log_likelihoods(theta, finer) - _log_likelihoods(theta, data))
    shift = float(np.std(change))
    ok = shift < SHIFT
    return Finding(
        "solver_error",
        "ok" if ok else "failed",
        f"Halving the solver's step moves no posterior mean by more than {shift:.2g} standard "
        f"deviations; it must be below {SHIFT:g}.",
        shift,
        "" if ok else "Set `substeps` in [identify] to twice its value.",
    )


def residual_findings(theta: Mapping[str, float], data: OpeningData) -> list[Finding]:
    """Whether the residuals of each level's mean are white, as the likelihood takes them.

    Args:
        theta: The optimum.
        data: The data of Step 4.

    Returns:
        One finding a level; its number is the lag-one correlation of the residual.
    """
    everything = {**data.held, **{name: jnp.asarray(value) for name, value in theta.items()}}
    left = np.asarray(data.records.mean - response.predict(everything, data.records))
    return [_whiteness(i, row) for i, row in enumerate(left)]


def _whiteness(level: int, row: Float[np.ndarray, " time"]) -> Finding:
    row = row - row.mean()
    lag_one = float(np.sum(row[1:] * row[:-1]) / np.sum(row**2))
    ok = abs(lag_one) < COLOURED
    effective = (1 - abs(lag_one)) / (1 + abs(lag_one))
    return Finding(
        "coloured_residual",
        "ok" if ok else "failed",
        f"The residual of fitted level {level + 1} has a lag-one correlation of {lag_one:.2f}; "
        f"its samples are worth {effective:.0%} of as many independent ones.",
        lag_one,
        ""
        if ok
        else "The model does not follow the data to their noise: intervals are too narrow.",
    )


def _thinned(posterior: xr.Dataset) -> dict[str, Array]:
    total = posterior.sizes["chain"] * posterior.sizes["draw"]
    keep = np.unique(np.linspace(0, total - 1, min(NUM_DRAWS, total)).round().astype(int))
    return {str(n): jnp.asarray(v.values.ravel()[keep]) for n, v in posterior.data_vars.items()}


@jax.jit
def _log_likelihoods(theta: Mapping[str, Array], data: OpeningData) -> Float[Array, " draw"]:
    def one(some: Mapping[str, Array]) -> Float[Array, ""]:
        return jnp.sum(log_likelihood(some, data))

    return jax.lax.map(one, dict(theta), batch_size=8)
