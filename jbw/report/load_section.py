"""The section of a run's page on predictions under other loads: table and figures."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import xarray as xr
from markupsafe import Markup

from jbw.report.figures import ReportFigure, figure_of, svg
from jbw.report.loads import load_figure
from jbw.report.messages import loads as messages
from jbw.report.table import Column, Table, table, words
from jbw.report.text import NOTHING, number
from jbw.results.attributes import StoredVariable
from jbw.results.loads import LoadNumber
from jbw.run.files import hash_of
from jbw.run.netcdf import read_tree

FOLDER, FILE = "predictions", "loads.nc"  # folder of the output of `jbw predict`
# attribute with the SHA-256 hash of the posterior that made the prediction
POSTERIOR = "posterior_sha256"


class LoadSection(NamedTuple):
    """The predictions under other loads, prepared for the page of a run.

    Attributes:
        remark: Sentence on what the bands contain, or on why nothing is shown.
        table: Scalar results with their 99 % intervals.
        figures: One figure per prediction, each as the page's macro `picture` needs it.
    """

    remark: str
    table: Table
    figures: Sequence[Mapping[str, Any]] = ()


def load_section(run: Path) -> LoadSection | None:
    """Return the section on loads predicted with a run's posterior; None without predictions.

    If an earlier posterior of the run made the predictions, the section names them only.
    """
    path = run / FOLDER / FILE
    if not path.is_file():
        return None
    try:
        tree = read_tree(path)
        if tree.attrs.get(POSTERIOR) != hash_of(run / "posterior.nc"):
            return LoadSection(messages.earlier_posterior(str(run)), load_table([]))
        found = {str(child.attrs["load"]): child.to_dataset() for child in tree.children.values()}
        rows = [row for name, dataset in found.items() for row in load_rows(name, dataset)]
        figures = [_picture(name, dataset) for name, dataset in found.items()]
        remark = messages.contains(**next(iter(found.values())).attrs)
    # The predictions are damaged, but the rest of the report is not.
    except (OSError, KeyError, TypeError, ValueError, StopIteration):
        return LoadSection(messages.unreadable_loads(str(run)), load_table([]))
    return LoadSection(remark, load_table(rows), figures)


def _picture(name: str, dataset: xr.Dataset) -> dict[str, Any]:
    slug = f"load_{messages.slug_of(name)}"
    figure = figure_of(load_figure(name, dataset))
    # The drawing is jbw's own and its texts are outlines, so that it is safe to insert unescaped.
    drawn = Markup(svg(figure, slug))
    entry = ReportFigure(slug, slug, load_figure, messages.heading(name), "")
    return {"entry": entry, "number": "", "svg": drawn, "rest": "", "missing": ""}


def load_rows(name: str, dataset: xr.Dataset) -> list[LoadNumber]:
    """Return a load's scalar results as rows with 99 % bands, one per quantity and level."""
    rows, level_unit = [], dataset.attrs["source_unit"]
    for key, values in dataset.data_vars.items():
        if values.dims not in (("quantile",), ("quantile", "level")):
            continue
        columns = values.values.reshape(3, -1).T
        unit = StoredVariable.of(values).units
        levels = dataset["level"].values if "level" in values.dims else [None]
        for level, (low, median, high) in zip(levels, columns, strict=True):
            entry = {"load": name, "level": level, "level_unit": level_unit, "quantity": str(key)}
            ends = {"low": low, "median": median, "high": high, "unit": unit}
            rows.append(LoadNumber(**entry, **ends))
    return rows


def load_table(rows: Sequence[LoadNumber]) -> Table:
    """Return the table of scalar results, with one line for each quantity that has a value."""
    return table(
        "",
        [row for row in rows if row.median == row.median],
        words("load", "load"),
        Column("level", _level),
        Column("quantity", lambda row: row.quantity.replace("_", " "), align="left"),
        Column("median [99 %]", _band),
        words("unit", "unit"),
    )


def _level(row: LoadNumber) -> str:
    return NOTHING if row.level is None else f"{row.level:.6g} {row.level_unit}"


def _band(row: LoadNumber) -> str:
    ends = (row.low, row.median, row.high)
    low_text, text, high_text = (number(x, row.high - row.low) for x in ends)
    return f"{text} [{low_text}, {high_text}]"
