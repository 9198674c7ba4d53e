"""What a posterior says: a row of numbers for every quantity, bands, densities, running means."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float
from numpy.typing import ArrayLike, NDArray
from scipy.special import digamma
from scipy.stats import gaussian_kde

from jbw.inference.space.box import Box

Row = dict[str, float]
QUANTILES = (0.005, 0.5, 0.995)
"""Of a 99 % interval and its middle."""
NUM_POINTS = 256  # of a density


def evenly_spaced(posterior: xr.Dataset, num_draws: int) -> NDArray[np.intp]:
    """Numbers of so many draws at most, evenly spaced over all chains laid end to end."""
    total = posterior.sizes["chain"] * posterior.sizes["draw"]
    return np.unique(np.linspace(0, total - 1, min(num_draws, total)).round().astype(int))


def summarise(tree: xr.DataTree, box: Box | None = None) -> dict[str, Row]:
    """Summary of every scalar quantity of a posterior.

    Args:
        tree: Groups posterior and sample_stats, as `sample` leaves them.
        box: Prior bounds; when None, those stored beside the parameters.

    Returns:
        Quantity to its row: map, mean, sd, cv, the quantiles q005 and q995 about 99 %, kl [nats
        from the prior], contraction (1 less the variance over the prior's), ess_bulk, ess_tail,
        r_hat. A number that cannot be had is NaN. The map is the draw of the highest posterior
        density.
    """
    posterior = tree["posterior"].to_dataset()
    lp = tree["sample_stats"].to_dataset()["lp"].values
    bounds = _bounds(posterior, box)
    return {name: _row(values, lp, bounds.get(name)) for name, values in scalars(tree).items()}


def scalars(tree: xr.DataTree) -> dict[str, Float[np.ndarray, "chain draw"]]:
    """Draws of every scalar quantity of a posterior, by name."""
    return {
        str(name): np.asarray(variable.values)
        for name, variable in tree["posterior"].to_dataset().items()
        if variable.dims == ("chain", "draw")
    }


def _bounds(posterior: xr.Dataset, box: Box | None) -> dict[str, tuple[float, float]]:
    if box is not None:
        pairs = zip(box.lower, box.upper, strict=True)
        return {n: (float(a), float(b)) for n, (a, b) in zip(box.names, pairs, strict=True)}
    return {
        str(name): (var.attrs["lower"], var.attrs["upper"])
        for name, var in posterior.items()
        if "lower" in var.attrs
    }


def _row(
    draws: Float[np.ndarray, "chain draw"],
    lp: Float[np.ndarray, "chain draw"],
    bounds: tuple[float, float] | None,
) -> Row:
    low, high = (float(q) for q in np.quantile(draws, [QUANTILES[0], QUANTILES[2]]))
    mean, sd = float(np.mean(draws)), float(np.std(draws, ddof=1))
    row = {
        "map": float(draws.ravel()[np.argmax(lp)]),
        "mean": mean,
        "sd": sd,
        "cv": sd / abs(mean) if mean else float("nan"),
        quantile_name(QUANTILES[0]): low,
        quantile_name(QUANTILES[2]): high,
        "kl": float("nan"),
        "contraction": float("nan"),
        **diagnose(draws),
    }
    if bounds is not None and np.all(np.isfinite(draws)):
        lower, upper = bounds
        row["kl"] = kl_from_uniform(np.ravel((draws - lower) / (upper - lower)))
        row["contraction"] = 1 - 12 * sd**2 / (upper - lower) ** 2
    return {name: value if np.isfinite(value) else float("nan") for name, value in row.items()}


def quantile_name(probability: float) -> str:
    """Name of a quantile in thousandths: 0.005 is q005, 0.995 is q995."""
    return f"q{round(1000 * probability):03d}"


def diagnose(draws: Float[np.ndarray, "chain draw"]) -> Row:
    """Effective sample sizes and split R-hat of one quantity, NaN where there are none.

    Returns:
        ess_bulk, ess_tail, r_hat (rank-normalised). All NaN for non-finite draws or where a chain
        never moved; r_hat NaN for one chain.

    Reference:
        Vehtari et al. (2021), Bayesian Analysis 16, 667.
    """
    from arviz_stats.base.array import array_stats  # a second of imports, needed only here

    stats: Any = array_stats  # its annotations admit tuples that it never returns here
    nothing = float("nan")
    if draws.shape[1] < 4 or not np.all(np.isfinite(draws)) or np.any(np.ptp(draws, axis=1) == 0):
        return {"ess_bulk": nothing, "ess_tail": nothing, "r_hat": nothing}
    return {
        "ess_bulk": float(stats.ess(draws, method="bulk")),
        "ess_tail": float(stats.ess(draws, method="tail", prob=(0.05, 0.95))),
        "r_hat": float(stats.rhat(draws)) if len(draws) > 1 else nothing,
    }


def kl_from_uniform(x: Float[np.ndarray, " draw"], window: int | None = None) -> float:
    r"""Divergence of a marginal posterior from U[0, 1] by m-spacings.

    $$D = -h(x), \qquad \hat h = \frac1n \sum_i \left[\log(x_{(i+m)} - x_{(i-m)})
    - \psi(k_i) + \psi(n + 1)\right]$$

    Ranks are cut at 1 and n, and k_i counts the gaps spanned. The digamma terms, in place of
    Vasicek's log(2m/n), make the estimate free of bias for uniform draws.

    Args:
        x: Draws in the unit coordinate, in any order. Repeated draws count; infinite where one
            value repeats more than 2m times.
        window: m; the nearest integer to sqrt(n) when None.

    Returns:
        Divergence [nats], slightly negative at times for draws from the prior.

    Reference:
        Section 3.2; Vasicek (1976), J. R. Stat. Soc. B 38, 54.
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
    """Posterior correlations of the scalar quantities, by name and name."""
    columns = {name: values.ravel() for name, values in scalars(tree).items()}
    matrix = np.atleast_2d(np.corrcoef(np.array(list(columns.values()))))
    return {
        name: dict(zip(columns, row.tolist(), strict=True))
        for name, row in zip(columns, matrix, strict=True)
    }


def running_mean(values: Float[np.ndarray, " draw *rest"]) -> NDArray[np.float64]:
    r"""Mean of the first n values, for every n.

    $$\mathrm{conv}(n) = \frac1n \sum_{i \le n} q_i$$

    Not a convergence test by itself: a chain that does not mix has a smooth running mean too.

    Args:
        values: One value a draw, such as the integral of |H_3|^2 over the band.

    Returns:
        Running means, of the same shape.

    Reference:
        Eq. (40).
    """
    count = np.arange(1, len(values) + 1).reshape(-1, *(1,) * (np.ndim(values) - 1))
    return np.cumsum(values, axis=0) / count


def band(
    draws: Float[np.ndarray, " draw *rest"], prob: float = 0.99
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Pointwise central band of a response over draws.

    Args:
        draws: Response of each draw.
        prob: Probability inside the band, at each point by itself.

    Returns:
        Lower bound, median, upper bound.
    """
    tail = (1 - prob) / 2
    lower, median, upper = np.quantile(draws, [tail, 0.5, 1 - tail], axis=0)
    return lower, median, upper


def marginal_density(
    draws: ArrayLike, lower: float, upper: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Density of a marginal posterior in its prior interval, by a kernel estimate.

    Draws are mirrored at both bounds, so that a flat posterior has a flat density.

    Returns:
        Grid over the draws' range widened to at most the bounds, and the density there.
    """
    inside = np.ravel(draws)
    estimate = gaussian_kde(inside)
    reach = 4 * np.sqrt(estimate.covariance[0, 0])
    ends = max(lower, inside.min() - reach), min(upper, inside.max() + reach)
    grid = np.linspace(*ends, NUM_POINTS)
    density = estimate(grid) + estimate(2 * lower - grid) + estimate(2 * upper - grid)
    return grid, density


def as_plain(rows: Mapping[str, Row]) -> dict[str, dict[str, Any]]:
    """Rows of `summarise` for JSON, which has no NaN: None instead."""
    return {
        name: {key: None if np.isnan(value) else value for key, value in row.items()}
        for name, row in rows.items()
    }
