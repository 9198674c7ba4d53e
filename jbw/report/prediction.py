"""Predictions of a run: one figure a test, beside what was measured where something was."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from jbw.report.curves import verification_curves, verification_loops, verification_multisine
from jbw.report.decay import verification_decay
from jbw.report.linear import BAND, level_text
from jbw.report.phase import beside, unwrapped_band
from jbw.report.style import (
    INK,
    MODEL,
    PREDICTIVE,
    Panels,
    legend,
    log_y,
    panels,
    plain,
    shade,
    title,
)
from jbw.report.sweep import extremes, resonance_slice, short, verification_sweep
from jbw.report.text import axis_label, unit_text

PREDICTIVE_LABEL = "99 % predictive band (noise included)"
SWEEP = {"measured", "measured_band", "model_band", "predictive_band"}
# Variables that a figure of the report needs, the group it reads, and the figure.
FIGURES: tuple[tuple[set[str], str, Callable[..., Panels]], ...] = (
    ({"measured", "error_spectrum"}, "multisine", verification_multisine),
    ({"measured_force", "model_force"}, "loop", verification_loops),
    (SWEEP, "sweep", verification_sweep),
)


def prediction(name: str, dataset: xr.Dataset) -> Panels:
    """Draw a test's bands, by the figure of the report that shows such a test.

    Args:
        name: Name of the test.
        dataset: From `jbw.study.predicting.predict`.
    """
    variables = set(map(str, dataset.data_vars))
    if "record" in dataset.dims:
        if {"measured", "predictive_band"} <= variables:
            return verification_decay(_tree("decay", dict(_records(name, dataset))))
        dataset = next(_records(name, dataset))[1]
    for needed, group, draw in FIGURES:
        if needed <= variables and "record" not in dataset.dims:
            return draw(_tree(group, {name: dataset}))
    if "time" in dataset.dims:
        return _in_time(name, dataset)
    if "measured_magnitude" in variables and dataset.sizes["freq"] > 1:
        return verification_curves(_tree("curve", {name: dataset}))
    return _over_frequency(name, dataset)


def _tree(group: str, datasets: dict[str, xr.Dataset]) -> xr.DataTree:
    """A result that holds nothing but these."""
    safe = {name.replace("/", "\N{DIVISION SLASH}"): one for name, one in datasets.items()}
    return xr.DataTree.from_dict({f"/verification/{group}/{n}": one for n, one in safe.items()})


def _records(name: str, dataset: xr.Dataset) -> Iterator[tuple[str, xr.Dataset]]:
    """The records of a test of decays, each without what fills it up."""
    for i in range(dataset.sizes["record"]):
        one = dataset.isel(record=i).dropna("time", subset=["measured"])
        yield f"{name} {i + 1}", one.assign_attrs(nrmse=float(one["nrmse_of_record"]))


def _in_time(name: str, dataset: xr.Dataset) -> Panels:
    """Draw what bands there are: whole, and at the resonance."""
    axes = panels(None, 1, 2, height=2.6)
    whole, zoom = axes[0]
    median = np.asarray(dataset["model_band"].transpose("quantile", "time"), float)[1]
    near = dataset.isel(time=resonance_slice(median))
    for ax, part, count in ((whole, dataset, 500), (zoom, near, None)):
        _bands(ax, part, count)
        ax.set_xlabel("time [s]")
        ax.margins(x=0)
    unit = str(dataset["model_band"].attrs.get("units", ""))
    whole.set_ylabel(axis_label(plain(dataset.attrs.get("response", "response")), unit))
    title(whole, f"{short(plain(name), 32)}", size=8)
    title(zoom, "at the largest response", size=8)
    legend(axes, None)
    return axes


def _bands(ax: Axes, part: xr.Dataset, count: int | None) -> None:
    """Draw bands and measured response, as extremes of `count` stretches where it is long."""
    time = np.asarray(part["time"], float)
    for variable, colour, label in (
        ("predictive_band", PREDICTIVE, PREDICTIVE_LABEL),
        ("model_band", MODEL, BAND),
    ):
        if variable in part:
            low, _, high = np.asarray(part[variable].transpose("quantile", "time"), float)
            shade(ax, *_shown(time, low, high, count), colour, label, alpha=0.5)
    if count is None:
        middle = np.asarray(part["model_band"].isel(quantile=1), float)
        ax.plot(time, middle, color=MODEL, lw=0.8, ls="--", label="median of the model")
    if "measured" in part:
        measured = np.asarray(part["measured"], float)
        if count is None:
            ax.plot(time, measured, color=INK, lw=0.8, label="measured")
        else:
            shade(ax, *_shown(time, measured, measured, count), INK, "_measured", alpha=0.6)


def _shown(time: Any, low: Any, high: Any, count: int | None) -> tuple[Any, Any, Any]:
    return (time, low, high) if count is None else extremes(time, low, high, count)


def _over_frequency(name: str, dataset: xr.Dataset) -> Panels:
    """Draw amplitude and phase of each harmonic with their bands, and what was measured."""
    suffixes = [s for s in ("", "_3") if f"model_magnitude{s}" in dataset]
    axes = panels(None, 2, len(suffixes), height=4.2, sharex="col", height_ratios=[1.6, 1])
    for column, suffix in zip(axes.T, suffixes, strict=True):
        values = dataset[f"model_magnitude{suffix}"]
        turned = _in_degrees(dataset, suffix)
        for ax, variable in zip(column, ("magnitude", "phase"), strict=True):
            _harmonic(ax, turned, f"{variable}{suffix}")
        if dataset.sizes["freq"] > 1:
            log_y(column[0])
        what = plain(values.attrs.get("long_name", "response"))
        title(column[0], f"{what} at {suffix.removeprefix('_')}ω, {level_text(dataset)}", size=8)
        unit = unit_text(str(values.attrs.get("units", "")))
        column[0].set_ylabel(axis_label("amplitude", unit))
        column[1].set(xlabel="frequency [Hz]", ylabel="phase [°]")
    legend(axes, None)
    return axes


def _in_degrees(dataset: xr.Dataset, suffix: str) -> xr.Dataset:
    """Return the phases of a harmonic in degrees, all within half a turn of the model's median."""
    model = dataset[f"model_phase{suffix}"].transpose("quantile", "freq")
    band = unwrapped_band(np.asarray(model, float))
    names = [f"{which}_phase{suffix}" for which in ("predictive", "measured")]
    others = {
        name: (dataset[name].dims, beside(np.asarray(dataset[name], float), band[1]))
        for name in names
        if name in dataset and dataset[name].dims[-1] == "freq"
    }
    return dataset.assign({f"model_phase{suffix}": (model.dims, band), **others})


def _harmonic(ax: Axes, dataset: xr.Dataset, variable: str) -> None:
    """Draw one quantity of a harmonic: bands, of a single frequency as bars, and marks."""
    freq = np.asarray(dataset["freq"], float)
    for prefix, colour, label, width in (
        ("predictive", PREDICTIVE, PREDICTIVE_LABEL, 9.0),
        ("model", MODEL, BAND, 4.0),
    ):
        if f"{prefix}_{variable}" not in dataset:
            continue
        band = dataset[f"{prefix}_{variable}"].transpose("quantile", "freq")
        low, middle, high = np.asarray(band, float)
        if freq.size == 1:
            ax.vlines(freq, low, high, color=colour, lw=width, alpha=0.6, label=label)
        else:
            shade(ax, freq, low, high, colour, label, alpha=0.5)
        ax.plot(freq, middle, color=MODEL, lw=1.0, marker="_" if freq.size == 1 else "")
    if f"measured_{variable}" in dataset:
        measured = np.asarray(dataset[f"measured_{variable}"], float)
        ax.plot(freq, measured, "o", color=INK, ms=4, mfc="none", label="measured")
