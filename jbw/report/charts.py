"""What the interactive page shows: a run's responses, loops and curves as plotly's traces."""

import html
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float

from jbw.errors import DataError, printable
from jbw.report.loops import BACKBONE, MILLI, PERCENT, closed, length_unit, secant
from jbw.report.records import PREDICTIVE_LABEL
from jbw.report.responses import level_colours
from jbw.report.result import (
    beside,
    branch,
    fitted_text,
    frequency,
    node,
    quantiles,
    tests,
    unit_of,
    unwrapped_band,
    verified,
)
from jbw.report.style import BAND, INK, MODEL, PREDICTIVE, REPEATS
from jbw.report.text import axis_label

LONGEST = 12000  # samples of a record, around its largest: what a browser moves without stutter
HERTZ = "frequency [Hz]"
Trace = dict[str, Any]


class Chart(NamedTuple):
    """One interactive figure: labels of abscissa and ordinate, plotly's traces as dictionaries."""

    heading: str
    axes: tuple[str, str]
    lines: list[Trace]
    log: bool = False


def shown_text(name: object) -> str:
    """Return a name as plotly is to show it: its labels read a part of HTML, entities included."""
    return html.escape(printable(str(name)))


def line(x: Any, y: Any, name: str, colour: str, group: str = "", **more: Any) -> Trace:
    """Return a trace; numbers as 32-bit floats, half as large in the file.

    `name` is what the legend calls it, `group` what a click there hides with it; `more` are
    further keys of plotly's scatter trace.
    """
    values = {"x": np.asarray(x, np.float32), "y": np.asarray(y, np.float32)}
    look = {"type": "scatter", "mode": "lines", "line": {"color": colour, "width": 1.3}}
    together = {"legendgroup": shown_text(group)} if group else {}
    return {**values, **look, "name": shown_text(name), **together, **more}


def band(x: Any, low: Any, high: Any, name: str, colour: str, group: str) -> list[Trace]:
    """Return the two traces of a filled band; arguments as for `line`."""
    edge = {"line": {"width": 0}, "hoverinfo": "skip"}
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    fill = {"fill": "tonexty", "fillcolor": f"rgba({red},{green},{blue},0.3)"}
    return [
        line(x, low, name, colour, group, **edge, showlegend=False),
        line(x, high, name, colour, group, **edge, **fill),
    ]


def charts_of(tree: xr.DataTree) -> list[Chart]:
    """Return the charts that the result of a run allows."""
    found = []
    makers: tuple[Callable[[xr.DataTree], list[Chart]], ...] = (
        _frfs, _curves, _in_time, _loops, _forced_loops, _groups, _backbone,
    )  # fmt: skip
    for make in makers:
        try:
            found += make(tree)
        except DataError:
            # The campaign has no such tests.
            continue
    return found


def _called(name: str, test: xr.Dataset) -> str:
    return ", ".join(filter(None, (name, fitted_text(test))))


def _model(
    x: Any, values: Float[np.ndarray, "quantile point"], colour: str, called: str = ""
) -> list[Trace]:
    """Return the traces of a model's band and median; of several tests, under each one's name."""
    low, middle, high = values
    name, group = (f", {called}", called) if called else ("", "model")
    median = line(x, middle, f"median of the model{name}", colour, group)
    return [*band(x, low, high, f"{BAND}{name}", colour, group), median]


def _of_test(
    x: Any, model: Float[np.ndarray, "quantile point"], measured: Any, colour: str, called: str
) -> list[Trace]:
    """Return the traces of one test among several, hidden together by a click in the legend."""
    lines = [{**each, "showlegend": False} for each in _model(x, model, colour, called)]
    dots = {"mode": "markers", "marker": {"color": colour, "size": 5}}
    return [*lines, line(x, measured, f"measured, {called}", colour, called, **dots)]


def _frfs(tree: xr.DataTree) -> list[Chart]:
    """Return magnitudes of all frequency responses."""
    found = tests(tree, "verification/frf", "measured_magnitude", "model_magnitude")
    lines = []
    for (name, test), colour in zip(found, level_colours(len(found)), strict=True):
        mean = test["measured_magnitude"].mean("repeat")
        model = quantiles(test, "model_magnitude")
        lines += _of_test(frequency(test), model, mean, colour, _called(name, test))
    unit = unit_of(found[0][1]["measured_magnitude"])
    return [Chart("Frequency responses", (HERTZ, axis_label("receptance", unit)), lines, log=True)]


