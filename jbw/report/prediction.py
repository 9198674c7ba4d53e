"""Figures of predicted tests, one per test, with measured values if there are any."""

from collections.abc import Callable, Iterator
from itertools import product
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from jbw.report import style
from jbw.report.loops import verification_loops
from jbw.report.records import (
    draw_record,
    resonance_slice,
    response_label,
    short,
    verification_decay,
    verification_multisine,
    verification_sweep,
)
from jbw.report.responses import verification_curves, verification_groups
from jbw.report.result import level_text, near_branch, quantiles, unit_of, unwrapped_band
from jbw.report.style import Panels, finish, log_y, panels, shade, title
from jbw.report.text import axis_label, plain
from jbw.results.attributes import PredictedTest, StoredVariable

# for each figure of the report: the variables that it needs, and the group that it uses
FIGURES: tuple[tuple[set[str], str, Callable[..., Panels]], ...] = (
    ({"measured", "error_spectrum"}, "multisine", verification_multisine),
    ({"measured_force", "model_force"}, "loop", verification_loops),
    ({"measured", "measured_band", "model_band", "predictive_band"}, "sweep", verification_sweep),
)
LOOKS = {
    "predictive": (style.PREDICTIVE, 9.0),
    "model": (style.MODEL, 4.0),
}


def prediction(name: str, dataset: xr.Dataset) -> Panels:
    """Draw the bands of a predicted test; use the report's figure for tests of this kind.

    The bands are the result of `jbw.verification.predict`.
    """
    if "axis" in dataset.attrs:
        apart = {name: dataset}
        if "unit" in dataset.coords:  # Groups in several units cannot share an axis.
            apart = dict(_groups(dataset))
        return verification_groups(_tree(PredictedTest.of(dataset).kind, apart))
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
    """Return a result tree that contains only the given predictions."""
    safe = {name.replace("/", "\N{DIVISION SLASH}"): dataset for name, dataset in datasets.items()}
    return xr.DataTree.from_dict(
        {f"/verification/{group}/{n}": dataset for n, dataset in safe.items()}
    )


def _groups(dataset: xr.Dataset) -> Iterator[tuple[str, xr.Dataset]]:
    """Yield every data group of a test with its label and its unit."""
    for label, group in dataset.groupby("group"):
        unit = {"units": str(group["unit"].values[0])}
        yield str(label), group.assign({n: x.assign_attrs(unit) for n, x in group.items()})


def _records(name: str, dataset: xr.Dataset) -> Iterator[tuple[str, xr.Dataset]]:
    """Yield the records of a test of decays, each cut to its valid samples."""
    for i in range(dataset.sizes["record"]):
        record = dataset.isel(record=i).dropna("time", subset=["measured"])
        yield f"{name} {i + 1}", record.assign_attrs(nrmse=float(record["nrmse_of_record"]))


def _in_time(name: str, dataset: xr.Dataset) -> Panels:
    axes = panels(None, 1, 2, height=2.6)
    full, zoom = axes[0]
    near = dataset.isel(time=resonance_slice(quantiles(dataset, "model_band")[1]))
    draw_record(full, dataset, count=500)
    draw_record(zoom, near, measured="measured")
    middle = quantiles(near, "model_band")[1]
    zoom.plot(near["time"], middle, color=style.MODEL, lw=0.8, ls="--", label="median of the model")
    full.set_ylabel(response_label(dataset, "model_band"))
    title(full, short(plain(name), 32), size=8)
    title(zoom, "at the largest response", size=8)
    return finish(axes, None, "time [s]")


def _over_frequency(name: str, dataset: xr.Dataset) -> Panels:
    suffixes = [s for s in ("", "_3") if f"model_magnitude{s}" in dataset]
    axes = panels(None, 2, len(suffixes), height=4.2, sharex="col", height_ratios=[1.6, 1])
    for (upper, lower), suffix in zip(axes.T, suffixes, strict=True):
        values = dataset[f"model_magnitude{suffix}"]
        phase = unwrapped_band(quantiles(dataset, f"model_phase{suffix}"))[1]
        panels_of = {"magnitude": upper, "phase": lower}
        for kind, what in product(("predictive", "model", "measured"), panels_of):
            if f"{kind}_{what}{suffix}" in dataset:
                shown = np.asarray(dataset[f"{kind}_{what}{suffix}"].transpose(..., "freq"), float)
                # All phases are shown within half a turn of the model's median.
                shown = near_branch(shown, phase) if what == "phase" else shown
                label = style.band_label(dataset.attrs, noise=kind == "predictive")
                _harmonic(panels_of[what], kind, dataset["freq"], shown, label)
        if dataset.sizes["freq"] > 1:
            log_y(upper)
        what = plain(StoredVariable.of(values).long_name or "response")
        title(upper, f"{what} at {suffix.removeprefix('_')}ω, {level_text(dataset)}", size=8)
        upper.set_ylabel(axis_label("amplitude", unit_of(values)))
        lower.set_ylabel("phase [°]")
    return finish(axes, None, "frequency [Hz]")


def _harmonic(ax: Axes, kind: str, freq: Any, values: Any, label: str) -> None:
    """Draw one quantity of a harmonic: bands (bars at a single frequency) or measured points."""
    if kind == "measured":
        ax.plot(freq, values, "o", color=style.INK, ms=4, mfc="none", label="measured")
        return
    colour, width = LOOKS[kind]
    low, middle, high = values
    if freq.size == 1:
        ax.vlines(freq, low, high, color=colour, lw=width, alpha=0.6, label=label)
    else:
        shade(ax, freq, low, high, colour, label, alpha=0.5)
    ax.plot(freq, middle, color=style.MODEL, lw=1.0, marker="_" if freq.size == 1 else "")
