"""Prediction bands from draws, and the errors of measurements relative to them."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float, Shaped
from numpy.typing import NDArray
from scipy.stats import norm

from jbw.inference.posterior.summary import QUANTILES

# name, among the reference models, of the law's own prediction without model discrepancy
LAW = "law"
# name, values and attributes of the axis along which a band's quantiles lie
QUANTILE_AXIS = ("quantile", list(QUANTILES), {"units": "1"})


def error(measured: NDArray[Any], predicted: NDArray[Any]) -> float:
    """Return the rms error of a prediction, relative to the rms of the measured values."""
    return float(np.linalg.norm(measured - predicted) / np.linalg.norm(measured))


def half_width(edges: NDArray[np.float64], measured: NDArray[Any]) -> float:
    """Return half the rms width of a band, divided by the rms of the measured values.

    If this is large, a band that contains every value says little.
    """
    return float(np.linalg.norm(edges[-1] - edges[0]) / (2 * np.linalg.norm(measured)))


def errors(
    measured: NDArray[np.float64],
    model: Float[np.ndarray, "draw value"],
    others: Mapping[str, NDArray[np.float64]],
    noise_std: float | NDArray[np.float64] | None,
    repeats: Float[np.ndarray, "repeat value"] | None = None,
) -> dict[str, float]:
    """Return a test's prediction errors, coverage and variation of repeats, as attributes."""
    # `coverage` is the fraction of the `num_values` values (of the repeats, or else of their mean)
    # inside the predictive band. `half_width` is that of this band, or of the band from the
    # parameters alone. `scatter` is the variation of repeats about their mean, in the same unit as
    # `nrmse`.
    edges = band(model) if noise_std is None else gaussian_band(model, noise_std)
    measures = {"nrmse": error(measured, np.median(model, axis=0))}
    measures |= {f"nrmse_{name}": error(measured, other) for name, other in others.items()}
    measures["half_width"] = half_width(edges, measured)
    if repeats is not None and len(repeats) > 1:
        scatter = np.linalg.norm(repeats - repeats.mean(axis=0)) / np.sqrt(len(repeats) - 1)
        measures["scatter"] = float(scatter / np.linalg.norm(measured))
    if noise_std is not None:
        inside = within(measured if repeats is None else repeats, edges)
        measures |= {"coverage": float(np.mean(inside)), "num_values": inside.size}
    return measures


def middle(values: Shaped[np.ndarray, " draw *value"]) -> Shaped[np.ndarray, " *value"]:
    """Return the median over the draws; real and imaginary parts have separate medians."""
    if not np.iscomplexobj(values):
        return np.median(values, axis=0)
    return np.median(np.real(values), axis=0) + 1j * np.median(np.imag(values), axis=0)


def recentred(
    model: Shaped[np.ndarray, " draw *value"], centre: Shaped[np.ndarray, " *value"]
) -> Shaped[np.ndarray, " draw *value"]:
    r"""Return draws moved to another median, $m_k + m_0 - \operatorname{med}_k(m_k)$.

    If a model discrepancy scatters frequencies widely, the phases of the draws $m_k$ scatter too,
    and their median is smaller than any of them, so it does not represent the law's prediction. The
    median $m_0$ of draws without the discrepancy does.
    """
    return model + (centre - middle(model))


def about_law(
    model: Shaped[np.ndarray, " draw *value"], others: Mapping[str, NDArray[Any]]
) -> tuple[NDArray[Any], dict[str, NDArray[Any]]]:
    """Centre the draws on the law's own prediction, if given; return draws and other models."""
    rest = {name: values for name, values in others.items() if name != LAW}
    return (recentred(model, others[LAW]) if LAW in others else model), rest


def within(values: NDArray[np.float64], edges: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which values lie inside a band of quantiles."""
    return (values >= edges[0]) & (values <= edges[-1])


def band(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the quantiles 0.5 %, 50 % and 99.5 % of draws: a 99 % band with its median."""
    return np.quantile(values, QUANTILES, axis=0)


def noisy_band(
    model: Float[np.ndarray, " draw *value"], noise_std: float | Float[np.ndarray, " *value"]
) -> NDArray[np.float64]:
    r"""Return the 99 % band of draws that need not be normal, with normal noise.

    $$m \mp \sqrt{(m - q)^2 + (2.576\,\sigma)^2}$$

    with the median m and the quantiles q of the draws: the noise adds in squares, exactly and not
    by random numbers, of which a hundred make a band a tenth too narrow.
    """
    low, median, high = band(model)
    noise = norm.ppf(QUANTILES[-1]) * noise_std
    return np.stack(
        [median - np.hypot(median - low, noise), median, median + np.hypot(high - median, noise)]
    )


def gaussian_band(
    model: Float[np.ndarray, " draw *value"], noise_std: float | Float[np.ndarray, " *value"]
) -> NDArray[np.float64]:
    """Return the 99 % band m -+ 2.576 sqrt(var_theta + sigma^2) about the median m of the draws."""
    half = norm.ppf(QUANTILES[-1]) * np.sqrt(model.var(axis=0) + noise_std**2)
    median = np.median(model, axis=0)
    return np.stack([median - half, median, median + half])


def beside(
    dim: str,
    measured: NDArray[np.float64],
    model: Float[np.ndarray, "draw value"],
    noise_std: float | NDArray[np.float64] | None,
    unit: Mapping[str, str],
) -> dict[str, Any]:
    """Return measured values with the model's band and, if known, the band including noise."""
    dims = ("quantile", dim)
    variables = {"measured": (dim, measured, unit), "model_band": (dims, band(model), unit)}
    if noise_std is not None:
        variables["predictive_band"] = (dims, gaussian_band(model, noise_std), unit)
    return variables


def phase_near(h: NDArray[Any], reference: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a phase within half a turn of `reference`, so that bands do not jump at +-pi."""
    return reference + np.angle(h * np.exp(-1j * reference))


def polar(
    name: str,
    values: NDArray[Any],
    reference: NDArray[np.float64],
    magnitude: Mapping[str, str],
    phase: Mapping[str, str],
    dims: str | tuple[str, ...] = ("quantile", "freq"),
) -> dict[str, Any]:
    """Return the magnitude and phase of complex values, or of their bands, as named variables.

    The phase is on the branch next to a reference. Bands are given if `dims` contain `quantile`.
    """
    size, angle = np.abs(values), phase_near(values, reference)
    if "quantile" in dims:
        size, angle = band(size), band(angle)
    return {f"{name}_magnitude": (dims, size, magnitude), f"{name}_phase": (dims, angle, phase)}
