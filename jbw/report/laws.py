"""Figures and page of a comparison of laws: curves, loops, residuals, held-out sessions."""

from collections.abc import Sequence
from operator import itemgetter
from typing import Any

import numpy as np
import xarray as xr

from jbw.report.law_table import free_law_table, law_order, laws_table
from jbw.report.measured_points import draw_free_band, draw_points, measured_points
from jbw.report.messages import free_law as free_messages
from jbw.report.messages import laws as messages
from jbw.report.messages import tables as notes
from jbw.report.result import arrays
from jbw.report.sheet import Folded, Sheet, render_sheet
from jbw.report.style import LEVELS, SOFT, Panels, draw_model, finish, panels, shade, title
from jbw.report.table import Column, table
from jbw.report.text import axis_label, length_unit, plain
from jbw.report.words import Badge
from jbw.results.attributes import StoredBackbone
from jbw.results.laws import StoredLaws

LOOKS = [(colour, dashes) for dashes in ("-", "--", ":") for colour in LEVELS]
RUN_ROW = 0.22  # height of the line of one test session [in]
# number of laws that one figure draws; a second figure, which opens on a click, shows the other
# laws
MOST = 4
LAW_ROW = 1.9  # height of a law's panels [in]
ROUND = 0.35  # margin around the points and the best law, as a fraction of their range

Looks = dict[str, tuple[str, str]]


