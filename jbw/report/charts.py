"""What the interactive page shows: a run's responses, loops and curves as plotly's traces."""

import html
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float

from jbw.errors import DataError, printable
from jbw.report.backbone import GROUP, PERCENT, length_unit
from jbw.report.curves import level_colours
from jbw.report.loops import MILLI
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
PREDICTIVE_LABEL = "99 % predictive band (noise included)"
Pair = tuple[Any, Any]


class Chart(NamedTuple):
    """One interactive figure.

    Args:
        heading: What it shows.
        axes: Labels of abscissa and ordinate.
        lines: plotly's traces, as dictionaries.
        log: Whether the ordinate is logarithmic.
    """

    heading: str
    axes: tuple[str, str]
    lines: list[dict[str, Any]]
    log: bool = False


def shown_text(name: object) -> str:
    """Return a name as plotly is to show it: its labels read a part of HTML, entities included."""
    return html.escape(printable(str(name)))


def line(x: Any, y: Any, name: str, colour: str, **more: Any) -> dict[str, Any]:
    """Return a trace; numbers as 32-bit floats, half as large in the file.

    Args:
        x: Abscissae.
        y: Ordinates.
        name: What the legend calls it.
        colour: Its colour.
        **more: Further keys of plotly's scatter trace.
    """
    values = {"x": np.asarray(x, np.float32), "y": np.asarray(y, np.float32)}
    look = {"type": "scatter", "mode": "lines", "line": {"color": colour, "width": 1.3}}
    return {**values, **look, "name": shown_text(name), **more}


def band(x: Any, low: Any, high: Any, name: str, colour: str, group: str) -> list[dict[str, Any]]:
    """Return the two traces of a filled band; arguments as for `line`."""
    edge = {"line": {"width": 0}, "hoverinfo": "skip", "legendgroup": shown_text(group)}
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    fill = {"fill": "tonexty", "fillcolor": f"rgba({red},{green},{blue},0.3)"}
    return [
        line(x, low, name, colour, **edge, showlegend=False),
        line(x, high, name, colour, **edge, **fill),
    ]


