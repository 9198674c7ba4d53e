"""The report: one HTML file that needs nothing else, the verdict first."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jinja2
import xarray as xr
from markupsafe import Markup

from jbw.errors import DataError
from jbw.report import tables
from jbw.report.figure_list import FIGURE_LIST, Entry
from jbw.report.figures import figure_of, svg
from jbw.report.identifiability import directions_table, quantities_table
from jbw.report.result import laws_of, names_of
from jbw.report.text import Names, seconds, step_name
from jbw.report.words import STATUS_WORDS, badge, findings, identified_words, in_symbols
from jbw.run.files import write_whole

# Laws that are called by people's names or by more than their own.
LAWS = {"bouc_wen": "Bouc-Wen oscillator", "cubic": "cubic spring", "jenkins": "Jenkins array"}


def law_name(law: str) -> str:
    """Return what a law is called, that of a family without its number."""
    return LAWS.get(law) or LAWS.get(law.rstrip("0123456789_")) or law.replace("_", " ")


class Drawn(NamedTuple):
    """A figure on the page, or the sentence that says why there is none."""

    entry: Entry
    number: str
    svg: Markup
    missing: str


def write_page(summary: Mapping[str, Any], tree: xr.DataTree, path: Path) -> None:
    """Write the report of a run, whole or not at all.

    Args:
        summary: The run's summary.json.
        tree: The run's posterior.nc.
        path: The file to write; replaced when it exists.
    """
    write_whole(path, render_page(summary, tree).encode())


def render_page(summary: Mapping[str, Any], tree: xr.DataTree) -> str:
    """Return the report as HTML; every name that comes from a file is escaped."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("jbw.report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    verdict, known = summary.get("verdict") or {}, names_of(tree, summary)
    identifiability = summary.get("identifiability") or {}
    # The main step comes first: it is what the others are held against.
    main, steps = summary.get("main"), (summary.get("steps") or {}).items()
    steps = sorted(steps, key=lambda each: each[0] != main)
    status = badge(verdict)
    return environment.get_template("page.html").render(
        campaign=campaign_name(summary),
        laws=" and ".join(map(law_name, laws_of(tree))),
        status=status,
        status_words=STATUS_WORDS.get(status.word, "Read the findings before using it."),
        findings=findings(verdict, known),
        steps=[_step(name, name == main, step, known) for name, step in steps],
        parameters=tables.parameters_table(summary, known),
        drawn=[_draw(entry, tree) for entry in FIGURE_LIST],
        predictions=tables.predictions_table(summary),
        directions=directions_table(identifiability, known),
        quantities=quantities_table(identifiability, known),
        identified=identified_words(summary, known),
        known_words=_statements(identifiability, known),
        routes=tables.routes_table(summary, known),
        route_words=_statements(summary.get("comparison"), known),
        loops=tables.loops_table(summary, tree),
        checks=tables.checks_table(tree, known),
        provenance=_provenance(summary),
        inputs=_inputs(summary.get("inputs") or {}),
    )


def _statements(part: Any, known: Names) -> list[str]:
    """Return the sentences of a part of the summary."""
    return [in_symbols(str(each), known) for each in (part or {}).get("statements") or []]


def _step(name: str, main: bool, step: Mapping[str, Any], known: Names) -> dict[str, Any]:
    """Return what a step says in words."""
    return {
        "name": step_name(name) + (" (main result)" if main else ""),
        "main": main,
        "badge": badge(step.get("verdict")) if step.get("verdict") else None,
        "findings": findings(step.get("verdict"), known),
        "statements": _statements(step, known),
        "correlations": tables.correlation_words(step, known),
    }


class Inputs(NamedTuple):
    """The files that were read: the folder that all lie in, and each one's rest and hash."""

    folder: str
    files: list[tuple[str, str]]


def _inputs(hashes: Mapping[str, str]) -> Inputs:
    """Return the input files below the folder that they share."""
    paths = sorted(hashes)
    folders = {os.path.dirname(path) for path in paths}
    folder = os.path.commonpath(folders) if folders and "" not in folders else ""
    start = len(folder) + 1 if folder else 0
    return Inputs(folder, [(path[start:], hashes[path]) for path in paths])


def campaign_name(summary: Mapping[str, Any]) -> str:
    """Return the campaign's name, given as text or as a record."""
    campaign = summary.get("campaign")
    return str(campaign.get("name", "")) if isinstance(campaign, Mapping) else str(campaign or "")


def _draw(entry: Entry, tree: xr.DataTree) -> Drawn:
    """Return one figure as SVG, or why it is missing."""
    number = entry.name.removeprefix("figure_") if entry.name.startswith("figure_") else ""
    try:
        # The SVG is our own drawing of numbers, its texts outlines: safe to insert as it is.
        return Drawn(entry, number, Markup(svg(figure_of(entry.draw(tree)), entry.name)), "")
    except DataError as cause:
        return Drawn(entry, number, Markup(""), cause.what)


def _provenance(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return what a reader needs to repeat the run."""
    versions = summary.get("versions") or {}
    listed = (
        ", ".join(f"{name} {version}" for name, version in versions.items())
        if isinstance(versions, Mapping)
        else str(versions)
    )
    rows = [
        ("command", str(summary.get("command") or "")),
        ("seed", "" if summary.get("seed") is None else str(summary["seed"])),
        ("wall time", seconds(summary.get("wall_time_s"))),
        ("versions", listed),
    ]
    return [(what, value) for what, value in rows if value]
