"""Summaries of a posterior: one row of numbers per quantity, bands, running means."""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.special import digamma

from jbw.inference.posterior.quantiles import QUANTILES
from jbw.inference.space.box import Box, bounds_by_name
from jbw.results.attributes import DrawnPosterior

if TYPE_CHECKING:
    from jbw.inference.space.stated import StatedDensities  # loads NumPyro

Row = dict[str, float]
DIAGNOSTICS = ("ess_bulk", "ess_tail", "r_hat")  # convergence diagnostics of chains
LAPLACE = "laplace"  # name of independent draws from a fit's Gaussian approximation


def posterior_draws(tree: xr.DataTree) -> xr.Dataset:
    """Return the draws that a posterior's result tree contains."""
    return tree["posterior"].to_dataset()


def shape_of(draws: xr.Dataset) -> tuple[int, int]:
    """Return the number of chains, and the number of draws in each."""
    return draws.sizes["chain"], draws.sizes["draw"]


def evenly_spaced(posterior: xr.Dataset, num_draws: int) -> NDArray[np.intp]:
    """Return indices of at most `num_draws` evenly spaced draws from all chains."""
    total = math.prod(shape_of(posterior))
    return np.unique(np.linspace(0, total - 1, min(num_draws, total)).round().astype(int))


def summarise(
    tree: xr.DataTree, box: Box, stated: "StatedDensities | None" = None
) -> dict[str, Row]:
    """Return a row of summary numbers for each scalar quantity of a posterior, by name.

    `map` is the draw with the highest density. `kl` [nats] is the divergence from the prior, that
    of the box or a stated density. `contraction` is 1 minus the variance over the prior's. Values
    that cannot be computed are NaN, such as diagnostics of chains if the draws are those of a fit's
    Gaussian approximation.
    """
    chains = DrawnPosterior.of(tree).sampler != LAPLACE
    lp = tree["sample_stats"].to_dataset()["lp"].values
    bounds, draws = bounds_by_name(box), scalars(tree)
    rows = {name: _row(values, lp, bounds.get(name), chains) for name, values in draws.items()}
    densities = {} if stated is None else zip(stated.names, stated.distributions, strict=True)
    for name, density in dict(densities).items():
        if name in rows and name in bounds:
            rows[name] |= _from_density(rows[name], draws[name], bounds[name], density)
    return rows


def _from_density(
    row: Row, draws: Float[np.ndarray, "chain draw"], bounds: tuple[float, float], density: Any
) -> Row:
    r"""Convert divergence and contraction, computed for a uniform prior, to a stated density.

    $$D(p, \pi) = D(p, U) - E_p[\log\pi + \log(u - l)]$$
    """
    gain = np.asarray(density.log_prob(draws)) + math.log(bounds[1] - bounds[0])
    variance = float(density.variance)
    return {
        "kl": row["kl"] - float(np.mean(gain)),
        "contraction": 1 - row["sd"] ** 2 / variance if math.isfinite(variance) else math.nan,
    }


def scalars(tree: xr.DataTree) -> dict[str, Float[np.ndarray, "chain draw"]]:
    """Return the draws of every scalar quantity of a posterior, by name."""
    return {
        str(name): np.asarray(variable.values)
        for name, variable in posterior_draws(tree).items()
        if variable.dims == ("chain", "draw")
    }


def _row(
    draws: Float[np.ndarray, "chain draw"],
    lp: Float[np.ndarray, "chain draw"],
    bounds: tuple[float, float] | None,
    chains: bool = True,
) -> Row:
    low, high = (float(q) for q in np.quantile(draws, [QUANTILES[0], QUANTILES[2]]))
    mean, sd = float(np.mean(draws)), float(np.std(draws, ddof=1))
    diagnostics: Row = diagnose(draws) if chains else dict.fromkeys(DIAGNOSTICS, math.nan)
    row = {
        "map": float(draws.ravel()[np.argmax(lp)]),
        "mean": mean,
        "sd": sd,
        "cv": sd / abs(mean) if mean else math.nan,
        "q005": low,
        "q995": high,
        "kl": math.nan,
        "contraction": math.nan,
        **diagnostics,
    }
    if bounds is not None and np.all(np.isfinite(draws)):
        lower, upper = bounds
        row["kl"] = kl_from_uniform(np.ravel((draws - lower) / (upper - lower)))
        row["contraction"] = 1 - 12 * sd**2 / (upper - lower) ** 2
    return {name: value if np.isfinite(value) else math.nan for name, value in row.items()}


