"""Views of a study: data frames of its numbers, and the lower part of its notebook cell."""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from jbw.errors import ConfigError, DataError, did_you_mean
from jbw.identification.joint_answers import BACKBONES
from jbw.report.result import BACKBONE, FREE_LAW, branch, node
from jbw.results.attributes import StoredBackbone
from jbw.results.run import RunSummary
from jbw.results.stored import Stored

if TYPE_CHECKING:  # The import takes half a second.
    from pandas import DataFrame
import io
from base64 import b64encode
from html import escape

from jbw.errors import JbwError
from jbw.report.messages.opening import BACKBONE_PICTURE, GRADES
from jbw.report.opening import MOST_SHOWN, with_interval
from jbw.report.words import grades

# Suffixes of the columns with the lower end, the median and the upper end of a 99 % band.
ENDS = ("low", "", "high")
PARAMETERS = ("unit", "mean", "sd", "cv", "q005", "q995", "map", "kl", "ess_bulk", "r_hat")
HEADINGS = ("parameter", "mean", "99 % interval", "unit", "")
DPI = 80  # The image is embedded in the notebook.


def parameter_frame(summary: RunSummary, step: str | None) -> "DataFrame":
    """Return a data frame with one row per parameter of a step of the identification.

    The main step is used when `step` is None.
    """
    steps = summary.steps
    name = summary.main if step is None else step
    if name not in steps:
        listed = ", ".join(steps) or "none"
        raise ConfigError(
            f"Argument `step` must be a step of the run, but is {name!r}.",
            remedy=f"{did_you_mean(str(name), steps)}Steps of the run: {listed}.",
        )
    return _frame(steps[name].parameters, PARAMETERS, "parameter")


def backbone_frame(tree: xr.DataTree) -> "DataFrame":
    """Return a backbone as a data frame: one row per amplitude, and per mode for several joints."""
    from pandas import Index, concat

    if node(tree, BACKBONES) is not None:
        group = branch(tree, BACKBONES, "frequency_hz", "damping", "displacement")
        modes = Index(group["mode"].values.astype(int), name="mode")
        of_modes = [
            _bands(
                group["displacement"].sel(mode=mode),
                group["frequency_hz"].sel(mode=mode),
                group["damping"].sel(mode=mode),
            )
            for mode in modes
        ]
        return concat(of_modes, keys=modes)
    if node(tree, BACKBONE) is None:
        raise DataError(
            "The study has no backbone: its joint has no mode, or no motion was measured.",
            remedy="Call `study.table()` for the parameters.",
        )
    group = branch(tree, BACKBONE, "frequency", "damping")
    frame = _bands(group["amplitude"], group["frequency"], group["damping"])
    # The largest fitted amplitude is on the grid, except for round-off.
    frame = frame.assign(fitted=frame.index <= StoredBackbone.of(group).y_fitted * (1 + 1e-9))
    return frame if (free := node(tree, FREE_LAW)) is None else frame.assign(**_free(frame, free))


def _free(frame: "DataFrame", free: xr.DataTree) -> dict[str, np.ndarray]:
    """Return the free-form law's bands at given amplitudes; NaN outside the law's range."""
    x, at = np.log(np.asarray(free["amplitude"], float)), np.log(frame.index.values)
    return {
        f"{column}_free{end and '_'}{end}": np.interp(
            at, x, np.asarray(free[name].isel(quantile=i), float), left=np.nan, right=np.nan
        )
        for column, name in (("frequency_hz", "frequency"), ("damping", "damping"))
        for i, end in enumerate(ENDS)
    }


def _bands(amplitude: xr.DataArray, frequency: xr.DataArray, damping: xr.DataArray) -> "DataFrame":
    """Return medians and 99 % band ends of frequency [Hz] and damping at each amplitude [m]."""
    from pandas import DataFrame, Index

    columns = {}
    for name, band in (("frequency_hz", frequency), ("damping", damping)):
        for quantile, end in enumerate(ENDS):
            column = f"{name}_{end}" if end else name
            columns[column] = np.asarray(band.isel(quantile=quantile), float)
    return DataFrame(columns, index=Index(np.asarray(amplitude, float), name="amplitude_m"))


def prediction_frame(summary: RunSummary) -> "DataFrame":
    """Return a data frame of prediction errors and coverage, with one row per predicted test."""
    columns = dict.fromkeys(key for row in summary.predictions.values() for key in row.plain())
    return _frame(summary.predictions, columns, "test")


def _frame(rows: Mapping[str, Stored], columns: Iterable[str], of: str) -> "DataFrame":
    """Return a data frame of rows by name; columns that are empty in all rows are dropped."""
    from pandas import DataFrame, Index

    stated = [row.plain() for row in rows.values()]
    kept = [c for c in columns if any(row.get(c) is not None for row in stated)]
    values = [[row.get(column) for column in kept] for row in stated]
    return DataFrame(values, index=Index(list(rows), name=of), columns=Index(kept))


def page_of(summary: RunSummary, tree: xr.DataTree) -> str:
    """Return a study's campaign, parameters and backbone as HTML for its notebook cell."""
    title = f"<p>Study of {escape(summary.campaign)}</p>"
    return title + _parameters(summary) + _picture(tree)


def _parameters(summary: RunSummary) -> str:
    graded, rows = grades(summary), summary.parameters
    if not graded:
        return "<p>no parameter is known</p>"
    lines = [f"<tr>{''.join(f'<th>{heading}</th>' for heading in HEADINGS)}</tr>"]
    for name in list(graded)[:MOST_SHOWN]:
        grade = GRADES[graded[name]].partition(",")[0].lower()
        cells = "".join(f"<td>{escape(c)}</td>" for c in (name, *with_interval(rows[name]), grade))
        lines.append(f"<tr>{cells}</tr>")
    omitted = len(graded) - MOST_SHOWN
    more = f"<p>and {omitted} more: <code>study.table()</code></p>" if omitted > 0 else ""
    return f"<table>{''.join(lines)}</table>{more}"


def _picture(tree: xr.DataTree) -> str:
    """Return a drawing of the backbone as an HTML image; empty if there is nothing to draw."""
    groups = {"mode_backbones": BACKBONES, "backbone": BACKBONE}
    name = next((name for name, path in groups.items() if node(tree, path) is not None), None)
    if name is None:
        return ""
    try:
        from jbw.report.plots import draw  # This import loads matplotlib.

        picture = io.BytesIO()
        draw(tree, name).savefig(picture, format="png", dpi=DPI, facecolor="white")
    # Without the drawing, the notebook cell still shows the numbers.
    except (ImportError, JbwError):
        return ""
    data = b64encode(picture.getvalue()).decode()
    return f'<img alt="{escape(BACKBONE_PICTURE)}" src="data:image/png;base64,{data}">'
