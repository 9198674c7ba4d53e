"""What the verdict needs beside the chains: the solver's error, coloured residuals."""

from collections.abc import Mapping
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float
from numpy.typing import NDArray

from jbw.identification.worth import COLOURED, LEAST_WORTH, correlation_at_one
from jbw.inference.verdict import Finding
from jbw.observables.decay import Decays
from jbw.observables.evidence import Evidence, log_likelihood
from jbw.observables.response import Records

SHIFT = 0.1  # of a posterior standard deviation: what the solver may move a posterior mean
NUM_DRAWS = 32


def solver_finding(posterior: xr.Dataset, data: Evidence) -> Finding | None:
    r"""Whether the solver's step could have moved the posterior.

    Halving the step changes the log likelihood by $\Delta\ell(\theta)$ and so a posterior mean by
    $\mathrm{Cov}(\theta, \Delta\ell)$, at most $\mathrm{sd}(\Delta\ell)$ standard deviations.

    Args:
        posterior: Draws of the parameters that were updated.
        data: The evidence.

    Returns:
        A finding whose number is sd(Delta l) over draws; None where nothing is stepped.
    """
    change = solver_change(thinned(posterior), data)
    return None if change is None else solver_error(change)


def solver_change(
    theta: Mapping[str, Float[np.ndarray, " draw"]], data: Evidence
) -> NDArray[np.float64] | None:
    """What halving the solver's step does to the log likelihood of draws; None without a solver."""
    finer = halved(data)
    if finer is None:
        return None
    draws = {name: jnp.asarray(values) for name, values in theta.items()}
    return np.asarray(_log_likelihoods(draws, finer) - _log_likelihoods(draws, data))


def solver_error(change: NDArray[np.float64]) -> Finding:
    """The finding that follows from a change of the log likelihood of draws."""
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


def halved(data: Evidence) -> Evidence | None:
    """The evidence with twice as many steps of the solver; None where nothing is stepped."""
    if not any(isinstance(part, Records | Decays) for part in data.parts):
        return None
    return replace(
        data,
        parts=tuple(
            replace(part, substeps=2 * part.substeps)
            if isinstance(part, Records | Decays)
            else part
            for part in data.parts
        ),
    )


def thinned(
    posterior: xr.Dataset, names: tuple[str, ...] | None = None, num_draws: int = NUM_DRAWS
) -> dict[str, np.ndarray]:
    """A few draws of the parameters, evenly spaced over all chains."""
    total = posterior.sizes["chain"] * posterior.sizes["draw"]
    keep = np.unique(np.linspace(0, total - 1, min(num_draws, total)).round().astype(int))
    chosen = names or tuple(str(name) for name in posterior.data_vars)
    return {name: posterior[name].values.ravel()[keep] for name in chosen}


@jax.jit
def _log_likelihoods(theta: Mapping[str, Array], data: Evidence) -> Float[Array, " draw"]:
    def one(some: Mapping[str, Array]) -> Float[Array, ""]:
        return jnp.sum(log_likelihood(some, data))

    return jax.lax.map(one, dict(theta))


def residual_findings(left: Mapping[str, np.ndarray], worth: Mapping[str, float]) -> list[Finding]:
    """Whether what is left of each group is white, as the likelihood would like it.

    Args:
        left: What a fit leaves of each group, by its label.
        worth: Share of the values that the likelihood counts, by label.

    Returns:
        One finding a group of 16 values or more; its number is the lag-one correlation.
    """
    return [
        _whiteness(label, correlation_at_one(row), worth[label])
        for label, row in left.items()
        if len(row) >= 2 * LEAST_WORTH
    ]


def _whiteness(label: str, lag_one: float, worth: float) -> Finding:
    ok = abs(lag_one) < COLOURED
    return Finding(
        "coloured_residual",
        "ok" if ok else "failed",
        f"The residual of {label} has a lag-one correlation of {lag_one:.2f}; the likelihood "
        f"counts {worth:.2g} of its values as independent ones.",
        lag_one,
        ""
        if ok
        else "The model does not follow the data to their noise: its law, or a second mode.",
    )
