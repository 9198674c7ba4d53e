"""The report of a run as one self-contained HTML file, and its interactive version by plotly."""

import gzip
import logging
import os
import re
from base64 import b64encode
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import jinja2
import xarray as xr
from markupsafe import Markup, escape

from jbw.errors import ConfigError, DataError, printable
from jbw.report import tables
from jbw.report.charts import charts_of, decimated, shared_limit, shown_text
from jbw.report.cycles import cycles_table
from jbw.report.figures import FIGURE_LIST, GROUPS, DrawnFigure, ReportFigure, draw_figures
from jbw.report.identifiability import directions_table, quantities_table
from jbw.report.load_section import LoadSection
from jbw.report.messages import opening as messages
from jbw.report.opening import lead, opening
from jbw.report.result import laws_of, names_of
from jbw.report.table import Table
from jbw.report.text import Names, seconds
from jbw.report.words import (
    badge,
    findings,
    identified_words,
    in_symbols,
    law_words,
)
from jbw.results.run import RunSummary, StoredStep, StoredVerdict
from jbw.run.files import write_whole

under_way = logging.getLogger("jbw.progress")
# No measured data leave the interactive page: it has no button that uploads a chart.
PRIVATE = {"showSendToCloud": False, "plotlyServerURL": ""}
# Largest number of points of all charts together: 2 x 4 bytes each make 2.4 MB in base64, in
# addition to 2.0 MB of compressed plotly.
MOST_POINTS = 230_000
LOOK = "look"  # name of the figure that is shown together with the sentences on single records
_QUOTED = re.compile(r"`([^`]*)`")


def _as_code(value: Any) -> Any:
    """Return a text escaped for HTML, with its parts in backticks as code."""
    if not isinstance(value, str) or isinstance(value, Markup) or "`" not in value:
        return value
    return Markup(_QUOTED.sub(r"<code>\1</code>", str(escape(value))))


ENVIRONMENT = jinja2.Environment(
    loader=jinja2.PackageLoader("jbw.report"),
    autoescape=True,
    finalize=_as_code,
    trim_blocks=True,
    lstrip_blocks=True,
    undefined=jinja2.StrictUndefined,
)


def write_page(
    summary: RunSummary,
    tree: xr.DataTree,
    path: Path,
    drawn: Mapping[str, DrawnFigure] | None = None,
    loads: LoadSection | None = None,
) -> None:
    """Write the report of a run to a file, completely or not at all."""
    write_whole(path, render_page(summary, tree, drawn, loads).encode())


def render_page(
    summary: RunSummary,
    tree: xr.DataTree,
    drawn: Mapping[str, DrawnFigure] | None = None,
    loads: LoadSection | None = None,
) -> str:
    """Return the report of a run as HTML; every name that comes from a file is escaped.

    Args:
        summary: Summary of the run.
        tree: Result tree of the run, with all groups.
        drawn: Figures that have been drawn before, by name; others are drawn here.
        loads: Predictions under other loads, if the run has any.
    """
    quantities, identifiability = names_of(tree, summary), summary.identifiability
    return ENVIRONMENT.get_template("page.html").render(
        campaign=summary.campaign,
        laws=law_words(laws_of(tree)),
        **_verdict(summary.verdict, quantities),
        steps=[_step(name, step, summary, quantities) for name, step in tables.main_first(summary)],
        opening=[
            in_symbols(sentence, quantities).replace(" %", "\N{NO-BREAK SPACE}%")
            for sentence in opening(summary, tree)
        ],
        **_parameters(summary, quantities),
        look=summary.look,
        **_figures(summary, drawn or draw_figures(tree)),
        predictions=tables.table_of_tests(summary, tree),
        loads=loads,
        directions=directions_table(identifiability, quantities),
        quantities=quantities_table(identifiability, quantities),
        identified=identified_words(summary, quantities),
        known_words=_symbolic(identifiability.statements, quantities),
        routes=tables.routes_table(summary, quantities),
        route_words=_symbolic(summary.comparison.statements, quantities),
        loops=tables.loops_table(tree),
        joints=tables.joints_table(tree),
        cycles=cycles_table(summary.look.loops),
        checks=tables.checks_table(tree, quantities),
        provenance=_provenance(summary),
        inputs=_inputs(summary.inputs),
    )


def _verdict(verdict: StoredVerdict, quantities: Names) -> dict[str, Any]:
    """Return the page's data on a verdict: badge, words, findings and answers."""
    status = badge(verdict.status)
    answers = [
        {
            "name": name,
            "badge": badge(answered.status),
            "because": in_symbols(answered.because, quantities),
            "question": answered.question,
        }
        for name, answered in verdict.answers.items()
    ]
    return {
        "status": status,
        "status_words": messages.STATUS.get(status.word, messages.READ_FIRST),
        "findings": findings(verdict, quantities),
        "answers": answers,
    }


def _step(name: str, step: StoredStep, summary: RunSummary, quantities: Names) -> dict[str, Any]:
    """Return the page's data on one step of the identification: findings and statements."""
    return {
        "name": tables.step_heading(name, summary),
        "main": name == summary.main,
        "route": tables.of_route(name, summary),
        "badge": badge(step.verdict.status) if step.verdict.status else None,
        "findings": findings(step.verdict, quantities),
        "statements": _symbolic(step.statements, quantities),
        "correlations": tables.correlation_words(step, quantities),
    }


