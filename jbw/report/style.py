"""The common look of all figures: one palette, one width, units on axes, no display needed."""

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatterSciNotation, LogLocator

from jbw.errors import ConfigError
from jbw.report.messages import figures as labels

# Okabe and Ito's colours differ for any colour vision, and in grey.
BLUE, VERMILION, GREEN = "#0072b2", "#d55e00", "#009e73"
ORANGE, SKY, PURPLE = "#e69f00", "#56b4e9", "#cc79a7"
INK, SOFT, GRID = "#20242a", "#68707a", "#d9dde2"

# Equal things have equal colours in every figure.
MEASURED, REPEATS, MODEL, PREDICTIVE = INK, SKY, VERMILION, ORANGE
BAND = labels.COMMON_BAND
LEVELS = (BLUE, GREEN, ORANGE, VERMILION, PURPLE, SKY)

Panels = np.ndarray
"""Axes of a figure, as rows and columns of an array of objects."""

WIDTH = 7.2
"""Width of a figure [in]: two columns of a paper, one column of the page."""

# The ordinate is linear if the largest value is less than this multiple of the smallest.
NARROW = 4.0
# number of letters in a line of the legend, where the symbol of an entry counts as seven
LETTERS = 120

RC: Any = {
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.titlelocation": "left",
    "axes.labelsize": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": SOFT,
    "axes.facecolor": "none",
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "axes.linewidth": 0.7,
    "axes.axisbelow": True,
    "text.color": INK,
}


def panels(ax: Any, rows: int, columns: int, *, height: float, **layout: Any) -> Panels:
    """Return `rows` by `columns` axes: the given ones, or new ones with a `height` [in]."""
    if ax is not None:
        axes = np.asarray(ax, dtype=object).reshape(-1)
        if axes.size != rows * columns:
            raise ConfigError(
                f"Argument `ax` must contain {rows * columns} axes for this figure, "
                f"but contains {axes.size}.",
                remedy="Leave `ax` out and the figure makes its own axes.",
            )
        return axes.reshape(rows, columns)
    with matplotlib.rc_context(RC):
        figure = Figure(figsize=(WIDTH, height), layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False, **layout)
    for panel in axes.flat:
        # The look of ticks and grid is set now: matplotlib creates them late, in the caller's
        # style.
        panel.tick_params(which="both", color=SOFT, labelsize=8, labelcolor=INK)
        panel.tick_params(which="major", width=0.7, length=3)
        panel.tick_params(which="minor", width=0.5, length=2)
        panel.grid(True, color=GRID, linewidth=0.6)
        for axis in (panel.xaxis, panel.yaxis):
            axis.get_offset_text().set(fontsize=8, color=INK)
    return axes


def stacks(
    ax: Any, count: int, rows: int, *, height: float, **layout: Any
) -> tuple[Panels, list[Panels]]:
    """Return the axes of a figure with `count` tests, and a stack of `rows` panels for each test.

    `height` is that of one line of stacks [in].
    """
    # Draw up to three stacks in one line, four in two lines, and count the axes row by row.
    columns = 2 if count == 4 else min(count, 3)
    lines = -(-count // columns)
    if "height_ratios" in layout:
        layout["height_ratios"] = list(layout["height_ratios"]) * lines
    axes = panels(ax, rows * lines, columns, height=height * lines, **layout)
    stack_of = [
        axes[rows * line : rows * (line + 1), column]
        for line in range(lines)
        for column in range(columns)
    ]
    for spare in np.ravel(stack_of[count:]):
        spare.set_visible(False)
    return axes, stack_of[:count]


def finish(axes: Panels, ax: Any, below: str = "", ylabels: str | Sequence[str] = "") -> Panels:
    """Label a figure's lowest and leftmost axes, place the legend, and return the axes."""
    labels = [ylabels] * len(axes) if isinstance(ylabels, str) else ylabels
    for number, row in enumerate(axes):
        row[0].set_ylabel(labels[number % len(labels)] or row[0].get_ylabel())
    for panel in axes[len(labels) - 1 :: len(labels)].flat:
        panel.set_xlabel(below or panel.get_xlabel())
    entries: dict[str, Any] = {}
    for panel in axes.flat:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    if not entries:
        return axes
    names, handles = list(entries), list(entries.values())
    look = {"frameon": False, "fontsize": 8, "labelcolor": INK, "handlelength": 1.6}
    first = axes.flat[0]
    if ax is not None:
        first.legend(handles, names, **look)
        return axes
    first.figure.legend(handles, names, loc="outside upper left", ncols=_columns(names), **look)
    return axes


def _columns(names: Sequence[str]) -> int:
    """Return the largest number of columns with which a legend fits the figure's width."""
    for count in range(len(names), 1, -1):
        columns = np.array_split(np.array([len(name) + 7 for name in names]), count)
        if sum(column.max() for column in columns) <= LETTERS:
            return count
    return 1


def title(ax: Axes, text: str, size: float = 9.0) -> None:
    """Set a panel's title, aligned left."""
    ax.set_title(text, loc="left", fontsize=size, color=INK)


def log_y(ax: Axes) -> None:
    """Make an ordinate logarithmic, with labels at 1, 2 and 5 if it spans few decades.

    What is drawn so far stays linear if it spans less than a factor of four: labels of powers would
    differ in the second digit alone.
    """
    low, high = ax.dataLim.intervaly
    if 0 < low <= high < NARROW * low:
        return
    ax.set_yscale("log")
    ax.yaxis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
    ax.yaxis.set_minor_formatter(LogFormatterSciNotation(minor_thresholds=(2.0, 2.0)))


def shade(ax: Axes, x: Any, lower: Any, upper: Any, colour: str, label: str, **look: Any) -> None:
    """Fill the band between `lower` and `upper`, without an edge."""
    look = {"color": colour, "alpha": 0.35, "lw": 0, "label": label, **look}
    ax.fill_between(x, lower, upper, **look)


def band_label(attrs: Mapping[Any, Any], *, noise: bool = False) -> str:
    """Return the label of a test's band, with the uncertainties that it includes."""
    added = {
        "scatter of runs": attrs.get("scatter"), "model discrepancy": attrs.get("discrepancy"),
        "noise": noise,
    }  # fmt: skip
    also = [name for name, is_held in added.items() if is_held]
    if not also:
        return BAND
    return f"99 % band: {', '.join(['parameters', *also[:-1]])} and {also[-1]}"


def draw_model(
    ax: Axes,
    x: Any,
    band: Any,
    label: str = "median of the model",
    ls: str = "-",
    holds: str = BAND,
) -> None:
    """Draw the model's 99 % band and its median; `band` has lower end, median and upper end."""
    if np.any(np.isfinite(band[0])):  # otherwise the band is withheld
        shade(ax, x, band[0], band[2], MODEL, holds, alpha=0.4)
    ax.plot(x, band[1], color=MODEL, lw=1.0, ls=ls, label=label)