def diagnose(draws: Float[np.ndarray, "chain draw"]) -> Row:
    """Return bulk and tail effective sample size and R-hat of a quantity's draws.

    All are NaN for non-finite draws or if a chain never moved; r_hat is NaN for one chain.
    """
    from arviz_stats.base.array import array_stats  # an import of one second, needed only here

    stats: Any = array_stats  # ArviZ's annotations do not fit what these calls return.
    if draws.shape[1] < 4 or not np.all(np.isfinite(draws)) or np.any(np.ptp(draws, axis=1) == 0):
        return dict.fromkeys(DIAGNOSTICS, math.nan)
    return {
        "ess_bulk": float(stats.ess(draws, method="bulk")),
        "ess_tail": float(stats.ess(draws, method="tail", prob=(0.05, 0.95))),
        "r_hat": float(stats.rhat(draws)) if len(draws) > 1 else math.nan,
    }


def kl_from_uniform(x: Float[np.ndarray, " draw"], window: int | None = None) -> float:
    r"""Estimate the divergence [nats] of draws from U[0, 1] by m-spacings: section 3.2.

    $$D = -h(x), \qquad \hat h = \frac1n \sum_i \left[\log(x_{(i+m)} - x_{(i-m)})
    - \psi(k_i) + \psi(n + 1)\right]$$

    Ranks are cut at 1 and n, k_i counts the spanned gaps, and the window m is the nearest integer
    to sqrt(n) when None. The digamma terms, not the log(2m/n) of Vasicek (1976), J. R. Stat. Soc. B
    38, 54, make it unbiased for uniform draws; infinite where a value repeats more than 2m times.
    """
    n = len(x)
    m = max(1, round(math.sqrt(n))) if window is None else window
    ordered = np.sort(x)
    rank = np.arange(n)
    last, first = np.minimum(rank + m, n - 1), np.maximum(rank - m, 0)
    with np.errstate(divide="ignore"):
        log_spacing = np.log(ordered[last] - ordered[first])
    return float(-np.mean(log_spacing - digamma(last - first) + digamma(n + 1)))


def correlations(tree: xr.DataTree) -> dict[str, dict[str, float]]:
    """Return the posterior correlations of all pairs of scalar quantities, by name."""
    columns = {name: values.ravel() for name, values in scalars(tree).items()}
    matrix = np.atleast_2d(np.corrcoef(np.array(list(columns.values()))))
    return {
        name: dict(zip(columns, row.tolist(), strict=True))
        for name, row in zip(columns, matrix, strict=True)
    }


def running_mean(values: Float[np.ndarray, " draw *rest"]) -> NDArray[np.float64]:
    r"""Return the mean of the first n values for each n: eq. (40).

    $$\mathrm{conv}(n) = \frac1n \sum_{i \le n} q_i$$
    """
    count = np.arange(1, len(values) + 1).reshape(-1, *(1,) * (np.ndim(values) - 1))
    return np.cumsum(values, axis=0) / count


def band(
    draws: Float[np.ndarray, " draw *rest"], prob: float = 0.99
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return lower end, median and upper end of the central band of a response at each point."""
    tail = (1 - prob) / 2
    lower, median, upper = np.quantile(draws, [tail, 0.5, 1 - tail], axis=0)
    return lower, median, upper


def as_plain(rows: Mapping[str, Row]) -> dict[str, dict[str, Any]]:
    """Return summary rows for JSON, with None instead of NaN."""
    return {
        name: {key: None if np.isnan(value) else value for key, value in row.items()}
        for name, row in rows.items()
    }
