"""What the interactive page shows: a run's responses, loops and curves as plotly's traces."""

from collections.abc import Callable
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float

from jbw.errors import DataError
from jbw.report.backbone import GROUP, PERCENT, length_unit
from jbw.report.curves import level_colours
from jbw.report.linear import BAND, fitted_text
from jbw.report.loops import MILLI
from jbw.report.phase import beside, unwrapped_band
from jbw.report.result import branch, frequency, tests
from jbw.report.style import INK, MODEL, PREDICTIVE, REPEATS
from jbw.report.text import axis_label
from jbw.report.traces import Chart, band, line, text, unlisted

LONGEST = 12000  # samples of a record, around its largest: what a browser moves without stutter
PREDICTIVE_LABEL = "99 % predictive band (noise included)"
Pair = tuple[Any, Any]


def charts_of(tree: xr.DataTree) -> list[Chart]:
    """Return the charts that a result allows.

    Args:
        tree: The run's posterior.nc.
    """
    found = []
    makers: tuple[Callable[[xr.DataTree], list[Chart]], ...] = (
        _frfs, _curves, _sweeps, _decays, _loops, _forced_loops, _backbone,
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


def _frfs(tree: xr.DataTree) -> list[Chart]:
    """Return magnitudes of all frequency responses."""
    found = tests(tree, "verification/frf", "measured_magnitude", "model_magnitude")
    lines = []
    for (name, test), colour in zip(found, level_colours(len(found)), strict=True):
        called, freq = _called(name, test), frequency(test)
        low, middle, high = _bands(test, "model_magnitude")
        mean = np.asarray(test["measured_magnitude"].mean("repeat"), float)
        group = {"legendgroup": text(called)}
        lines += unlisted(band(freq, low, high, f"{BAND}, {called}", colour, called))
        median = line(freq, middle, f"median of the model, {called}", colour, **group)
        lines += unlisted([median])
        dots = {"mode": "markers", "marker": {"color": colour, "size": 4}, **group}
        lines.append(line(freq, mean, f"measured, {called}", colour, **dots))
    unit = str(found[0][1]["measured_magnitude"].attrs.get("units", ""))
    axes = ("frequency [Hz]", axis_label("receptance", unit))
    return [Chart("Frequency responses", axes, lines, log=True)]


def _curves(tree: xr.DataTree) -> list[Chart]:
    """Return magnitude and phase of the response curves' first harmonics."""
    found = tests(tree, "verification/curve", "measured_magnitude", "model_magnitude")
    quantities = dict.fromkeys(str(test.attrs.get("quantity", "")) for _, test in found)
    charts = []
    for quantity in quantities:
        family = [each for each in found if str(each[1].attrs.get("quantity", "")) == quantity]
        unit = str(family[0][1]["measured_magnitude"].attrs.get("units", ""))
        pairs = zip(family, level_colours(len(family)), strict=True)
        drawn = [(_curve(name, test, colour)) for (name, test), colour in pairs]
        heading = f"Response curves: {quantity}".removesuffix(": ")
        axes = ("frequency [Hz]", axis_label("amplitude", unit))
        charts.append(Chart(heading, axes, [x for sizes, _ in drawn for x in sizes], log=True))
        axes = ("frequency [Hz]", "phase [°]")
        charts.append(Chart(f"{heading}, phase", axes, [x for _, turns in drawn for x in turns]))
    return charts


def _curve(
    name: str, test: xr.Dataset, colour: str
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the traces of a curve's magnitude and of its phase."""
    freq, called = frequency(test), _called(name, test)
    turned = unwrapped_band(_bands(test, "model_phase"))
    phase = beside(np.asarray(test["measured_phase"], float), turned[1])
    group = {"legendgroup": text(called)}
    dots = {"mode": "markers", "marker": {"color": colour, "size": 5}, **group}
    found = []
    for measured, (low, middle, high) in (
        (test["measured_magnitude"], _bands(test, "model_magnitude")),
        (phase, turned),
    ):
        drawn = band(freq, low, high, f"{BAND}, {called}", colour, called)
        drawn.append(line(freq, middle, f"median of the model, {called}", colour, **group))
        found.append(
            [*unlisted(drawn), line(freq, measured, f"measured, {called}", colour, **dots)]
        )
    return found[0], found[1]


def _sweeps(tree: xr.DataTree) -> list[Chart]:
    return _in_time(tree, "verification/sweep", "Sweep")


def _decays(tree: xr.DataTree) -> list[Chart]:
    return _in_time(tree, "verification/decay", "Free decay")


def _in_time(tree: xr.DataTree, group: str, called: str) -> list[Chart]:
    """Return a chart for every record against its bands, around its largest response."""
    charts = []
    for name, test in tests(tree, group, "measured", "model_band", "predictive_band"):
        part = test.isel(time=_around_largest(np.asarray(test["measured"], float)))
        time = np.asarray(part["time"], float)
        low, _, high = _bands(part, "predictive_band")
        lines = band(time, low, high, PREDICTIVE_LABEL, PREDICTIVE, "noise")
        low, middle, high = _bands(part, "model_band")
        lines += band(time, low, high, BAND, MODEL, "model")
        lines.append(line(time, middle, "median of the model", MODEL, legendgroup="model"))
        lines.append(line(time, part["measured"], "measured", INK))
        unit = str(test["measured"].attrs.get("units", ""))
        axes = ("time [s]", axis_label(str(test.attrs.get("response", "response")), unit))
        charts.append(Chart(f"{called} {_called(name, test)}", axes, lines))
    return charts


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
        model_y, force = _bands(test, "model_y"), _bands(test, "model_force")
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
            line(y, _bands(test, "model_force")[1], "median of the model", MODEL),
            line(y, test["measured_force"], "measured", INK),
        ]
        unit = str(test["measured_force"].attrs.get("units", "N"))
        axes = ("displacement [mm]", axis_label("restoring force", unit))
        charts.append(Chart(f"Forced loop {_called(name, test)}", axes, lines))
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
        low, middle, high = scale * _bands(found, name)
        lines = band(amplitude, low, high, BAND, MODEL, "model")
        lines.append(line(amplitude, middle, "median of the model", MODEL))
        axes = (axis_label("amplitude of displacement", unit), label)
        charts.append(Chart(f"Backbone: {name}", axes, lines))
    return charts


def _bands(test: xr.Dataset, name: str) -> Float[np.ndarray, "quantile point"]:
    return np.asarray(test[name].transpose("quantile", ...), float)
