"""The lower part of a study's notebook cell: campaign, parameters and backbone."""

import io
from base64 import b64encode
from html import escape

import xarray as xr

from jbw.errors import JbwError
from jbw.identification.joint_answers import BACKBONES
from jbw.report.messages.opening import BACKBONE_PICTURE, GRADES
from jbw.report.opening import MOST_SHOWN, with_interval
from jbw.report.result import BACKBONE, node
from jbw.report.words import grades
from jbw.results.run import RunSummary

HEADINGS = ("parameter", "mean", "99 % interval", "unit", "")
DPI = 80  # The image is embedded in the notebook.


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
    except (ImportError, JbwError):  # Without the drawing the cell still shows the numbers.
        return ""
    data = b64encode(picture.getvalue()).decode()
    return f'<img alt="{escape(BACKBONE_PICTURE)}" src="data:image/png;base64,{data}">'
