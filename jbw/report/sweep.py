"""Measured sweeps against what the posterior predicts."""

from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.axes import Axes
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from jbw.report.linear import BAND, fitted_text, level_text
from jbw.report.result import tests
from jbw.report.style import (
    INK,
    MODEL,
    PREDICTIVE,
    REPEATS,
    Panels,
    legend,
    panels,
    plain,
    shade,
    title,
)
from jbw.report.text import axis_label

COLUMNS = 1000
"""Extremes drawn of a full record: as many as the figure has points across."""


def verification_sweep(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Draw each sweep with its bands: whole, at the resonance, and there less the model's median.

    Panels: for each test a row of three (3 axes a test).
    """
    found = tests(
        tree, "verification/sweep", "measured", "measured_band", "model_band", "predictive_band"
    )
    axes = panels(ax, len(found), 3, height=0.7 + 1.75 * len(found))
    for (whole, zoom, rest), (name, test) in zip(axes, found, strict=True):
        part = test.isel(time=resonance_slice(np.asarray(test["measured"], float)))
        _whole(whole, test)
        _bands(zoom, part, 0.0)
        _bands(rest, part, np.asarray(part["model_band"].isel(quantile=1), float))
        unit = str(test["measured"].attrs.get("units", ""))
        whole.set_ylabel(axis_label(plain(test.attrs.get("response", "response")), unit))
        words = (short(plain(name)), level_text(test), fitted_text(test))
        title(whole, ", ".join(filter(None, words)), size=8)
        title(zoom, "at the resonance", size=8)
        title(rest, "less the model's median", size=8)
    for each in axes[-1]:
        each.set_xlabel("time [s]")
    legend(axes, ax)
    return axes


def short(name: str, most: int = 16) -> str:
    """Return a name that fits a panel's title."""
    return name if len(name) <= most else name[: most - 1] + "…"


def extremes(
    time: Float[np.ndarray, " time"],
    lower: Float[np.ndarray, " time"],
    upper: Float[np.ndarray, " time"],
    count: int = COLUMNS,
) -> tuple[Float[np.ndarray, " bin"], Float[np.ndarray, " bin"], Float[np.ndarray, " bin"]]:
    """Return the least of `lower` and the largest of `upper` in each of `count` stretches."""
    size = max(1, -(-time.size // count))
    starts = np.arange(0, time.size, size)
    least, most = np.minimum.reduceat(lower, starts), np.maximum.reduceat(upper, starts)
    return time[np.minimum(starts + size // 2, time.size - 1)], least, most


def _whole(ax: Axes, test: xr.Dataset) -> None:
    """Draw the record as filled extremes, and the outline of the predictive band."""
    time, measured = (np.asarray(test[name], float) for name in ("time", "measured"))
    at, least, most = extremes(time, measured, measured)
    repeats = "repeats not fitted" if "fitted" in test.attrs else "repeats"
    shade(ax, at, least, most, INK, f"measured, mean of the {repeats}", alpha=0.75)
    low, _, high = np.asarray(test["predictive_band"].transpose("quantile", "time"), float)
    reach = max(3, time.size // 96)
    outline = (minimum_filter1d(low, reach), maximum_filter1d(high, reach))
    shown = slice(None, None, max(1, reach // 4))
    for edge in outline:
        ax.plot(time[shown], edge[shown], color=MODEL, lw=0.9)
    ax.lines[-1].set_label("outline of the 99 % predictive band")
    ax.margins(x=0)


def _bands(ax: Axes, part: xr.Dataset, less: Float[np.ndarray, " time"] | float) -> None:
    """Draw the measured response and its bands point by point, `less` taken off all of them."""
    time = np.asarray(part["time"], float)
    for name, colour, label in (
        ("predictive_band", PREDICTIVE, "99 % predictive band (noise included)"),
        ("measured_band", REPEATS, "99 % band of the repeats"),
        ("model_band", MODEL, BAND),
    ):
        low, _, high = np.asarray(part[name].transpose("quantile", "time"), float)
        shade(ax, time, low - less, high - less, colour, label, alpha=0.5)
    ax.plot(time, np.asarray(part["measured"], float) - less, color=INK, lw=0.8)
    ax.margins(x=0)
    ax.locator_params(axis="x", nbins=4)


def resonance_slice(measured: Float[np.ndarray, " time"], periods: int = 6) -> slice:
    """Return the samples of some `periods` of the response around its largest swing."""
    peak = int(np.nanargmax(np.abs(measured)))
    reach = max(16, measured.size // 40)
    start, stop = max(0, peak - reach), min(measured.size, peak + reach)
    near = measured[start:stop]
    crossings = np.count_nonzero(np.diff(np.signbit(near)))
    half = int(periods * near.size / max(crossings, 1))
    return slice(max(0, peak - half), min(measured.size, peak + half))
