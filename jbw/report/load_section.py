"""Predictions under other loads in reports: the section of a run's page, its table and figures."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from markupsafe import Markup

from jbw.report import style
from jbw.report.figures import ReportFigure, figure_of, svg
from jbw.report.messages import loads as messages
from jbw.report.result import arrays
from jbw.report.style import Panels, draw_model, finish, log_y, panels, shade, title
from jbw.report.table import Column, Table, table, words
from jbw.report.text import NOTHING, axis_label, number, plain
from jbw.results.attributes import StoredVariable
from jbw.results.loads import LoadNumber
from jbw.run.files import hash_of
from jbw.run.netcdf import read_tree

FOLDER, FILE = "predictions", "loads.nc"  # folder of the output of `jbw predict`
# attribute with the SHA-256 hash of the posterior that made the prediction
POSTERIOR = "posterior_sha256"
BAND_LABEL = "99 % band"


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
        facts = [messages.contains(**next(iter(found.values())).attrs)]
        for dataset in found.values():
            facts += str(dataset.attrs.get("warnings", "")).splitlines()
        remark = " ".join(dict.fromkeys(facts))
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
    if not row.high - row.low > 0.0:  # The band is withheld, or all draws agree.
        return number(row.median, digits=4)
    ends = (row.low, row.median, row.high)
    low_text, text, high_text = (number(x, row.high - row.low) for x in ends)
    return f"{text} [{low_text}, {high_text}]"


def load_figure(name: str, dataset: xr.Dataset) -> Panels:
    """Draw a prediction of `Study.response_curve`, `notch`, `random`, `shock` or `resonance`."""
    draw = next(
        (draw for variable, draw in FIGURES.items() if variable in dataset.data_vars), _levels
    )
    axes = draw(dataset)
    title(axes.flat[0], plain(name))
    return axes


def _label(values: xr.DataArray) -> str:
    facts = StoredVariable.of(values)
    return axis_label(facts.long_name or str(values.name), facts.units)


def _curve(dataset: xr.Dataset) -> Panels:
    axes = panels(None, 1, 1, height=3.2)
    ax, (freq, up, down) = axes[0, 0], arrays(dataset, "freq", "upward", "downward")
    draw_model(ax, freq, up, "upward sweep, median", holds=BAND_LABEL)
    if not np.allclose(up, down, rtol=1e-3, equal_nan=True):
        shade(ax, freq, down[0], down[2], style.SKY, messages.DOWNWARD)
        ax.plot(freq, down[1], color=style.BLUE, lw=1.0, ls="--", label="downward sweep, median")
    log_y(ax)
    return finish(axes, None, axis_label("frequency", "Hz"), _label(dataset["upward"]))


def _notch(dataset: xr.Dataset) -> Panels:
    axes = panels(None, 1, 1, height=3.2)
    ax, (freq, allowed, notched) = axes[0, 0], arrays(dataset, "freq", "allowed", "notched")
    draw_model(ax, freq, allowed, "allowed, median", holds=BAND_LABEL)
    ax.plot(freq, notched[1], color=style.BLUE, label="notched level")
    log_y(ax)
    unit = StoredVariable.of(dataset["allowed"]).units
    return finish(axes, None, axis_label("frequency", "Hz"), axis_label("level", unit))


def _random(dataset: xr.Dataset) -> Panels:
    axes = panels(None, 1, 1, height=3.2)
    ax = axes[0, 0]
    draw_model(ax, *arrays(dataset, "freq", "psd"), label="median", holds=BAND_LABEL)
    ax.set_xscale("log")
    log_y(ax)
    return finish(axes, None, axis_label("frequency", "Hz"), _label(dataset["psd"]))


def _shock(dataset: xr.Dataset) -> Panels:
    axes = panels(None, 2 if "srs" in dataset else 1, 1, height=3.2)
    draw_model(axes[0, 0], *arrays(dataset, "time", "response"), label="median", holds=BAND_LABEL)
    axes[0, 0].set_ylabel(_label(dataset["response"]))
    axes[0, 0].set_xlabel(axis_label("time", "s"))
    if "srs" in dataset:
        draw_model(axes[1, 0], *arrays(dataset, "freq", "srs"), label="median", holds=BAND_LABEL)
        axes[1, 0].set_xscale("log")
        log_y(axes[1, 0])
        axes[1, 0].set_xlabel(axis_label(messages.OF_SPECTRUM, "Hz"))
        axes[1, 0].set_ylabel(_label(dataset["srs"]))
    return finish(axes, None)


def _levels(dataset: xr.Dataset) -> Panels:
    axes = panels(None, 2, 1, height=4.2, sharex=True)
    level: Any = dataset["level"]
    for ax, name in zip(axes[:, 0], ("frequency", "peak"), strict=True):
        low, middle, high = dataset[name].values
        spread = [middle - low, high - middle]
        ax.errorbar(level.values, middle, spread, color=style.MODEL, marker="o", ms=3, capsize=3)
        ax.set_ylabel(_label(dataset[name]))
    return finish(axes, None, axis_label("level", StoredVariable.of(level).units))


FIGURES = {"upward": _curve, "allowed": _notch, "psd": _random, "response": _shock}
