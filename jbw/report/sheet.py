"""A page of a figure, some sentences and tables: of a fleet, of a watch, of laws."""

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
    """The content of a page without its figures, from top to bottom."""

    title: str
    subtitle: str  # one line below the title
    caption: str  # of the figure
    sentences: Sequence[str]
    tables: Sequence[tuple[str, Table]]  # each with its heading
    status: Badge | None = None
    status_words: str = ""


class Folded(NamedTuple):
    """A further figure, which is folded away below the tables."""

    title: str
    caption: str
    drawn: Panels


def render_sheet(sheet: Sheet, drawn: Panels, folded: Sequence[Folded] = ()) -> str:
    """Return the page as HTML, one file that needs nothing else; names from files are escaped.

    Args:
        sheet: Everything but the figures.
        drawn: Axes of the figure, as its function returns them.
        folded: Further figures.
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
    # The SVG is our own drawing of numbers, its texts outlines: safe to insert as it is.
    return Markup(svg(drawn.flat[0].figure, name))
