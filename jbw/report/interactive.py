"""Responses, loops and curves to zoom into: one HTML file by plotly, needing no network."""

from pathlib import Path
from typing import Any

import jinja2
import xarray as xr
from markupsafe import Markup

from jbw.errors import ConfigError, DataError, printable
from jbw.report.charts import Chart, charts_of, shown_text
from jbw.run.files import write_whole

# Nothing that was measured leaves the page: no button that uploads a chart.
PRIVATE = {"showSendToCloud": False, "plotlyServerURL": ""}
LOOK = {"displaylogo": False, "responsive": True, **PRIVATE}


def write_interactive(tree: xr.DataTree, path: Path, campaign: str = "") -> None:
    """Write the interactive figures of a run, whole or not at all.

    Args:
        tree: The run's posterior.nc.
        path: The file to write; replaced when it exists.
        campaign: The campaign's name, for the heading.

    Raises:
        ConfigError: If plotly is not installed.
        DataError: If the result has nothing to draw.
    """
    write_whole(path, render_interactive(tree, campaign).encode())


def render_interactive(tree: xr.DataTree, campaign: str = "") -> str:
    """Return the interactive page as HTML; every name that comes from a file is escaped.

    Raises:
        ConfigError: If plotly is not installed.
        DataError: If the result has nothing to draw.
    """
    graphs, script = _plotly()
    charts = charts_of(tree)
    if not charts:
        raise DataError("The result has no response, loop or curve to draw.")
    drawn = [
        (chart.heading, Markup(_figure(graphs, chart, f"chart-{number}")))
        for number, chart in enumerate(charts)
    ]
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("jbw.report"), autoescape=True, undefined=jinja2.StrictUndefined
    )
    return environment.get_template("interactive.html").render(
        campaign=printable(campaign), drawn=drawn, plotly=Markup(script)
    )


def _plotly() -> tuple[Any, str]:
    """Return plotly's graph objects and its script."""
    try:
        # An extra of a megabyte and a second, wanted here alone.
        from plotly import graph_objects
        from plotly.offline import get_plotlyjs
    except ImportError as error:
        raise ConfigError(
            "Interactive figures need plotly, which is not installed.",
            remedy='Install it: pip install "jbw[interactive]".',
        ) from error
    return graph_objects, get_plotlyjs()


def _figure(graphs: Any, chart: Chart, identity: str) -> str:
    """Return a chart as an HTML element and its script."""
    figure = graphs.Figure(data=chart.lines)
    figure.update_layout(
        template="plotly_white", height=460, margin={"l": 70, "r": 20, "t": 20, "b": 60},
        xaxis_title=shown_text(chart.axes[0]), yaxis_title=shown_text(chart.axes[1]), font_size=13,
        legend={"orientation": "h", "y": -0.2, "groupclick": "togglegroup"},
    )  # fmt: skip
    figure.update_yaxes(type="log" if chart.log else "linear", exponentformat="power")
    return figure.to_html(
        full_html=False, include_plotlyjs=False, include_mathjax=False, div_id=identity, config=LOOK
    )
