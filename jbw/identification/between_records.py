r"""Free decays fitted each by itself: how far apart they are, beyond what their noise makes.

A law that is a little wrong asks for other products at other amplitudes, and a posterior of all
records is as narrow as if they agreed. So every record is fitted alone, and the scatter between
them is that of DerSimonian and Laird (1986): of relative estimates $q_i$ with errors $s_i$,

$$Q = \sum_i \frac{(q_i - \bar q)^2}{s_i^2}, \qquad
  \tau^2 = \frac{Q - (n - 1)}{\sum w_i - \sum w_i^2 / \sum w_i}, \quad w_i = s_i^{-2}$$

with $\tau = 0$ where Q is below n - 1. The mean of n records is then known to
$\sqrt{\sigma^2 + \tau^2 / n}$ and no better.
"""

from collections.abc import Mapping
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float
from numpy.typing import NDArray
from scipy import stats

from jbw.identification.prepare import refit
from jbw.inference.fit.fitting import Fit
from jbw.inference.posterior.finding import Finding
from jbw.inference.space.box import Box
from jbw.observables.dataset import Dataset, as_arrays, fractions_counted
from jbw.observables.decay import NUM_OWN
from jbw.oscillator.laws import laws_named

FEWEST = 3  # records, before a scatter is spoken of
BY_CHANCE = 0.01  # probability of as large a scatter, of records that agree
REACH = float(stats.norm.isf(0.005))  # standard deviations of a 99 % interval


def between_records(best: Fit, prior: Box, data: Dataset) -> xr.Dataset | None:
    """Every record of free decays fitted alone, in the weights of all, and the scatter of them.

    Of the laws' products and of zeta, relative to the fit of all. None where there is another kind
    of test, which every such fit would share, where there is no law, or with fewer than three
    records.
    """
    records = data.runs
    alone = all(part.own_shifts for part in data.parts)
    if not (alone and data.laws and len(records) >= FEWEST):
        return None
    whole, error = _known(best, data)
    fits = {record: refit(best, prior, _only(record, data)) for record in records}
    each = [_known(fitted, data) for fitted in fits.values()]
    names = list(whole)
    size = np.abs(np.array([whole[name] for name in names]))
    estimate = np.array([[values[name] for name in names] for values, _ in each])
    std = np.array([[errors[name] for name in names] for _, errors in each])
    std = std * _smaller_errors(fits, data)
    scatter = [
        _scatter(*columns) for columns in zip((estimate / size).T, (std / size).T, strict=True)
    ]
    dims, relative = ("record", "quantity"), {"units": "1"}
    return xr.Dataset(
        {
            "estimate": (dims, estimate / size, {**relative, "long_name": "over that of all"}),
            "std": (dims, std / size, {**relative, "long_name": "its standard deviation"}),
            "std_of_all": ("quantity", [error[name] for name in names] / size, relative),
            "scatter": ("quantity", [tau for tau, _ in scatter], relative),
            "probability": ("quantity", [p for _, p in scatter], relative),
        },
        {"record": list(records), "quantity": names},
    )


def _smaller_errors(fits: Mapping[str, Fit], data: Dataset) -> float:
    """Errors of records fitted alone over those in the weights of all, which hold what these leave.

    By chi-square over the degrees of freedom of all such fits together; one at most.
    """
    fractions = fractions_counted(data)
    degrees = 0.0
    for record, fitted in fits.items():
        values = fractions[record] * (data.layout[record] - 1)  # its shift is none
        degrees += max(values - NUM_OWN - len(fitted.theta), 1.0)
    chi_square = sum(2 * fitted.cost for fitted in fits.values())
    return float(np.sqrt(min(chi_square / degrees, 1.0)))


def _only(record: str, data: Dataset) -> Dataset:
    """The dataset in which one record counts alone, of the same shapes."""
    for other in data.runs:
        if other != record:
            data = replace(data, parts=tuple(part.silenced(other) for part in data.parts))
    return data


def _known(fitted: Fit, data: Dataset) -> tuple[dict[str, float], dict[str, float]]:
    """The laws' products and zeta at a fit, and their standard deviations to first order."""
    names = list(fitted.theta)

    def quantities(x: Float[Array, " parameter"]) -> dict[str, Array]:
        theta = {**as_arrays(fitted.theta, data), **dict(zip(names, x, strict=True))}
        found = {"zeta": theta["zeta"]} if "zeta" in names else {}
        for law in laws_named(data.laws):
            parameters = law.of(theta).parameters()
            for product in law.products:
                found[product.quantity.name] = product.of({**theta, **parameters})
        return found

    x = jnp.asarray(list(fitted.theta.values()))
    values, slopes = quantities(x), jax.jacfwd(quantities)(x)
    covariance = np.asarray(fitted.covariance)
    std = {name: float(np.sqrt(row @ covariance @ row)) for name, row in _rows(slopes).items()}
    return {name: float(value) for name, value in values.items()}, std


def _rows(slopes: Mapping[str, Array]) -> dict[str, NDArray[np.float64]]:
    return {name: np.asarray(row) for name, row in slopes.items()}


def _scatter(
    estimate: Float[np.ndarray, " record"], std: Float[np.ndarray, " record"]
) -> tuple[float, float]:
    """Scatter beyond the records' own errors, and the probability of as much by these alone."""
    weight = 1 / std**2
    mean = np.sum(weight * estimate) / np.sum(weight)
    q, degrees = float(np.sum(weight * (estimate - mean) ** 2)), len(estimate) - 1
    share = np.sum(weight) - np.sum(weight**2) / np.sum(weight)
    return float(np.sqrt(max(q - degrees, 0.0) / share)), float(stats.chi2.sf(q, degrees))


def between_finding(between: xr.Dataset) -> Finding:
    """Whether records agree in what each of them says; its number is the largest scatter."""
    count = between.sizes["record"]
    scatter = between["scatter"].values
    if not np.any(between["probability"].values < BY_CHANCE / between.sizes["quantity"]):
        reason = (
            f"Fitted each by itself, the {count} records agree within their own errors in "
            f"{', '.join(map(str, between['quantity'].values))}."
        )
        return Finding("records_apart", "ok", reason, 0.0)
    worst = int(np.argmax(scatter))
    names = [str(name) for name in between["quantity"].values]
    others = [
        f"{name} by {100 * tau:.2g} %"
        for name, tau in zip(names, scatter, strict=True)
        if tau > 0 and name != names[worst]
    ]
    also = f" ({', '.join(others)})" if others else ""
    known = 100 * REACH * float(between["std_of_all"][worst])
    mean = REACH * np.sqrt(float(between["std_of_all"][worst]) ** 2 + scatter[worst] ** 2 / count)
    reason = (
        f"Fitted each by itself, the {count} records scatter by {100 * scatter[worst]:.2g} % of "
        f"{names[worst]}{also} beyond their own errors. The 99 % interval of {names[worst]} is "
        f"+-{known:.2g} % for a law that holds in all of them; for other records like these it is "
        f"+-{100 * mean:.2g} %."
    )
    action = (
        "Quote the wider interval, and look for what differs between the records, as the size of "
        "the blow or its place: `jbw laws` tries laws that may hold in all of them."
    )
    return Finding("records_apart", "usable", reason, float(scatter[worst]), action)
