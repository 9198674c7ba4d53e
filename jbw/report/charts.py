"""The charts of the interactive page: responses, loops and curves, taken from the report's axes.

Curves have fewer points than in the report: thinning keeps their extremes.
"""

import html
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure

from jbw.errors import DataError, printable
from jbw.report.loops import backbone, draw_forced_loop, draw_loop, secant
from jbw.report.messages import figures as labels
from jbw.report.records import draw_record, response_label
from jbw.report.responses import (
    CURVE_LABELS,
    curve_columns,
    draw_curves,
    level_colours,
    level_palette,
)
from jbw.report.result import (
    arrays,
    fitted_text,
    frequency,
    node,
    quantiles,
    tests,
    unit_of,
    verified,
)
from jbw.report.style import MODEL, shade
from jbw.report.text import axis_label
from jbw.results.attributes import PredictedTest

# largest number of samples, around a record's largest response, that a browser zooms without delay
LONGEST = 12000
HERTZ = "frequency [Hz]"
DASHES = {"-": "solid", "--": "dash", "-.": "dashdot", ":": "dot"}
Trace = dict[str, Any]
Drawn = Iterable[tuple[str, Axes]]
Values = Float[np.ndarray, " point"]


class Chart(NamedTuple):
    """One interactive figure: heading, axis labels, and data in plotly's form."""

    heading: str
    axes: tuple[str, str]
    lines: list[Trace]
    log: bool


def shown_text(name: object) -> str:
    """Return a name for plotly's labels, in which the special characters of HTML are escaped."""
    return html.escape(printable(str(name)).replace(r"\$", "$"))


def traces(ax: Axes) -> list[Trace]:
    """Return the bands and lines of matplotlib axes in plotly's form."""
    drawn_traces = []
    artists: list[Any] = [*ax.collections, *ax.lines]
    for artist in artists:
        if isinstance(artist, PolyCollection):
            parts = [np.asarray(path.vertices) for path in artist.get_paths()]
            x, y = np.concatenate([np.append(part, [[np.nan] * 2], axis=0) for part in parts]).T
            colour = to_hex(np.asarray(artist.get_facecolor())[0])
            red, green, blue = (round(255 * part) for part in to_rgb(colour))
            look = {"fill": "toself", "fillcolor": f"rgba({red},{green},{blue},0.3)"}
            look |= {"mode": "lines", "line": {"width": 0}, "hoverinfo": "skip"}
        elif isinstance(artist, LineCollection):  # error bars of points
            gap = [[np.nan] * 2]
            x, y = np.concatenate(
                [np.append(segment, gap, axis=0) for segment in artist.get_segments()]
            ).T
            colour = to_hex(np.asarray(artist.get_colors())[0])
            look = {"mode": "lines", "line": {"color": colour, "width": 1}, "hoverinfo": "skip"}
        else:
            x, y = artist.get_data()
            colour = to_hex(artist.get_color())
            marked = artist.get_marker() not in ("", "None")
            dash = DASHES.get(artist.get_linestyle(), "solid")
            look = {"mode": "markers" if marked else "lines", "marker": {"color": colour}}
            look |= {"line": {"color": colour, "width": 1.3, "dash": dash}}
        label = str(artist.get_label())
        # Numbers are stored as 32-bit floats, because this halves the size of the file.
        values = {"x": np.asarray(x, np.float32), "y": np.asarray(y, np.float32)}
        legend = {"name": shown_text(label), "showlegend": not label.startswith("_")}
        drawn_traces.append({**values, **legend, "legendgroup": colour, **look})
    return drawn_traces


def charts_of(tree: xr.DataTree) -> list[Chart]:
    """Return all interactive charts for which the result of a run has data."""
    charts = []
    for draw in (_frfs, _curves, _records, _loops, _forced_loops, _groups, _backbone):
        try:
            drawn = list(draw(tree))
        except DataError:
            # The campaign has no tests for this chart.
            continue
        for heading, ax in drawn:
            labels = (ax.get_xlabel(), ax.get_ylabel())
            charts.append(Chart(heading, labels, traces(ax), log=ax.get_yscale() == "log"))
    return charts


def _blank(**labels: str) -> Axes:
    return Figure().subplots(subplot_kw=labels)


def _called(name: str, test: xr.Dataset) -> str:
    return ", ".join(filter(None, (name, fitted_text(test))))


def _draw(ax: Axes, x: Any, model: Any, measured: Any, colour: str, name: str) -> None:
    """Draw one of several tests on an interactive chart, with everything in one colour."""
    shade(ax, x, model[0], model[2], colour, "_band")
    ax.plot(x, model[1], color=colour, label="_median")
    ax.plot(x, measured, "o", color=colour, label=f"measured, {name}")


def _frfs(tree: xr.DataTree) -> Drawn:
    frf_tests = tests(tree, "verification/frf", "measured_magnitude", "model_magnitude")
    label = axis_label("receptance", unit_of(frf_tests[0][1]["measured_magnitude"]))
    ax = _blank(xlabel=HERTZ, ylabel=label, yscale="log")
    for (name, test), colour in zip(frf_tests, level_colours(len(frf_tests)), strict=True):
        mean = test["measured_magnitude"].mean("repeat")
        model = quantiles(test, "model_magnitude")
        _draw(ax, frequency(test), model, mean, colour, _called(name, test))
    yield "Frequency responses", ax


