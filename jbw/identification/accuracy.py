"""What the verdict needs beside the chains: the solver's error, coloured residuals."""

from collections.abc import Mapping
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Complex, Float
from numpy.typing import NDArray

from jbw.inference.verdict import Finding
from jbw.observables.decay import Decays
from jbw.observables.evidence import Evidence, log_likelihood
from jbw.observables.linear import LineReading
from jbw.observables.response import Records

SHIFT = 0.1  # of a posterior standard deviation: what the solver may move a posterior mean
COLOURED = 0.2  # lag-one correlation above which intervals are noticeably too narrow
MISFIT = 0.5  # of a mean's variance: misfit that repeats do not average out
LEAST_WORTH = 8  # independent values of a group, below which nothing could be integrated out
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


def thinned(posterior: xr.Dataset, names: tuple[str, ...] | None = None) -> dict[str, np.ndarray]:
    """A few draws of the parameters, evenly spaced over all chains."""
    total = posterior.sizes["chain"] * posterior.sizes["draw"]
    keep = np.unique(np.linspace(0, total - 1, min(NUM_DRAWS, total)).round().astype(int))
    chosen = names or tuple(str(name) for name in posterior.data_vars)
    return {name: posterior[name].values.ravel()[keep] for name in chosen}


@jax.jit
def _log_likelihoods(theta: Mapping[str, Array], data: Evidence) -> Float[Array, " draw"]:
    def one(some: Mapping[str, Array]) -> Float[Array, ""]:
        return jnp.sum(log_likelihood(some, data))

    return jax.lax.map(one, dict(theta))


def correlation_at_one(row: Float[np.ndarray, " n"] | Complex[np.ndarray, " n"]) -> float:
    """Lag-one correlation of a residual."""
    return float(np.real(np.vdot(row[:-1], row[1:])) / np.real(np.vdot(row, row)))


def worth_of(rows: Float[np.ndarray, "row n"] | Complex[np.ndarray, "row n"]) -> float:
    r"""Share of independent values among correlated ones.

    $$1/w = 1 + 2 \sum_{k \ge 1} \rho_k$$

    with the correlation over all rows, summed until it first falls below zero.

    Args:
        rows: What a fit leaves of one or more groups.

    Returns:
        w, at most 1.
    """
    n = rows.shape[1]
    unit = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    spectrum = np.mean(np.abs(np.fft.fft(unit, 2 * n)) ** 2, axis=0)
    rho = np.fft.ifft(spectrum).real[1 : n // 2]
    below = np.flatnonzero(rho < 0)
    total = float(rho[: below[0] if below.size else len(rho)].sum())
    return float(np.clip(1 / (1 + 2 * total), min(1.0, LEAST_WORTH / n), 1.0))


def worth_by_label(left: Mapping[str, np.ndarray], data: Evidence) -> dict[str, float]:
    r"""Share of independent values of each group that is coloured, or misfitted in all repeats.

    Misfit of variance tau^2 is the same in all K repeats, so that they are worth

    $$f = w\,\frac{\tau^2 + \sigma^2}{K \tau^2 + \sigma^2}$$

    of as many values, w for the colour of the mean's residual.

    Args:
        left: What a fit leaves of each group, by its label.
        data: The evidence.

    Returns:
        Shares below one, by label.
    """
    found = {}
    for part in data.parts:
        if isinstance(part, LineReading | Decays):
            continue
        own = part.repeats
        for i, label in enumerate(own.labels):
            row, count = left[label], float(own.num_repeats[i])
            size = float(own.size[i])
            square = float(np.sum(np.abs(row) ** 2)) / size
            noise = float(own.within[i]) / (size * (count - 1)) if count > 1 else 0.0
            misfit = max(square - noise / count, 0.0)
            coloured = len(row) >= 2 * LEAST_WORTH and correlation_at_one(row) > COLOURED
            misfitted = count > 1 and count * misfit > MISFIT * noise
            share = worth_of(row[None]) if coloured else 1.0
            if misfitted:
                share *= (misfit + noise) / (count * misfit + noise)
            if share < 1.0:
                found[label] = share
    return found


def residual_findings(left: Mapping[str, np.ndarray], worth: Mapping[str, float]) -> list[Finding]:
    """Whether what is left of each group is white, as the likelihood would like it.

    Args:
        left: What a fit leaves of each group, by its label.
        worth: Share of independent values counted, by label; one where not named.

    Returns:
        One finding a group of 16 values or more; its number is the lag-one correlation.
    """
    return [
        _whiteness(label, correlation_at_one(row), worth.get(label, 1.0))
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
