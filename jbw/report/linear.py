"""The linear regime, and what the frequency response does when the level rises."""

from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.axes import Axes

from jbw.report.result import (
    beside,
    branch,
    fitted_text,
    frequency,
    level_text,
    quantiles,
    tests,
    unit_of,
    wrap_band,
    wrap_degrees,
)
from jbw.report.style import (
    BAND,
    INK,
    LEVELS,
    MODEL,
    REPEATS,
    Panels,
    legend,
    log_y,
    panels,
    plain,
    shade,
    stacks,
    title,
)
from jbw.report.text import axis_label, number


def resonance_window(
    freq: Float[np.ndarray, " freq"], magnitude: Float[np.ndarray, " freq"], depth: float = 0.08
) -> tuple[float, float]:
    """Return the frequencies [Hz] around the peak where the magnitude exceeds `depth` of it."""
    peak = int(np.nanargmax(magnitude))
    above = magnitude > depth * magnitude[peak]
    left = peak - int(np.argmin(above[peak::-1])) if not above[: peak + 1].all() else 0
    right = peak + int(np.argmin(above[peak:])) if not above[peak:].all() else freq.size - 1
    return float(freq[left]), float(freq[right])


def linear_frf(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Draw the linear FRF, its line fit and its coherence; right, the resonance alone.

    Panels, in reading order: magnitude, phase, coherence, each full and zoomed (6 axes).
    """
    line = branch(
        tree, "steps/linear", "h_magnitude", "h_phase", "coherence", "fit_magnitude", "fit_phase"
    )
    freq, magnitude = frequency(line), np.asarray(line["h_magnitude"], float)
    peak = freq[int(np.nanargmax(magnitude))]
    wide = (max(freq[0], peak / 6.0), min(freq[-1], 3.0 * peak))
    near = resonance_window(freq, magnitude, depth=0.25)
    axes = panels(ax, 3, 2, height=5.4, sharex="col", sharey="row", height_ratios=[2, 1.3, 1])
    for column, window in enumerate((wide, near)):
        shown = (freq >= window[0]) & (freq <= window[1])
        _linear_column(axes[:, column], line.isel({line["h_magnitude"].dims[0]: shown}), column)
        axes[2, column].set(xlabel="frequency [Hz]", xlim=window)
    unit = unit_of(line["h_magnitude"])
    axes[0, 0].set(yscale="log", ylabel=axis_label("receptance", unit))
    title(axes[0, 0], "around the mode")
    title(axes[0, 1], "at the resonance")
    axes[1, 0].set(ylabel="phase [°]", yticks=[-180, -90, 0])
    axes[2, 0].set(ylabel="coherence [-]", ylim=(0.0, 1.05))
    legend(axes, ax)
    return axes


def _linear_column(column: Panels, line: xr.Dataset, zoomed: int) -> None:
    """Draw magnitude, phase and coherence of the pooled estimate into one column."""
    freq = frequency(line)
    look = {"marker": ".", "ms": 2.5, "lw": 0} if zoomed else {"lw": 0.7}
    measured = {"color": INK, **look}
    # The measured points lie on the fit, so the fit is the wider of the two and below.
    fit = {"color": MODEL, "lw": 3.0, "alpha": 0.6, "zorder": 1.5}
    label = None if zoomed else "measured, pooled over the repeats"
    column[0].plot(freq, line["h_magnitude"], label=label, **measured)
    column[0].plot(freq, line["fit_magnitude"], label="line fit", **fit)
    column[1].plot(freq, wrap_degrees(line["h_phase"]), **measured)
    column[1].plot(freq, wrap_degrees(line["fit_phase"]), **fit)
    column[2].plot(freq, line["coherence"], **measured)


def softening(tree: xr.DataTree, ax: Axes | None = None) -> Axes:
    """Draw the measured FRF magnitude of every level around the resonance, its peak marked."""
    found = tests(tree, "verification/frf", "measured_magnitude")
    axes = panels(ax, 1, 1, height=3.3)
    only: Axes = axes[0, 0]
    lines = [(frequency(test), _mean_magnitude(test)) for _, test in found]
    windows = np.array([resonance_window(*line) for line in lines])
    low, high = windows[:, 0].min(), windows[:, 1].max()
    for (_, test), line, colour in zip(found, lines, LEVELS * len(found), strict=False):
        shown = (line[0] >= low) & (line[0] <= high)
        freq, magnitude = (each[shown] for each in line)
        peak = int(np.nanargmax(magnitude))
        only.plot(freq, magnitude, color=colour, lw=1.1, label=_level_label(test, freq[peak]))
        only.plot(freq[peak], magnitude[peak], "v", color=colour, ms=5)
    unit = unit_of(found[0][1]["measured_magnitude"])
    log_y(only)
    only.set(xlim=(low, high), xlabel="frequency [Hz]")
    only.set_ylabel(axis_label("receptance", unit))
    legend(axes, ax)
    return only


def _mean_magnitude(test: xr.Dataset) -> Float[np.ndarray, " freq"]:
    """Return the magnitude averaged over the repeats."""
    return np.asarray(test["measured_magnitude"].mean("repeat"), float)


def _level_label(test: xr.Dataset, peak: float) -> str:
    """Return a test's level, kind and peak frequency for the legend."""
    kind = plain(test.attrs.get("kind", ""))
    return f"{level_text(test)} {kind}, peak at {number(peak, digits=4)} Hz"


def verification_frf(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Draw measured FRFs with the range of their repeats against the model's 99 % band.

    Panels: for each test a column of magnitude, phase, and magnitude over the model's median
    (3 axes a test, row by row).
    """
    found = tests(
        tree,
        "verification/frf",
        *("measured_magnitude", "measured_phase", "model_magnitude", "model_phase"),
    )
    axes, stack = stacks(ax, len(found), 3, height=5.0, height_ratios=[2, 1, 1.2])
    for column, (_, test) in zip(stack, found, strict=True):
        _frf_column(column, test)
    unit = unit_of(found[0][1]["measured_magnitude"])
    labels = (axis_label("receptance", unit), "phase [°]", "over median [-]")
    for row, each in enumerate(axes[:, 0]):
        each.set_ylabel(labels[row % 3])
    legend(axes, ax)
    return axes


def _frf_column(column: Panels, test: xr.Dataset) -> None:
    """Draw one test: repeats as a range, their mean, the model's band and median."""
    low, high = resonance_window(frequency(test), _mean_magnitude(test), depth=0.05)
    freq = frequency(test)
    dim = next(name for name in ("freq", "freq_hz") if name in test.dims)
    test = test.isel({dim: np.flatnonzero((freq >= low) & (freq <= high))})
    magnitude = np.asarray(test["measured_magnitude"].transpose("repeat", ...), float)
    phase = np.asarray(test["measured_phase"].transpose("repeat", ...), float)
    band = quantiles(test, "model_magnitude")
    turned = wrap_band(quantiles(test, "model_phase"))
    phase = beside(phase, turned[1])
    for each, repeats, model in zip(
        column,
        (magnitude, phase, magnitude / band[1]),
        (band, turned, band / band[1]),
        strict=True,
    ):
        _frf_panel(each, frequency(test), repeats, model)
    log_y(column[0])
    column[1].set(ylim=(-230, 50), yticks=[-180, -90, 0])
    column[2].set(xlabel="frequency [Hz]")
    what = f"{level_text(test)} {plain(test.attrs.get('kind', ''))}"
    title(column[0], ", ".join(filter(None, (what, fitted_text(test)))))


def _frf_panel(
    ax: Axes,
    freq: Float[np.ndarray, " freq"],
    repeats: Float[np.ndarray, "repeat freq"],
    model: Float[np.ndarray, "quantile freq"],
) -> None:
    """Draw one quantity of one test."""
    if len(repeats) > 1:
        least, most = repeats.min(axis=0), repeats.max(axis=0)
        shade(ax, freq, least, most, REPEATS, "range of all repeats", alpha=0.5)
    ax.plot(freq, repeats.mean(axis=0), color=INK, lw=0.8, label="mean of the repeats")
    shade(ax, freq, model[0], model[2], MODEL, BAND + " of the model", alpha=0.45)
    ax.plot(freq, model[1], color=MODEL, lw=0.9, ls="--", label="median of the model")
    ax.margins(x=0)