def _curves(tree: xr.DataTree) -> Drawn:
    curve_tests = tests(tree, "verification/curve", "measured_magnitude", "model_magnitude")
    for suffix, family in curve_columns(curve_tests):
        column = Figure().subplots(3)
        draw_curves(column, suffix, family, level_palette(curve_tests))
        for ax, label in zip(column[1:], CURVE_LABELS, strict=True):
            ax.set_ylabel(label)
        for ax, what in zip(column, ("", ", phase", ", distance"), strict=True):
            ax.set_xlabel(HERTZ)
            yield f"Response curves: {column[0].get_title(loc='left')}{what}", ax


def _records(tree: xr.DataTree) -> Drawn:
    """Draw every measured record with its predicted bands, around its largest response."""
    needed = ("measured", "model_band")
    for group, kind in (("sweep", "Sweep"), ("decay", "Free decay")):
        path = f"verification/{group}"
        for name, test in tests(tree, path, *needed) if node(tree, path) else ():
            start = int(np.nanargmax(np.abs(test["measured"]))) - LONGEST // 2
            start = max(0, min(start, test.sizes["time"] - LONGEST))
            part = test.isel(time=slice(start, start + LONGEST))
            ax = _blank(xlabel="time [s]", ylabel=response_label(test))
            draw_record(ax, part, measured="measured")
            median = quantiles(part, "model_band")[1]
            ax.plot(part["time"], median, color=MODEL, label="median of the model")
            yield f"{kind} {_called(name, test)}", ax


def _loops(tree: xr.DataTree) -> Drawn:
    """Draw the loops of all levels minus their secant lines, so that their areas are visible."""
    needed = ("measured_y", "measured_force", "model_y", "model_force")
    for name, test in tests(tree, "validation/loops", *needed):
        ax = _blank(xlabel="displacement [mm]", ylabel=labels.LESS_SECANT)
        draw_loop(ax, test, secant(*arrays(test, "measured_y", "measured_force")))
        yield f"Hysteresis loop {name}", ax


def _forced_loops(tree: xr.DataTree) -> Drawn:
    for name, test in tests(tree, "verification/loop", "displacement", "model_force"):
        ax = _blank(xlabel="displacement [mm]", ylabel="restoring force [kN]")
        draw_forced_loop(ax, test)
        yield f"Forced loop {_called(name, test)}", ax


def _groups(tree: xr.DataTree) -> Drawn:
    """Draw tests of kinds that extensions added, with one chart per group of values."""
    for _, name, test in verified(tree, "axis"):
        facts = PredictedTest.of(test)
        axis, kind = facts.axis, (facts.kind or "response").replace("_", " ")
        labels = {"xlabel": axis_label(axis, unit_of(test[axis]))}
        quantity = facts.quantity or kind
        labels["ylabel"] = axis_label(quantity, unit_of(test["measured"]))
        for label, group in test.groupby("group"):
            ordered, ax = group.sortby(axis), _blank(**labels)
            model = quantiles(ordered, "model_band")
            _draw(ax, ordered[axis], model, ordered["measured"], MODEL, _called(name, test))
            yield f"{kind.capitalize()} {label}", ax


def _backbone(tree: xr.DataTree) -> Drawn:
    return zip(("Backbone: frequency", "Backbone: damping"), backbone(tree).flat, strict=True)


def shared_limit(sizes: Sequence[int], total: int) -> int:
    """Return the largest number of points per curve such that all curves have at most `total`."""
    low, high = 2, max([2, *sizes])
    while low < high:
        middle = (low + high + 1) // 2
        fits = sum(min(size, middle) for size in sizes) <= total
        low, high = (middle, high) if fits else (low, middle - 1)
    return low


def decimated(x: Values, y: Values, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Reduce a curve to the extremes of equal intervals, to about `most` points.

    Each part between NaN values keeps its first and last point, so that a band stays closed and a
    gap stays a gap. A curve of `most` points or fewer is returned unchanged.
    """
    size = len(x)
    if size <= most:
        return x, y
    width = max(1, int(np.ceil(2 * size / max(most, 1))))  # Two points remain of each segment.
    gaps = np.flatnonzero(~(np.isfinite(x) & np.isfinite(y)))
    ends = np.concatenate([[-1], gaps, [size]])
    indices = [gaps]
    for start, stop in zip(ends[:-1] + 1, ends[1:], strict=True):
        part = y[start:stop]
        if len(part):
            indices.append(start + _extremes(part, width))
    order = np.unique(np.concatenate(indices))
    return x[order], y[order]


def _extremes(y: Values, width: int) -> np.ndarray:
    """Return the indices of each interval's smallest and largest value, and of both ends."""
    starts = np.arange(0, len(y), width)
    padded = np.append(y, np.full(-len(y) % width, y[-1])).reshape(-1, width)
    extremes = (starts + padded.argmin(axis=1), starts + padded.argmax(axis=1))
    return np.minimum(np.concatenate([[0], *extremes, [len(y) - 1]]), len(y) - 1)
