"""Traces of interactive figures, as the dictionaries that plotly takes."""

import html
from typing import Any, NamedTuple

import numpy as np

from jbw.errors import printable


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


def text(name: object) -> str:
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
    return {**values, **look, "name": text(name), **more}


def band(x: Any, low: Any, high: Any, name: str, colour: str, group: str) -> list[dict[str, Any]]:
    """Return the two traces of a filled band; arguments as for `line`."""
    edge = {"line": {"width": 0}, "hoverinfo": "skip", "legendgroup": text(group)}
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    fill = {"fill": "tonexty", "fillcolor": f"rgba({red},{green},{blue},0.3)"}
    return [
        line(x, low, name, colour, **edge, showlegend=False),
        line(x, high, name, colour, **edge, **fill),
    ]


def unlisted(lines: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return traces that the legend leaves out: they go with the one that it names."""
    return [{**each, "showlegend": False} for each in lines]