def laws_figure(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Draw a comparison of laws, with one colour and line style per law.

    The rows show frequency and damping against amplitude, the loop at the largest amplitude, the
    residual along one record, and the error of each run when it is predicted from the others.
    """
    curves, scores = tree["curves"].to_dataset(), tree["scores"].to_dataset()
    runs = [str(run) for run in scores["run"].values] if scores.sizes["law"] else []
    shapes = [name for name in ("loops", "residuals") if name in tree.children]
    shapes = [name for name in shapes if tree[name].to_dataset().data_vars]
    rows = 2 + len(shapes) + bool(runs)
    height = 2.3 * (2 + len(shapes)) + (1.0 + RUN_ROW * len(runs) if runs else 0.0)
    axes = panels(ax, rows, 1, height=height)
    looks = dict(zip(curves["law"].values.tolist(), LOOKS, strict=False))
    _against_amplitude(axes[:2, 0], curves, looks)
    for number, name in enumerate(shapes, 2):
        SHAPES[name](axes[number, 0], tree[name].to_dataset(), looks)
    if runs:
        _left_out(axes[rows - 1, 0], scores, runs, looks)
    return finish(axes, ax)


def _against_amplitude(axes: Any, curves: xr.Dataset, looks: Looks) -> None:
    amplitude, y_fitted = 1e3 * arrays(curves, "amplitude")[0], StoredBackbone.of(curves).y_fitted
    # A comparison made by an earlier version lacks this entry.
    hopeless = curves.get("hopeless", xr.zeros_like(curves["law"], bool))
    for panel, name, unit, scale in (
        (axes[0], "frequency", "Hz", 1.0),
        (axes[1], "damping", "%", 100.0),
    ):
        for law, (colour, dashes) in looks.items():
            low, middle, high = scale * curves[name].sel(law=law).values
            shade(panel, amplitude, low, high, colour, "_", alpha=0.2)
            label = plain(law) + (", fit alone" if hopeless.sel(law=law) else "")
            panel.plot(amplitude, middle, color=colour, ls=dashes, lw=1.2, label=label)
        panel.axvline(1e3 * y_fitted, color="0.6", lw=0.8, ls=":")
        panel.set_ylabel(f"{name} [{unit}]")
        panel.set_xlabel(messages.AMPLITUDE_AXIS)
        title(panel, f"{name}{messages.UNDER_EACH_LAW}")


def _loops(here: Any, loops: xr.Dataset, looks: Looks) -> None:
    y = 1e3 * loops["displacement"].values
    for law, (colour, dashes) in looks.items():
        here.plot(y, loops["force"].sel(law=law).values, color=colour, ls=dashes, lw=1.0)
    here.set_xlabel("displacement [mm]")
    here.set_ylabel(messages.FORCE_AXIS)
    title(here, messages.LOOP_OF_LAWS)


def _residuals(here: Any, residuals: xr.Dataset, looks: Looks) -> None:
    count = residuals.sizes["part"]
    along = (np.arange(count) + 0.5) / count
    for law, (colour, dashes) in looks.items():
        residual = 100 * residuals["left"].sel(law=law).values
        here.plot(along, residual, color=colour, ls=dashes, lw=1.0)
    here.set_yscale("log")
    here.set_xlabel(messages.POSITION_AXIS)
    here.set_ylabel("residual [% of rms]")
    title(here, f"{messages.RESIDUAL_ALONG}{plain(residuals.attrs['group'])}")


SHAPES = {"loops": _loops, "residuals": _residuals}


def _left_out(here: Any, scores: xr.Dataset, runs: list[str], looks: Looks) -> None:
    laws = scores["law"].values.tolist()
    for i, law in enumerate(laws):
        heights = np.arange(len(runs)) + 0.6 * (i / max(len(looks) - 1, 1) - 0.5)
        errors = 100 * scores["error"].sel(law=law).values
        filled = "none" if looks[law][1] != "-" else "full"
        here.plot(errors, heights, "o", ms=4, color=looks[law][0], fillstyle=filled)
    heading = messages.ERROR_OF_SESSIONS
    line = scores.get("line", np.array(np.nan))
    if np.isfinite(line).any():
        here.plot(100 * line, np.arange(len(runs)), "|", ms=12, color="0.3")
        heading += messages.BAR_OF_LINEAR
    here.set_yticks(range(len(runs)), [plain(run) for run in runs])
    here.set_ylim(len(runs) - 0.4, -0.6)
    here.set_xscale("log")
    here.set_xlabel(messages.ERROR_AXIS)
    title(here, heading)


def render_laws(tree: xr.DataTree, record: StoredLaws) -> str:
    """Return the HTML page of a comparison of laws; names from files are escaped.

    Args:
        tree: Tree of `compare_laws`, with `curves`, `scores` and, where the records were read,
            `look`.
        record: Record of the same comparison.
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
    tree: xr.DataTree, record: StoredLaws, laws: Sequence[str], ax: Any = None
) -> Panels:
    """Draw each law's backbone with the measured points, one row per law, on a common scale.

    Panels: frequency and damping ratio of each law (2 axes per law, row by row).
    """
    curves = tree["curves"].to_dataset()
    best = curves.sel(law=law_order(record)[0])
    points = measured_points(tree, best)
    y_fitted = StoredBackbone.of(curves).y_fitted
    factor, unit = length_unit(y_fitted)
    amplitude, end = factor * arrays(curves, "amplitude")[0], factor * y_fitted
    axes = panels(ax, len(laws), 2, height=0.6 + LAW_ROW * len(laws), sharex="all", sharey="col")
    for row, law in zip(axes, laws, strict=True):
        for panel, name, scale in ((row[0], "frequency", 1.0), (row[1], "damping", 100.0)):
            band = scale * curves[name].sel(law=law).transpose("quantile", "amplitude").values
            draw_model(panel, amplitude, band, label="median of the law")
            draw_points(panel, points, name, factor, scale)
            draw_free_band(panel, tree, name, factor, scale)
            panel.axvspan(end, amplitude[-1], color=SOFT, alpha=0.15, lw=0, label="beyond the fit")
            panel.set_xlim(0.0, amplitude[-1])
            panel.ticklabel_format(axis="y", useOffset=False)
        answer = record.laws[law].answer
        title(row[0], f"{plain(law)}: {messages.ANSWERS.get(answer, answer)}")
        title(row[1], messages.error_of_fit(record.laws[law].error), size=8)
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


def laws_sheet(record: StoredLaws) -> Sheet:
    """Return the content of the page on laws, without its figures."""
    best = law_order(record)[0]
    equivalent = record.answered("not told apart")
    equivalent_words = messages.not_distinguished(equivalent) if equivalent else ""
    tables = [("Scores", laws_table(record))]
    if (of_readings := free_law_table(record)) is not None:
        tables.append((free_messages.TABLE, of_readings))
    if record.refused:
        law, why = (Column(name, itemgetter(i), align=align) for i, (name, align) in
                    enumerate((("law", "left"), ("why not", "wrap"))))  # fmt: skip
        tables.append((messages.UNJUDGED_TITLE, table("", record.refused.items(), law, why)))
    return Sheet(
        title=notes.laws(record.campaign),
        subtitle=messages.heading(len(record.laws)),
        caption=messages.BACKBONES,
        sentences=record.statements,
        tables=tables,
        status=Badge(best, "doubt" if equivalent else "good"),
        status_words=f"is the preferred law{equivalent_words}.",
    )
