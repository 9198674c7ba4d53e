"""The report: one HTML file that needs nothing else, the verdict first."""

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jinja2
import xarray as xr
from markupsafe import Markup

from jbw.errors import DataError
from jbw.report import tables
from jbw.report.figures import figure_of, svg
from jbw.report.findings import STATUS_WORDS, badge, findings
from jbw.report.identifiability_rows import quantity_rows, spectrum_rows, waterfall_words
from jbw.report.plates import PLATES, Plate
from jbw.report.text import seconds
from jbw.report.words import identified_words, in_symbols


class Drawn(NamedTuple):
    """A figure on the page, or the sentence that says why there is none."""

    plate: Plate
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
    write_whole(path, render_page(summary, tree))


def write_whole(path: Path, text: str) -> None:
    """Write a text file that is either the old one or the new one, never a part.

    Args:
        path: The file; replaced when it exists.
        text: What it is to hold.
    """
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as stream:
            stream.write(text)
        # mkstemp keeps the file to its owner; a report is to be handed on like any other file.
        os.chmod(name, 0o666 & ~_umask())
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def _umask() -> int:
    """Return the process's umask, which can only be read by setting it."""
    mask = os.umask(0o022)
    os.umask(mask)
    return mask


def render_page(summary: Mapping[str, Any], tree: xr.DataTree) -> str:
    """Return the report as HTML; every name that comes from a file is escaped."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("jbw.report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    verdict = summary.get("verdict") or {}
    status = badge(verdict)
    return environment.get_template("page.html").render(
        campaign=campaign_name(summary),
        status=status,
        status_words=STATUS_WORDS.get(status.word, "Read the findings before using it."),
        findings=findings(verdict),
        steps=tables.step_rows(summary),
        drawn=[_draw(plate, tree) for plate in PLATES],
        predictions=tables.prediction_rows(summary),
        spectrum=spectrum_rows(summary),
        quantities=quantity_rows(summary),
        identified=identified_words(summary),
        known_words=_statements(summary.get("identifiability")),
        waterfall=waterfall_words(summary),
        routes=tables.route_rows(summary),
        route_words=_statements(summary.get("comparison")),
        loops=tables.loop_rows(summary, tree),
        checks=tables.data_rows(tree),
        provenance=_provenance(summary),
        inputs=_inputs(summary.get("inputs") or {}),
    )


def _statements(part: Any) -> list[str]:
    """Return the sentences of a part of the summary."""
    return [in_symbols(str(each)) for each in (part or {}).get("statements") or []]


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


def _draw(plate: Plate, tree: xr.DataTree) -> Drawn:
    """Return one figure as SVG, or why it is missing."""
    number = plate.name.removeprefix("figure_") if plate.name.startswith("figure_") else ""
    try:
        # The SVG is our own drawing of numbers, its texts outlines: safe to insert as it is.
        return Drawn(plate, number, Markup(svg(figure_of(plate.draw(tree)), plate.name)), "")
    except DataError as cause:
        return Drawn(plate, number, Markup(""), cause.what)


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
