"""The page of a comparison of laws: measured points on every law's backbone, scores, and why."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from jbw.report.law_table import law_order, laws_table
from jbw.report.laws import laws_figure
from jbw.report.measured_points import draw_points, measured_points
from jbw.report.messages import laws as messages
from jbw.report.messages import tables as notes
from jbw.report.sheet import Folded, Sheet, render_sheet
from jbw.report.style import SOFT, Panels, draw_model, finish, panels, plain, title
from jbw.report.table import table, words
from jbw.report.text import axis_label, length_unit
from jbw.report.words import Badge

MOST = 4  # laws drawn at once; the others are folded
ROW = 1.9  # height of a law's panels [in]
ROUND = 0.35  # of the reach of points and best law: what is shown beyond them


def render_laws(tree: xr.DataTree, record: Mapping[str, Any]) -> str:
    """Return the page of a comparison of laws as HTML; names from files are escaped.

    Args:
        tree: Of `compare_laws`, with `curves`, `scores` and, where the records were read, `look`.
        record: Of the same.
    """
    drawn_laws = tree["curves"].to_dataset()["law"].values.tolist()
    order = [name for name in law_order(record) if name in drawn_laws]
    folded = [Folded(
        messages.LOOPS_TITLE,
        messages.LOOPS,
        laws_figure(tree),
    )]  # fmt: skip
    if len(order) > MOST:
        other_laws = law_backbones(tree, record, order[MOST:])
        folded.insert(0, Folded("The other laws", messages.FURTHER, other_laws))
    drawn = law_backbones(tree, record, order[:MOST])
    return render_sheet(laws_sheet(record), drawn, folded)


def law_backbones(
    tree: xr.DataTree, record: Mapping[str, Any], laws: Sequence[str], ax: Any = None
) -> Panels:
    """Draw what was measured on the backbone of each law, a row a law, all at the same scale.

    Panels: frequency and damping ratio of each law (2 axes a law, row by row).
    """
    curves = tree["curves"].to_dataset()
    best = curves.sel(law=law_order(record)[0])
    points = measured_points(tree, best)
    factor, unit = length_unit(float(curves.attrs["y_fitted"]))
    amplitude = factor * curves["amplitude"].values
    end = factor * float(curves.attrs["y_fitted"])
    axes = panels(ax, len(laws), 2, height=0.6 + ROW * len(laws), sharex="all", sharey="col")
    for row, law in zip(axes, laws, strict=True):
        for panel, name, scale in ((row[0], "frequency", 1.0), (row[1], "damping", 100.0)):
            band = scale * curves[name].sel(law=law).transpose("quantile", "amplitude").values
            draw_model(panel, amplitude, band, label="median of the law")
            draw_points(panel, points, name, factor, scale)
            panel.axvspan(end, amplitude[-1], color=SOFT, alpha=0.15, lw=0, label="beyond the fit")
            panel.set_xlim(0.0, amplitude[-1])
            panel.ticklabel_format(axis="y", useOffset=False)
        answer = record["laws"][law]["answer"]
        title(row[0], f"{plain(law)}: {messages.ANSWERS.get(answer, answer)}")
        error = record["laws"][law]["error"]
        title(row[1], messages.error_of_fit(error), size=8)
    for column, name, scale in ((0, "frequency", 1.0), (1, "damping", 100.0)):
        shown = [
            scale * best[name].values.ravel(),
            *(scale * reading.values[name] for reading in points),
        ]
        low, high = np.nanmin(np.concatenate(shown)), np.nanmax(np.concatenate(shown))
        beyond = ROUND * (high - low) or abs(high) or 1.0
        axes[0, column].set_ylim(low - beyond, high + beyond)
    for row in axes:
        row[1].set_ylabel("damping ratio [%]")
    return finish(axes, ax, axis_label("amplitude of displacement", unit), "frequency [Hz]")


def laws_sheet(record: Mapping[str, Any]) -> Sheet:
    """Everything on the page but the figures."""
    rows = record["laws"]
    best = law_order(record)[0]
    best = next((name for name, row in rows.items() if row["answer"] == "best"), best)
    equivalent = [name for name, row in rows.items() if row["answer"] == "not told apart"]
    equivalent_words = messages.not_distinguished(equivalent) if equivalent else ""
    tables = [("Scores", laws_table(record))]
    if record["refused"]:
        refused = [{"law": law, "why": why} for law, why in record["refused"].items()]
        columns = words("law", "law"), words("why not", "why", "wrap")
        tables.append((messages.UNJUDGED_TITLE, table("", refused, *columns)))
    return Sheet(
        title=notes.laws(record["campaign"]),
        subtitle=messages.heading(len(rows)),
        caption=messages.BACKBONES,
        sentences=record["statements"],
        tables=tables,
        status=Badge(best, "doubt" if equivalent else "good"),
        status_words=f"is the preferred law{equivalent_words}.",
    )