def unlisted(lines: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return traces that the legend leaves out: they go with the one that it names."""
    return [{**each, "showlegend": False} for each in lines]


def charts_of(tree: xr.DataTree) -> list[Chart]:
    """Return the charts that a result allows.

    Args:
        tree: The run's posterior.nc.
    """
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
) -> list[dict[str, Any]]:
    """Return the traces of a model's band and median; of several tests, under each one's name."""
    low, middle, high = values
    name, group = (f", {called}", called) if called else ("", "model")
    median = line(x, middle, f"median of the model{name}", colour, legendgroup=shown_text(group))
    return [*band(x, low, high, f"{BAND}{name}", colour, group), median]


def _of_test(
    freq: Any, model: Float[np.ndarray, "quantile freq"], measured: Any, colour: str, called: str
) -> list[dict[str, Any]]:
    """Return the traces of one test among several: a click in the legend hides all of them."""
    look = {"mode": "markers", "marker": {"color": colour, "size": 5}}
    dots = line(
        freq, measured, f"measured, {called}", colour, legendgroup=shown_text(called), **look
    )
    return [*unlisted(_model(freq, model, colour, called)), dots]


def _frfs(tree: xr.DataTree) -> list[Chart]:
    """Return magnitudes of all frequency responses."""
    found = tests(tree, "verification/frf", "measured_magnitude", "model_magnitude")
    lines = []
    for (name, test), colour in zip(found, level_colours(len(found)), strict=True):
        mean = np.asarray(test["measured_magnitude"].mean("repeat"), float)
        model = quantiles(test, "model_magnitude")
        lines += _of_test(frequency(test), model, mean, colour, _called(name, test))
    unit = unit_of(found[0][1]["measured_magnitude"])
    axes = ("frequency [Hz]", axis_label("receptance", unit))
    return [Chart("Frequency responses", axes, lines, log=True)]


def _curves(tree: xr.DataTree) -> list[Chart]:
    """Return magnitude and phase of the response curves' first harmonics."""
    found = tests(tree, "verification/curve", "measured_magnitude", "model_magnitude")
    families: dict[str, list[tuple[str, xr.Dataset]]] = {}
    for name, test in found:
        families.setdefault(str(test.attrs.get("quantity", "")), []).append((name, test))
    charts = []
    for quantity, family in families.items():
        sizes, turns = [], []
        for (name, test), colour in zip(family, level_colours(len(family)), strict=True):
            freq, called = frequency(test), _called(name, test)
            model, turned = quantiles(test, "model_magnitude"), quantiles(test, "model_phase")
            turned = unwrapped_band(turned)
            phase = beside(np.asarray(test["measured_phase"], float), turned[1])
            sizes += _of_test(freq, model, test["measured_magnitude"], colour, called)
            turns += _of_test(freq, turned, phase, colour, called)
        heading = f"Response curves: {quantity}".removesuffix(": ")
        unit = unit_of(family[0][1]["measured_magnitude"])
        axes = ("frequency [Hz]", axis_label("amplitude", unit))
        charts.append(Chart(heading, axes, sizes, log=True))
        charts.append(Chart(f"{heading}, phase", ("frequency [Hz]", "phase [°]"), turns))
    return charts


def _in_time(tree: xr.DataTree) -> list[Chart]:
    """Return a chart for every record against its bands, around its largest response."""
    return [
        _record(f"{called} {_called(name, test)}", test)
        for group, called in (("sweep", "Sweep"), ("decay", "Free decay"))
        if node(tree, f"verification/{group}") is not None
        for name, test in tests(
            tree, f"verification/{group}", "measured", "model_band", "predictive_band"
        )
    ]


def _record(heading: str, test: xr.Dataset) -> Chart:
    """Return the chart of one record."""
    part = test.isel(time=_around_largest(np.asarray(test["measured"], float)))
    time = np.asarray(part["time"], float)
    low, _, high = quantiles(part, "predictive_band")
    lines = band(time, low, high, PREDICTIVE_LABEL, PREDICTIVE, "noise")
    lines += _model(time, quantiles(part, "model_band"), MODEL)
    lines.append(line(time, part["measured"], "measured", INK))
    unit = unit_of(test["measured"])
    response = str(test.attrs.get("response", "response"))
    return Chart(heading, ("time [s]", axis_label(response, unit)), lines)


def _around_largest(measured: Float[np.ndarray, " time"]) -> slice:
    """Return the samples around the largest response, as many as a browser bears."""
    start = int(np.nanargmax(np.abs(measured))) - LONGEST // 2
    start = max(0, min(start, measured.size - LONGEST))
    return slice(start, start + LONGEST)


def _loops(tree: xr.DataTree) -> list[Chart]:
    """Return the loops of all levels, less their secants, which leaves their areas."""
    found = tests(tree, "validation/loops", "measured_y", "measured_force", "model_force")
    charts = []
    for name, test in found:
        y = np.asarray(test["measured_y"], float)
        model_y, force = quantiles(test, "model_y"), quantiles(test, "model_force")
        measured = np.asarray(test["measured_force"], float)
        top, bottom = int(np.argmax(y)), int(np.argmin(y))
        secant = (measured[top] - measured[bottom]) / (y[top] - y[bottom])
        lines = [
            line(*_closed(model_y[1], force[i] - secant * model_y[1]), called, colour)
            for i, called, colour in (
                (0, f"{BAND}, lower edge", PREDICTIVE),
                (2, f"{BAND}, upper edge", REPEATS),
                (1, "median of the model", MODEL),
            )
        ]
        lines.append(line(*_closed(y, measured - secant * y), "measured", INK))
        axes = ("displacement [mm]", "restoring force less its secant [N/kg]")
        charts.append(Chart(f"Hysteresis loop {name}", axes, lines))
    return charts


def _closed(y: Any, force: Any) -> Pair:
    return MILLI * np.append(y, y[0]), np.append(force, force[0])


def _forced_loops(tree: xr.DataTree) -> list[Chart]:
    """Return the forced loops, one chart a test."""
    charts = []
    for name, test in tests(tree, "verification/loop", "displacement", "model_force"):
        y = MILLI * np.asarray(test["displacement"], float)
        lines = [
            line(y, quantiles(test, "model_force")[1], "median of the model", MODEL),
            line(y, test["measured_force"], "measured", INK),
        ]
        unit = unit_of(test["measured_force"])
        axes = ("displacement [mm]", axis_label("restoring force", unit))
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
            lines = _of_test(
                place, quantiles(one, "model_band"), one["measured"], MODEL, _called(name, test)
            )
            kind = str(test.attrs.get("kind", "response")).replace("_", " ")
            across = axis_label(axis, unit_of(one[axis]))
            axes = (across, axis_label(kind, unit_of(one["measured"])))
            charts.append(Chart(f"{kind.capitalize()} {label}", axes, lines))
    return charts


def _backbone(tree: xr.DataTree) -> list[Chart]:
    """Return natural frequency and damping against amplitude."""
    found = branch(tree, GROUP, "frequency", "damping")
    factor, unit = length_unit(float(found.attrs["y_fitted"]))
    amplitude = factor * np.asarray(found["amplitude"], float)
    charts = []
    for name, scale, label in (
        ("frequency", 1.0, "natural frequency [Hz]"),
        ("damping", PERCENT, "equivalent damping ratio [%]"),
    ):
        lines = _model(amplitude, scale * quantiles(found, name), MODEL)
        axes = (axis_label("amplitude of displacement", unit), label)
        charts.append(Chart(f"Backbone: {name}", axes, lines))
    return charts
