"""Measured free decays against the model: the motion, its frequency and its damping."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from jbw.report.linear import BAND
from jbw.report.result import branch, tests
from jbw.report.style import (
    INK,
    MODEL,
    PREDICTIVE,
    SKY,
    SOFT,
    Panels,
    legend,
    panels,
    plain,
    shade,
    title,
)
from jbw.report.sweep import extremes, short
from jbw.report.text import axis_label, percent

MOST = 6
"""Records drawn: the first held-out ones, then the fitted ones."""
PERIODS = 6
PERCENT = 100.0
MEASURED = "measured, in the band"
BANDS = {"predictive_band": "99 % predictive band (noise included)", "model_band": BAND}
COLOURS = {"predictive_band": PREDICTIVE, "model_band": MODEL}


def verification_decay(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Draw decays with their bands: whole, some late periods, and what the model leaves.

    Panels: for each record a row of three (3 axes a record), held-out records first, 6 at most.
    """
    found = tests(tree, "verification/decay", "measured", "model_band", "predictive_band")
    ordered = sorted(found, key=lambda test: int(test[1].attrs.get("fitted", 1)))[:MOST]
    axes = panels(ax, len(ordered), 3, height=0.7 + 1.5 * len(ordered))
    for (whole, zoom, rest), (name, test) in zip(axes, ordered, strict=True):
        _whole(whole, test)
        _periods(zoom, test.isel(time=_late(test)))
        _left(rest, test)
        unit = str(test["measured"].attrs.get("units", ""))
        whole.set_ylabel(axis_label(plain(test.attrs.get("response", "response")), unit))
        known = "fitted" if int(test.attrs.get("fitted", 1)) else "held out"
        title(whole, f"{short(plain(name))}, {known}", size=8)
        title(zoom, "some late periods", size=8)
        title(rest, f"left by the model: {percent(test.attrs.get('nrmse'), 2)}", size=8)
    for each in axes[-1]:
        each.set_xlabel("time [s]")
    legend(axes, ax)
    return axes


def _whole(ax: Axes, test: xr.Dataset) -> None:
    """Draw the record as filled extremes with the model's outline."""
    time, measured = (np.asarray(test[name], float) for name in ("time", "measured"))
    at, least, most = extremes(time, measured, measured, 300)
    shade(ax, at, least, most, INK, MEASURED, alpha=0.6)
    low, _, high = np.asarray(test["model_band"].transpose("quantile", "time"), float)
    at, least, most = extremes(time, low, high, 300)
    for edge in (least, most):
        ax.plot(at, edge, color=MODEL, lw=0.9)
    ax.lines[-1].set_label("outline of the model")
    _mark_seen(ax, test)
    ax.margins(x=0)


def _periods(ax: Axes, part: xr.Dataset) -> None:
    """Draw the motion and its bands point by point."""
    time = np.asarray(part["time"], float)
    for name, colour in COLOURS.items():
        low, _, high = np.asarray(part[name].transpose("quantile", "time"), float)
        shade(ax, time, low, high, colour, BANDS[name], alpha=0.5)
    ax.plot(time, np.asarray(part["measured"], float), color=INK, lw=0.8)
    ax.margins(x=0)
    ax.locator_params(axis="x", nbins=3)


def _left(ax: Axes, test: xr.Dataset) -> None:
    """Draw what is left of the record, and the bands, less the model's median."""
    time = np.asarray(test["time"], float)
    median = np.asarray(test["model_band"].isel(quantile=1), float)
    for name, colour in COLOURS.items():
        low, _, high = np.asarray(test[name].transpose("quantile", "time"), float) - median
        at, least, most = extremes(time, low, high, 300)
        shade(ax, at, least, most, colour, BANDS[name], alpha=0.5)
    left = np.asarray(test["measured"], float) - median
    at, least, most = extremes(time, left, left, 300)
    shade(ax, at, least, most, INK, MEASURED, alpha=0.6)
    _mark_seen(ax, test)
    ax.margins(x=0)


def _mark_seen(ax: Axes, test: xr.Dataset) -> None:
    """Mark until where a held-out record gave its initial state."""
    seen = float(test.attrs.get("seen_s", 0.0))
    if seen > 0:
        ax.axvline(float(test["time"][0]) + seen, color=SOFT, lw=0.8, ls="--")


def _late(test: xr.Dataset) -> slice:
    """Return some periods at two thirds of a record, where an error of frequency has built up."""
    measured = np.asarray(test["measured"], float)
    middle = 2 * measured.size // 3
    near = measured[middle : middle + max(64, measured.size // 20)]
    crossings = max(1, np.count_nonzero(np.diff(np.signbit(near))))
    return slice(middle, middle + int(2 * PERIODS * near.size / crossings))


def amplitude_curves(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Draw frequency and damping against amplitude, read from the records and of the model.

    Panels: frequency, damping.
    """
    found = branch(
        tree,
        "verification/amplitude",
        "measured_amplitude",
        "measured_frequency",
        "measured_damping",
        "model_frequency",
        "model_damping",
    )
    axes = panels(ax, 1, 2, height=3.2)
    amplitude = np.asarray(found["amplitude"], float)
    fitted = np.asarray(found["fitted"], int) if "fitted" in found else None
    for each, name, factor, label in (
        (axes[0, 0], "frequency", 1.0, axis_label("frequency", "Hz")),
        (axes[0, 1], "damping", PERCENT, axis_label("damping ratio", "%")),
    ):
        low, middle, high = factor * np.asarray(
            found[f"model_{name}"].transpose("quantile", "amplitude"), float
        )
        shade(each, amplitude, low, high, MODEL, BAND, alpha=0.4)
        each.plot(amplitude, middle, color=MODEL, lw=1.0)
        for i in range(found.sizes["record"]):
            known = fitted is None or bool(fitted[i])
            each.plot(
                np.asarray(found["measured_amplitude"][i], float),
                factor * np.asarray(found[f"measured_{name}"][i], float),
                ".",
                color=INK if known else SKY,
                ms=4,
                label="fitted records" if known else "held-out records",
            )
        unit = str(found["amplitude"].attrs.get("units", ""))
        response = plain(found["amplitude"].attrs.get("long_name", "response"))
        each.set_xlabel(axis_label(f"amplitude of {response}", unit))
        each.set_ylabel(label)
    legend(axes, ax)
    return axes