def _curves(tree: xr.DataTree) -> list[Chart]:
    """Return magnitude and phase of the response curves' first harmonics."""
    found = tests(tree, "verification/curve", "measured_magnitude", "model_magnitude")
    families: dict[str, list[tuple[str, xr.Dataset]]] = {}
    for name, test in found:
        families.setdefault(str(test.attrs.get("quantity", "")), []).append((name, test))
    charts = []
    for quantity, family in families.items():
        sizes, phases = [], []
        for (name, test), colour in zip(family, level_colours(len(family)), strict=True):
            called = _called(name, test)
            turned = unwrapped_band(quantiles(test, "model_phase"))
            phase = beside(np.asarray(test["measured_phase"], float), turned[1])
            model = quantiles(test, "model_magnitude")
            sizes += _of_test(frequency(test), model, test["measured_magnitude"], colour, called)
            phases += _of_test(frequency(test), turned, phase, colour, called)
        heading = f"Response curves: {quantity}".removesuffix(": ")
        unit = unit_of(family[0][1]["measured_magnitude"])
        charts.append(Chart(heading, (HERTZ, axis_label("amplitude", unit)), sizes, log=True))
        charts.append(Chart(f"{heading}, phase", (HERTZ, "phase [°]"), phases))
    return charts


def _in_time(tree: xr.DataTree) -> list[Chart]:
    """Return a chart for every record against its bands, around its largest response."""
    needed = ("measured", "model_band", "predictive_band")
    return [
        _record(f"{called} {_called(name, test)}", test)
        for group, called in (("sweep", "Sweep"), ("decay", "Free decay"))
        if node(tree, f"verification/{group}") is not None
        for name, test in tests(tree, f"verification/{group}", *needed)
    ]


def _record(heading: str, test: xr.Dataset) -> Chart:
    """Return the chart of one record, around its largest response as long as a browser bears."""
    start = int(np.nanargmax(np.abs(test["measured"]))) - LONGEST // 2
    start = max(0, min(start, test.sizes["time"] - LONGEST))
    part = test.isel(time=slice(start, start + LONGEST))
    time = np.asarray(part["time"], float)
    low, _, high = quantiles(part, "predictive_band")
    lines = band(time, low, high, PREDICTIVE_LABEL, PREDICTIVE, "noise")
    lines += _model(time, quantiles(part, "model_band"), MODEL)
    lines.append(line(time, part["measured"], "measured", INK))
    response = str(test.attrs.get("response", "response"))
    return Chart(heading, ("time [s]", axis_label(response, unit_of(test["measured"]))), lines)


def _loops(tree: xr.DataTree) -> list[Chart]:
    """Return the loops of all levels, less their secants, which leaves their areas."""
    found = tests(tree, "validation/loops", "measured_y", "measured_force", "model_force")
    charts = []
    for name, test in found:
        y, measured = (np.asarray(test[f"measured_{key}"], float) for key in ("y", "force"))
        model_y, force = quantiles(test, "model_y")[1], quantiles(test, "model_force")
        slope = secant(y, measured)
        lines = [
            line(*closed(MILLI * x, values - slope * x), called, colour)
            for x, values, called, colour in (
                (model_y, force[0], f"{BAND}, lower edge", PREDICTIVE),
                (model_y, force[2], f"{BAND}, upper edge", REPEATS),
                (model_y, force[1], "median of the model", MODEL),
                (y, measured, "measured", INK),
            )
        ]
        axes = ("displacement [mm]", "restoring force less its secant [N/kg]")
        charts.append(Chart(f"Hysteresis loop {name}", axes, lines))
    return charts


def _forced_loops(tree: xr.DataTree) -> list[Chart]:
    """Return the forced loops, one chart a test."""
    charts = []
    for name, test in tests(tree, "verification/loop", "displacement", "model_force"):
        y = MILLI * np.asarray(test["displacement"], float)
        lines = [
            line(y, quantiles(test, "model_force")[1], "median of the model", MODEL),
            line(y, test["measured_force"], "measured", INK),
        ]
        axes = ("displacement [mm]", axis_label("restoring force", unit_of(test["measured_force"])))
        charts.append(Chart(f"Forced loop {_called(name, test)}", axes, lines))
    return charts


def _groups(tree: xr.DataTree) -> list[Chart]:
    """Return tests of further kinds over their own coordinate, a chart a group of values."""
    charts = []
    for _, name, test in verified(tree, "axis"):
        axis = str(test.attrs["axis"])
        for label, group in test.groupby("group"):
            one = group.sortby(axis)
            place = np.asarray(one[axis], float)
            called = _called(name, test)
            lines = _of_test(place, quantiles(one, "model_band"), one["measured"], MODEL, called)
            kind = str(test.attrs.get("kind", "response")).replace("_", " ")
            across = axis_label(axis, unit_of(one[axis]))
            axes = (across, axis_label(kind, unit_of(one["measured"])))
            charts.append(Chart(f"{kind.capitalize()} {label}", axes, lines))
    return charts


def _backbone(tree: xr.DataTree) -> list[Chart]:
    """Return natural frequency and damping against amplitude."""
    found = branch(tree, BACKBONE, "frequency", "damping")
    factor, unit = length_unit(float(found.attrs["y_fitted"]))
    charts = []
    for name, scale, label in (
        ("frequency", 1.0, "natural frequency [Hz]"),
        ("damping", PERCENT, "equivalent damping ratio [%]"),
    ):
        lines = _model(factor * found["amplitude"], scale * quantiles(found, name), MODEL)
        axes = (axis_label("amplitude of displacement", unit), label)
        charts.append(Chart(f"Backbone: {name}", axes, lines))
    return charts
