r"""Free decays fitted each by itself: how far apart they are, beyond what their noise makes.

A law that is a little wrong asks for other products at other amplitudes, and a posterior of all
records is as narrow as if they agreed. So every record is fitted alone, and the scatter $\tau$
between them is that of Paule and Mandel (1982): of relative estimates $q_i$ with errors $s_i$,

$$\sum_i \frac{(q_i - \bar q)^2}{s_i^2 + \tau^2} = n - 1, \qquad
  \bar q = \frac{\sum q_i / (s_i^2 + \tau^2)}{\sum 1 / (s_i^2 + \tau^2)}$$

with $\tau = 0$ where the sum is smaller already. The mean of n records is then known to
$\sqrt{\sigma^2 + \tau^2 / n}$ and no better.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Array, Float
from numpy.typing import NDArray
from scipy import stats
from scipy.optimize import root_scalar

from jbw.identification.prepare import refit
from jbw.inference.fit.fitting import Fit, to_first_order
from jbw.inference.posterior.finding import Finding
from jbw.inference.space.box import Box
from jbw.observables.dataset import Dataset, as_arrays, fractions_counted, left_by_label
from jbw.observables.decay import NUM_OWN
from jbw.observables.effective_values import correlated_fraction
from jbw.oscillator.laws import laws_named

FEWEST = 3  # records, before a scatter is spoken of
BY_CHANCE = 0.01  # probability of as large a scatter, of records that agree
MATTERS = 1.2  # times the interval: a scatter that widens it by less is not spoken of
REACH = float(stats.norm.isf(0.005))  # standard deviations of a 99 % interval


def between_records(best: Fit, prior: Box, data: Dataset) -> xr.Dataset | None:
    """Every record of free decays fitted alone, by what it leaves itself, and their scatter.

    Of the laws' products and of zeta, relative to the fit of all. None where there is another kind
    of test, which every such fit would share, where there is no law, or with fewer than three
    records.
    """
    records = data.runs
    decays_alone = all(part.own_shifts for part in data.parts)
    if not (decays_alone and data.laws and len(records) >= FEWEST):
        return None
    together, error = _known(best, data)
    fits = {record: refit(best, prior, _only(record, data)) for record in records}
    by_record = [_known(fitted, data) for fitted in fits.values()]
    names = list(together)
    size = np.abs(np.array([together[name] for name in names]))
    estimate = np.array([[values[name] for name in names] for values, _ in by_record])
    std = np.array([[errors[name] for name in names] for _, errors in by_record])
    std = std * _own_errors(fits, data)[:, None]
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


def _own_errors(fits: Mapping[str, Fit], data: Dataset) -> NDArray[np.float64]:
    r"""Errors of records by what each leaves alone, over those in the weights of all.

    $\sqrt{(\sigma_i^2 / f) / (\sigma^2 / f_{all})}$: what one law leaves of all records is
    misfit, of which little is left of each, and a larger fraction f of that is independent.
    """
    residuals = {record: left_by_label(fit.residual, data)[record] for record, fit in fits.items()}
    fraction = correlated_fraction(np.stack(list(residuals.values())))
    fraction_of_all = fractions_counted(data)
    noise = dict(zip(data.labels, np.concatenate([_noise(p) for p in data.parts]), strict=True))
    ratios = []
    for record, fitted in fits.items():
        values = residuals[record]
        degrees = max(2 * len(values) - NUM_OWN - len(fitted.theta), 1)
        variance = float(np.sum(np.abs(values) ** 2)) / degrees
        ratios.append(variance / noise[record] ** 2 * fraction_of_all[record] / fraction)
    return np.sqrt(ratios)


def _noise(part: Any) -> NDArray[np.float64]:
    """Noise of every record, in the weights of all."""
    return np.asarray(part.noise_std)


def _only(record: str, data: Dataset) -> Dataset:
    """The dataset in which one record counts alone, of the same shapes."""
    for other in data.runs:
        if other != record:
            data = replace(data, parts=tuple(part.silenced(other) for part in data.parts))
    return data


def _known(fitted: Fit, data: Dataset) -> tuple[dict[str, float], dict[str, float]]:
    """The laws' products and zeta at a fit, and their standard deviations to first order."""

    def quantities(point: Mapping[str, Array]) -> dict[str, Array]:
        theta = {**as_arrays(fitted.theta, data), **point}
        by_name = {"zeta": theta["zeta"]} if "zeta" in point else {}
        for law in laws_named(data.laws):
            parameters = law.of(theta).parameters()
            for product in law.products:
                by_name[product.quantity.name] = product.of({**theta, **parameters})
        return by_name

    return to_first_order(quantities, fitted)


def _scatter(
    estimate: Float[np.ndarray, " record"], std: Float[np.ndarray, " record"]
) -> tuple[float, float]:
    """Scatter beyond the records' own errors, and the probability of as much by these alone."""
    degrees = len(estimate) - 1

    def beyond(variance: float) -> float:
        weight = 1 / (std**2 + variance)
        mean = np.sum(weight * estimate) / np.sum(weight)
        return float(np.sum(weight * (estimate - mean) ** 2)) - degrees

    # A scatter of twice the range explains any.
    most = 4 * float(np.ptp(estimate)) ** 2
    variance = 0.0
    if beyond(0.0) > 0:
        variance = float(root_scalar(beyond, bracket=(0.0, most), rtol=1e-12).root)
    return float(np.sqrt(variance)), float(stats.chi2.sf(beyond(0.0) + degrees, degrees))


def between_finding(between: xr.Dataset) -> Finding:
    """Whether records agree in what each of them says; its number is the largest scatter."""
    count = between.sizes["record"]
    scatter, error = between["scatter"].values, between["std_of_all"].values
    wide = np.sqrt(error**2 + scatter**2 / count)
    sure = between["probability"].values < BY_CHANCE / between.sizes["quantity"]
    if not np.any(sure & (wide > MATTERS * error)):
        agreed = {"count": count, "names": between["quantity"].values.tolist()}
        return Finding("records_apart", "ok", agreed, 0.0)
    worst = int(np.argmax(np.where(sure, scatter, 0.0)))
    names = [str(name) for name in between["quantity"].values]
    values = {
        "count": count,
        "name": names[worst],
        "scatter": float(scatter[worst]),
        "others": [
            (name, float(tau))
            for name, tau in zip(names, scatter, strict=True)
            if tau > 0 and name != names[worst]
        ],
        "within": float(REACH * error[worst]),
        "beyond": float(REACH * wide[worst]),
    }
    return Finding("records_apart", "usable", values, float(scatter[worst]))
