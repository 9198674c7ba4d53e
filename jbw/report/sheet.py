"""A page with a figure, sentences and tables, for a fleet, a monitored joint or compared laws."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from markupsafe import Markup

from jbw.report.figures import svg
from jbw.report.page import ENVIRONMENT
from jbw.report.style import Panels
from jbw.report.table import Table
from jbw.report.words import Badge


@dataclass(frozen=True)
class Sheet:
    """The content of a page without its figures, in order from top to bottom."""

    title: str
    subtitle: str  # one line below the title
    caption: str  # caption of the figure
    sentences: Sequence[str]
    tables: Sequence[tuple[str, Table]]  # tables with their headings
    status: Badge | None = None
    status_words: str = ""


class Folded(NamedTuple):
    """An additional figure below the tables that the page shows only after a click."""

    title: str
    caption: str
    drawn: Panels


def render_sheet(sheet: Sheet, drawn: Panels, folded: Sequence[Folded] = ()) -> str:
    """Return a page as one self-contained HTML file; names from files are escaped.

    Args:
        sheet: Content of the page without its figures.
        drawn: Axes of the figure, as its function returns them.
        folded: Additional figures below the tables.
    """
    folded_figures = [
        {"id": f"further-{i}", "title": figure.title, "caption": figure.caption,
         "figure": _svg(figure.drawn, f"further-{i}")}
        for i, figure in enumerate(folded, start=1)
    ]  # fmt: skip
    return ENVIRONMENT.get_template("sheet.html").render(
        sheet=sheet, figure=_svg(drawn, "sheet"), further=folded_figures
    )


def _svg(drawn: Panels, name: str) -> Markup:
    # The SVG is jbw's own drawing with texts as outlines, so that it is safe to insert unescaped.
    return Markup(svg(drawn.flat[0].figure, name))