def _parameters(summary: RunSummary, quantities: Names) -> dict[str, Table]:
    """Return tables of parameters: main posterior, other steps, and the steps of Teloli et al."""
    parameters = tables.parameters_table(summary, quantities, shown=True)
    main, of_route = summary.main, partial(tables.of_route, summary=summary)
    return {
        "parameters": _only(parameters, lambda name: name == main),
        "others": _only(parameters, lambda name: name != main and not of_route(name)),
        "paper": _only(parameters, of_route),
    }


def _figures(summary: RunSummary, drawn: Mapping[str, DrawnFigure]) -> dict[str, Any]:
    """Return the figures of the page: first figure, records, groups of figures, missing figures."""
    by_name = {entry.name: _shown(entry, drawn[entry.name]) for entry in FIGURE_LIST}
    shown = [entry for entry in FIGURE_LIST if drawn[entry.name].svg]
    first = lead(summary, [entry.name for entry in shown])
    groups = (
        (name, title, [by_name[entry.name] for entry in shown
                       if entry.group == name and entry.name not in (first, LOOK)])
        for name, title in GROUPS.items()
    )  # fmt: skip
    return {
        "lead": by_name.get(first or ""),
        "looked": by_name[LOOK],
        "groups": [
            {"id": f"figures-{name}", "title": title, "drawn": of_group}
            for name, title, of_group in groups
            if of_group
        ],
        "missing": [by_name[entry.name] for entry in FIGURE_LIST if drawn[entry.name].missing],
    }


def _only(table: Table, chosen: Callable[[str], bool]) -> Table:
    """Return a table with only those sections whose names are chosen."""
    return replace(
        table, sections=tuple(section for section in table.sections if chosen(section.name))
    )


def _symbolic(sentences: Iterable[str], quantities: Names) -> list[str]:
    return [in_symbols(sentence, quantities) for sentence in sentences]


def _inputs(hashes: Mapping[str, str]) -> dict[str, Any]:
    """Return the common folder of a run's input files, with each file's path and hash."""
    paths = sorted(hashes)
    folders = {os.path.dirname(path) for path in paths}
    folder = os.path.commonpath(folders) if folders and "" not in folders else ""
    start = len(folder) + 1 if folder else 0
    return {"folder": folder, "files": [(path[start:], hashes[path]) for path in paths]}


def _shown(entry: ReportFigure, drawn: DrawnFigure) -> dict[str, Any]:
    """Return the page's data on one figure: number, images, or the reason why it is missing."""
    number = entry.name.removeprefix("figure_") if entry.name.startswith("figure_") else ""
    # The SVG is jbw's own drawing with texts as outlines, so that it is safe to insert unescaped.
    pictures = {"svg": Markup(drawn.svg), "rest": Markup(drawn.rest)}
    return {"entry": entry, "number": number, "missing": drawn.missing, **pictures}


def _provenance(summary: RunSummary) -> dict[str, str]:
    versions = (f"{name} {version}" for name, version in summary.versions.items())
    return {
        "command": summary.command,
        "seed": "" if summary.seed is None else str(summary.seed),
        "wall time": seconds(summary.wall_time_s),
        "versions": ", ".join(versions),
        "sources of jbw": summary.sources,
    }


def write_interactive(tree: xr.DataTree, path: Path, campaign: str = "") -> None:
    """Write the interactive figures of a run to a file, completely or not at all."""
    write_whole(path, render_interactive(tree, campaign).encode())


def render_interactive(tree: xr.DataTree, campaign: str = "") -> str:
    """Return the interactive page as HTML; every name that comes from a file is escaped."""
    try:
        # This optional package takes a megabyte and a second, and only this page needs it.
        from plotly.graph_objects import Figure
        from plotly.offline import get_plotlyjs
    except ImportError as error:
        raise ConfigError(
            "Interactive figures need plotly, which is not installed.",
            remedy='Install plotly: pip install "jbw[interactive]".',
        ) from error
    charts = charts_of(tree)
    if not charts:
        raise DataError("The result has no response, loop or curve to draw.")
    drawn, limit = [], shared_limit([len(x["x"]) for c in charts for x in c.lines], MOST_POINTS)
    for number, chart in enumerate(charts):
        figure = Figure(data=[_lighter(line, limit) for line in chart.lines])
        across, up = map(shown_text, chart.axes)
        figure.update_layout(
            template="plotly_white", height=460, margin={"l": 70, "r": 20, "t": 20, "b": 60},
            xaxis_title=across, yaxis_title=up, font_size=13,
            legend={"orientation": "h", "y": -0.2, "groupclick": "togglegroup"},
        )  # fmt: skip
        figure.update_yaxes(type="log" if chart.log else "linear", exponentformat="power")
        # JSON in a script element must not contain a character that ends the element.
        data = Markup(str(figure.to_json()).replace("<", "\\u003c"))
        drawn.append((f"chart-{number}", chart.heading, data))
    packed = b64encode(gzip.compress(get_plotlyjs().encode(), 9, mtime=0)).decode()
    return ENVIRONMENT.get_template("interactive.html").render(
        campaign=printable(campaign), drawn=drawn, plotly=Markup(packed),
        config={"displaylogo": False, "responsive": True, **PRIVATE},
    )  # fmt: skip


def _lighter(line: Mapping[str, Any], limit: int) -> dict[str, Any]:
    """Reduce one of plotly's curves to at most `limit` points."""
    x, y = decimated(line["x"], line["y"], limit)
    return {**line, "x": x, "y": y}
